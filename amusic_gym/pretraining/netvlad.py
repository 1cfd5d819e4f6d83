"""Train the compact NetVLAD that ships, on rendered worlds and random collages only.

As the authors of NetVLAD (Arandjelović et al. 2016) do: a backbone that was trained before, visual
words from k-means on its features, then metric learning of everything by places seen twice, then a
whitening by principal components. Their backbone knew ImageNet and their places were photographs;
here

1. the backbone learns from pairs of pictures of one pose, under two conditions, by two cameras:
   the features of a point must find those of the same point among all others;
2. everything learns from pairs of traverses of one world: each place must find itself among the
   other places of its own world and of another;
3. the whitening is fitted on rendered images.
"""

from dataclasses import asdict, dataclass, field, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812 (its usual name)

from amusic_gym.pretraining.cameras import CORNERS, Image, draw_camera, photograph, seen_corners
from amusic_gym.pretraining.job import TrainingJob
from amusic_gym.pretraining.loop import Training
from amusic_gym.pretraining.pools import Pool, PoolSize, collage
from amusic_gym.techniques.networks import NetVLADNetwork, NetVLADWidths
from amusic_gym.techniques.preparation import Preparation
from amusic_gym.techniques.saved_weights import save_netvlad

POINT_TEMPERATURE = 0.07
PLACE_TEMPERATURE = 0.05
DAMPING = 0.25  # added to the whitening's variances, in mean variances: small ones are noise
ROOM = 0.95  # points nearer to the border of a picture than this (-1 to 1) are left out

SHARPNESS = 0.1
"""Weight of the second nearest visual word relative to the nearest, typically (the authors: .01,
with descriptors of many more values)."""


@dataclass(frozen=True)
class Settings:
    """Everything the trained weights depend on, besides the code."""

    seed: int = 0  # of all draws
    point_steps: int = 500  # of the first stage
    place_steps: int = 150  # of the second
    pictures: int = 16  # pairs of pictures in a step of the first stage
    points: int = 64  # in each of them
    worlds: int = 2  # in a step of the second stage
    places: int = 16  # of each of them
    point_rate: float = 3e-3  # highest learning rate of the first stage
    place_rate: float = 5e-4  # and of the second
    collages: float = 0.4  # share of collages among the first stage's pictures
    samples: int = 2048  # images that the whitening is fitted on
    pool: PoolSize = PoolSize()  # what is rendered to learn from
    held_out: PoolSize = PoolSize(worlds=6)  # and to validate on
    widths: NetVLADWidths = field(
        default_factory=lambda: NetVLADWidths(
            stages=((16,), (32,), (64,), (96, 96)), clusters=16, whitened=256
        )
    )
    preparation: Preparation = Preparation(width=128, height=96)


def batch(images: list[Image], preparation: Preparation) -> Tensor:
    """(B, 3, height, width), as the technique prepares them."""
    prepared = np.stack([preparation.apply(image) for image in images])
    return torch.from_numpy(prepared).contiguous(memory_format=torch.channels_last)


def contrast(queries: Tensor, references: Tensor, temperature: float) -> Tensor:
    """Each row must find its partner among all, both ways (InfoNCE); rows are of length 1."""
    logits = queries @ references.T / temperature  # (B, B)
    partner = torch.arange(len(logits))
    return (F.cross_entropy(logits, partner) + F.cross_entropy(logits.T, partner)) / 2


def point_loss(
    network: NetVLADNetwork, pool: Pool, settings: Settings, rng: np.random.Generator
) -> Tensor:
    """Loss of the features of points in pairs of pictures."""
    left, right, moves = [], [], []
    for _ in range(settings.pictures):
        if rng.random() < settings.collages:
            first = second = collage(rng)
        else:
            first, second = pool.same_pose(rng)
        pictures, move = two_pictures(first, second, rng)
        left.append(pictures[0])
        right.append(pictures[1])
        moves.append(move)
    features = network.backbone(batch(left + right, settings.preparation))  # (2B, C, h, w)
    points = rng.uniform(-ROOM, ROOM, (settings.pictures, settings.points, 2)).astype(np.float32)
    partners = np.stack(
        [cv2.perspectiveTransform(p[None], m)[0] for p, m in zip(points, moves, strict=True)]
    )
    seen = torch.from_numpy((np.abs(partners) < ROOM).all(axis=2).ravel())  # (B·N,)
    queries = features_at(features[: settings.pictures], points)[seen]
    references = features_at(features[settings.pictures :], partners)[seen]
    return contrast(queries, references, POINT_TEMPERATURE)


def two_pictures(
    first: Image, second: Image, rng: np.random.Generator
) -> tuple[tuple[Image, Image], NDArray[np.float64]]:
    """Photographs of two images of one pose, and the 3×3 map of points from one to the other."""
    here = replace(draw_camera(rng), bend=0.0)
    there = replace(
        draw_camera(rng), bend=0.0, corners=seen_corners(rng, rng.uniform(0.6, 1), 0.12)
    )
    pictures = (photograph(first, here, rng, 0.0), photograph(second, there, rng, 0.0))
    from_here = cv2.getPerspectiveTransform(CORNERS, here.corners)
    from_there = cv2.getPerspectiveTransform(CORNERS, there.corners)
    return pictures, np.linalg.inv(from_there) @ from_here


def features_at(features: Tensor, points: NDArray[np.float32]) -> Tensor:
    """(B, C, h, w) at (B, N, 2) points -> (B·N, C) of length 1."""
    where = torch.from_numpy(points)[:, None]  # (B, 1, N, 2)
    found = F.grid_sample(features, where, align_corners=False)[:, :, 0]  # (B, C, N)
    return F.normalize(found.transpose(1, 2).flatten(0, 1), dim=1)


def set_words(network: NetVLADNetwork, pool: Pool, settings: Settings) -> None:
    """Visual words by k-means on local features of rendered images; sharpness of their shares."""
    rng = np.random.default_rng([settings.seed, 1])
    images = [photograph(pool.any_image(rng), draw_camera(rng), rng) for _ in range(128)]
    network.eval()
    with torch.no_grad():
        maps = [
            network.backbone(batch(images[i : i + 32], settings.preparation))
            for i in range(0, len(images), 32)
        ]
        local = F.normalize(torch.cat(maps).flatten(2), dim=1).transpose(1, 2).flatten(0, 1)
    local = local[torch.from_numpy(rng.permutation(len(local))[:10_000])]  # (N, C)
    cv2.setRNGSeed(settings.seed)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    words = settings.widths.clusters
    *_, centres = cv2.kmeans(local.numpy(), words, np.empty(0), stop, 1, cv2.KMEANS_PP_CENTERS)
    centroids = F.normalize(torch.from_numpy(centres), dim=1)  # (K, C)
    nearest = torch.topk(local @ centroids.T, 2, dim=1).values  # (N, 2)
    sharpness = -np.log(SHARPNESS) / float((nearest[:, 0] - nearest[:, 1]).mean())
    with torch.no_grad():
        network.pool.centroids.copy_(centroids)
        network.pool.assignment.weight.copy_(sharpness * centroids)


def place_loss(
    network: NetVLADNetwork, pool: Pool, settings: Settings, rng: np.random.Generator
) -> Tensor:
    """Loss of the descriptors of places in pairs of traverses."""
    queries: list[Image] = []
    references: list[Image] = []
    for world in rng.choice(pool.worlds, settings.worlds, replace=False):
        places = rng.choice(pool.places, settings.places, replace=False)
        for images, drive in zip((queries, references), rng.permutation(2), strict=True):
            sight, camera = rng.integers(2), draw_camera(rng)
            images += [
                photograph(pool.images[world, place, drive, sight], camera, rng) for place in places
            ]
    descriptors = network.aggregate(batch(queries + references, settings.preparation))
    return contrast(descriptors[: len(queries)], descriptors[len(queries) :], PLACE_TEMPERATURE)


def set_whitening(network: NetVLADNetwork, pool: Pool, settings: Settings) -> None:
    """Principal components of rendered images' descriptors, each divided by its deviation."""
    assert network.whitening is not None
    rng = np.random.default_rng([settings.seed, 2])
    network.eval()
    flat = []
    with torch.no_grad():
        for _ in range(0, settings.samples, 32):
            images = [photograph(pool.any_image(rng), draw_camera(rng), rng) for _ in range(32)]
            flat.append(network.aggregate(batch(images, settings.preparation)).double().numpy())
    samples = np.concatenate(flat)  # (N, K·C)
    middle = samples.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov(samples.T))
    kept = slice(None, -len(network.whitening.weight) - 1, -1)  # the largest first
    values, vectors = values[kept], vectors[:, kept]
    matrix = (vectors / np.sqrt(values + values.mean() * DAMPING)).T  # (P, K·C)
    with torch.no_grad():
        network.whitening.weight.copy_(torch.from_numpy(matrix))
        network.whitening.bias.copy_(torch.from_numpy(-matrix @ middle))


def train(job: TrainingJob, settings: Settings) -> tuple[list[float], list[float]]:
    """Train, validate and write the weights; gives the losses of both stages' steps.

    Raises:
        FileNotFoundError: if there is nothing to resume.
        ValueError: for a checkpoint of another training.
        KeyboardInterrupt: after a checkpoint.
    """
    pool, held_out = job.pools(settings.seed, settings.pool, settings.held_out)
    torch.manual_seed(settings.seed)
    network = NetVLADNetwork(settings.widths, batch_norm=True)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # quicker
    about = asdict(settings)
    points = Training(
        network, job, "points", about, steps=settings.point_steps, rate=settings.point_rate
    )
    point_losses = points.run(lambda rng: point_loss(network, pool, settings, rng))
    set_words(network, pool, settings)
    places = Training(
        network, job, "places", about, steps=settings.place_steps, rate=settings.place_rate,
        needed=False,
    )  # fmt: skip
    place_losses = places.run(lambda rng: place_loss(network, pool, settings, rng))
    set_whitening(network, pool, settings)
    final = network.folded()

    def describe(images: list[Image]) -> NDArray[np.float32]:
        """(B, P) descriptors of length 1, as the technique gives them."""
        with torch.no_grad():
            values: NDArray[np.float32] = final(batch(images, settings.preparation)).numpy()
        return values

    story = job.story("train_netvlad.py", about, describe, held_out)
    save_netvlad(job.out, network, settings.preparation, training=story, half=True)
    for stage in (points, places):
        stage.checkpoint.unlink()
    return point_losses, place_losses
