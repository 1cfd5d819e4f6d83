"""Train the CALC that ships, on rendered worlds and random collages only.

As CALC's authors do (Merrill and Huang, "Lightweight Unsupervised Deep Loop Closure", RSS 2018): an
auto-encoder sees a picture through a random projective warp and must give the HOG descriptor of the
picture without it. No labels are needed. Its encoder is CALC; its decoder is thrown away. What
differs from their training: the pictures; their light and colours are changed as well, and half of
the rendered ones are seen under one condition and described under another; the decoder has one
layer instead of three, so that the descriptor itself, which is compared by its cosine, must be like
HOG; Adam instead of plain descent.
"""

from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from amusic_gym.pretraining.cameras import Image, draw_camera, photograph, seen_corners
from amusic_gym.pretraining.job import TrainingJob
from amusic_gym.pretraining.loop import Training
from amusic_gym.pretraining.pools import Pool, PoolSize, collage
from amusic_gym.techniques.networks import CALCEncoder
from amusic_gym.techniques.preparation import prepare_calc
from amusic_gym.techniques.saved_weights import save_calc

HOG_LENGTH = 3648
CODE_LENGTH = 1064
CONVOLUTIONS = ("conv1", "conv2", "conv3")


@dataclass(frozen=True)
class Settings:
    """Everything the trained weights depend on, besides the code."""

    seed: int = 0  # of all draws
    steps: int = 300  # batches
    pictures: int = 32  # in a batch
    rate: float = 2e-3  # highest learning rate
    collages: float = 0.4  # share of collages among the pictures; the others are rendered
    warp: float = 0.1  # how far each corner moves at most, of half the picture's width and height
    pool: PoolSize = PoolSize()  # what is rendered to learn from
    held_out: PoolSize = PoolSize(worlds=6)  # and to validate on


class AutoEncoder(nn.Module):
    """CALC's encoder and a decoder of one layer, which gives at first the ``mean`` HOG (3648,).

    While it learns, each convolution is followed by batch normalisation, without which the last
    layer's ReLU soon gives zeros only; :func:`finished` takes it out again.
    """

    def __init__(self, mean: NDArray[np.float32]) -> None:
        super().__init__()
        self.encoder = CALCEncoder()
        # At the activations of a trained encoder it divides by 1.000, at a quarter of the time.
        self.encoder.norm = nn.Identity()  # type: ignore[assignment]
        for name in CONVOLUTIONS:
            conv = getattr(self.encoder, name)
            nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
            setattr(self.encoder, name, nn.Sequential(conv, nn.BatchNorm2d(conv.out_channels)))
        self.decoder = nn.Linear(CODE_LENGTH, HOG_LENGTH)
        usual = torch.from_numpy(np.clip(mean, 0.01, 0.99))
        with torch.no_grad():
            self.decoder.weight.zero_()  # else the encoder first learns to keep its noise small
            self.decoder.bias.copy_(torch.logit(usual))

    def forward(self, pictures: Tensor) -> Tensor:
        """(B, 1, 120, 160) -> (B, 3648), 0 to 1."""
        return torch.sigmoid(self.decoder(self.encoder(pictures)))


def hog(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """The authors' HOG: (1, 120, 160) grey, 0 to 1 -> (3648,).

    Two bins of direction in cells of 8×8 pixels, four cells to a block, two blocks to a window,
    and a window every 8 pixels: 19 · 12 · 16 values.
    """
    descriptor = cv2.HOGDescriptor((16, 32), (16, 16), (16, 16), (8, 8), 2)
    return np.asarray(descriptor.compute(np.rint(picture[0] * 255).astype(np.uint8)), np.float32)


def example(
    pool: Pool, settings: Settings, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A picture to see, (1, 120, 160), and the HOG descriptor to give, (3648,)."""
    if rng.random() < settings.collages:
        seen = wanted = collage(rng)
    else:
        seen, wanted = pool.same_pose(rng)
    corners = seen_corners(rng, rng.uniform(1 - settings.warp, 1), settings.warp)
    camera = replace(draw_camera(rng), corners=corners, bend=0.0)
    return prepare_calc(photograph(seen, camera, rng, 0.0)), hog(prepare_calc(wanted))


def batch(pool: Pool, settings: Settings, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """(B, 1, 120, 160) pictures and the (B, 3648) HOG descriptors to give."""
    examples = [example(pool, settings, rng) for _ in range(settings.pictures)]
    pictures, wanted = (torch.from_numpy(np.stack(part)) for part in zip(*examples, strict=True))
    return pictures.contiguous(memory_format=torch.channels_last), wanted


def describe(encoder: CALCEncoder, images: list[Image]) -> NDArray[np.float32]:
    """(B, 1064) descriptors of length 1, as the technique gives them."""
    pictures = torch.from_numpy(np.stack([prepare_calc(image) for image in images]))
    with torch.inference_mode():
        values: NDArray[np.float32] = nn.functional.normalize(encoder(pictures)).numpy()
    return values


def finished(model: AutoEncoder) -> CALCEncoder:
    """The trained encoder: batch normalisation merged in, response normalisation in its place."""
    encoder = CALCEncoder()
    for name in CONVOLUTIONS:
        conv, norm = getattr(model.encoder, name)
        getattr(encoder, name).load_state_dict(fuse_conv_bn_eval(conv, norm).state_dict())
    return encoder.eval()


def train(job: TrainingJob, settings: Settings) -> list[float]:
    """Train, validate and write the weights; gives the loss of each step.

    Raises:
        FileNotFoundError: if there is nothing to resume.
        ValueError: for a checkpoint of another training.
        KeyboardInterrupt: after a checkpoint.
    """
    pool, held_out = job.pools(settings.seed, settings.pool, settings.held_out)
    torch.manual_seed(settings.seed)
    first = batch(pool, replace(settings, pictures=128), np.random.default_rng([settings.seed]))
    model = AutoEncoder(first[1].mean(dim=0).numpy())
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # quicker

    def loss_of(rng: np.random.Generator) -> Tensor:
        pictures, wanted = batch(pool, settings, rng)
        loss: Tensor = (model(pictures) - wanted).square().sum(dim=1).mean() / 2
        return loss

    about = asdict(settings)
    training = Training(model, job, "training", about, steps=settings.steps, rate=settings.rate)
    losses = training.run(loss_of)
    model.eval()
    encoder = finished(model)
    story = job.story("train_calc.py", about, lambda images: describe(encoder, images), held_out)
    save_calc(job.out, encoder, training=story)
    training.checkpoint.unlink()
    return losses
