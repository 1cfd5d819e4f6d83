"""One frame: the camera, the order of drawing, the light and the lens."""

from dataclasses import replace

import cv2
import numpy as np

from amusic_gym.worlds import corridor, ground
from amusic_gym.worlds.camera import ViewCamera
from amusic_gym.worlds.conditions import Look
from amusic_gym.worlds.film import Image, develop
from amusic_gym.worlds.ground import ACROSS, ALONG, BLOCK, HALF
from amusic_gym.worlds.layout import Things
from amusic_gym.worlds.light import light
from amusic_gym.worlds.noise import Floats, generator
from amusic_gym.worlds.raster import draw_level, draw_plane
from amusic_gym.worlds.sky import RISE, ROUND
from amusic_gym.worlds.world import World


def draw(world: World, camera: ViewCamera, look: Look, run: int, frame: int) -> Image:
    """The image (rows, columns, 3) uint8, blue-green-red, that a camera takes.

    The number of the drive (``run``) gives its sky, parked cars and noise, that of the ``frame``
    moving things and noise.
    """
    if world.kind == "corridor":
        look = indoors(look)
    columns, rows = camera.size
    canvas = np.zeros((rows, columns, 4), np.float32)
    inverse_depth = np.zeros((rows, columns), np.float32)
    first = int(camera.along // BLOCK)
    _ground(canvas, inverse_depth, world, camera, look, run, first)
    things = world.things(first, run)
    _planes(canvas, inverse_depth, world, camera, look, things)
    if look.crowd > 0:
        crowd = world.route.moving(world.seed, run, frame, camera.along, look.crowd)
        _planes(canvas, inverse_depth, world, camera, look, Things.of(crowd))
    lamps = _lamps(world, camera, look, things)
    fog = np.array([look.fog, *look.haze], np.float32)
    ambient = np.array(look.ambient, np.float32)
    light(canvas, inverse_depth, lamps, ambient, look.glow, look.beam, fog, camera.lens)
    picture = canvas[..., :3]
    _backdrop(picture, inverse_depth, world, camera, look, run)
    return develop(picture, inverse_depth, look, camera, generator(world.seed, "film", run, frame))


def indoors(look: Look) -> Look:
    """The same conditions under a roof: lamps instead of the sun, no rain or snow."""
    dark = look.beam > 0
    blue, green, red = look.ambient
    share = 1.0 if dark else 0.62
    return replace(
        look,
        ambient=(share * blue, share * green, share * red),
        lamps=1.6 if not dark else 2.2,
        glow=0.15 if dark else 0.8,
        sun=0.5 * look.sun,
        rain=0.0,
        snow=0.0,
        glare=0.0,
        wet=0.4 * look.wet,
    )


def _ground(
    canvas: Floats, inverse_depth: Floats, world: World, camera: ViewCamera, look: Look, run: int,
    first: int,
) -> None:  # fmt: skip
    """Draw the ground and, in a corridor, its ceiling."""
    pixels, table = world.ground(first, look, run)
    ahead = camera.along - first * BLOCK
    bends = camera.bend(world, camera.along + np.arange(402.0))
    view = (ahead, HALF, float(ALONG), float(ACROSS))
    grain, lens = ground.detail(), camera.lens
    draw_level(canvas, inverse_depth, pixels, table, grain, -camera.height, view, bends, lens)
    if world.kind == "corridor":
        pixels, table = world.ceiling(first)
        grain, above = ground.smooth_detail(), corridor.HIGH - camera.height
        draw_level(canvas, inverse_depth, pixels, table, grain, above, view, bends, lens)


def _planes(
    canvas: Floats,
    inverse_depth: Floats,
    world: World,
    camera: ViewCamera,
    look: Look,
    things: Things,
) -> None:
    """Draw planes from far to near."""
    if not things.keys:
        return
    ends = things.corners + things.alongs
    begin_z, end_z = things.corners[:, 2] - camera.along, ends[:, 2] - camera.along
    near, far = np.minimum(begin_z, end_z), np.maximum(begin_z, end_z)
    chosen = np.flatnonzero((far > 0.7) & (near < things.reach))
    order = chosen[np.argsort(-far[chosen], kind="stable")]
    corners = things.corners - (0, camera.height, camera.along)
    corners[:, 0] += camera.bend(world, things.corners[:, 2])
    alongs = things.alongs.copy()
    alongs[:, 0] += camera.bend(world, ends[:, 2]) - camera.bend(world, things.corners[:, 2])
    gains = 1 + look.sun * np.clip(-things.facing * np.sign(look.side), -0.75, 0.75)
    warm = np.array([0.9, 1.0, 1.08])
    gain = np.where(gains[:, None] > 1, 1 + (gains[:, None] - 1) * warm, gains[:, None])
    gain = gain.astype(np.float32)
    lens = camera.lens
    for index in order:
        pixels, table = world.texture(things.keys[index], look.season)
        draw_plane(
            canvas, inverse_depth, pixels, table, corners[index], alongs[index], things.ups[index],
            lens, gain[index],
        )  # fmt: skip


def _lamps(world: World, camera: ViewCamera, look: Look, things: Things) -> Floats:
    """(N, 6) lamps near the camera, in its axes."""
    if look.lamps <= 0 or not len(things.lamps):
        return np.zeros((0, 6), np.float32)
    ahead = things.lamps[:, 2] - camera.along
    chosen = things.lamps[(ahead > -8) & (ahead < (30 if world.kind == "corridor" else 75))]
    lamps = np.empty((len(chosen), 6), np.float32)
    lamps[:, :3] = chosen - (0, camera.height, camera.along)
    lamps[:, 0] += camera.bend(world, chosen[:, 2])
    warm = np.array([0.9, 0.98, 1.0] if world.kind == "corridor" else [0.55, 0.85, 1.05])
    lamps[:, 3:] = look.lamps * warm
    if world.kind == "corridor" and look.beam > 0:  # at night two of three are out
        lamps = lamps[np.rint(chosen[:, 2] / 8).astype(int) % 3 == 0]
    return lamps


def _backdrop(
    picture: Floats, inverse_depth: Floats, world: World, camera: ViewCamera, look: Look, run: int
) -> None:
    """Sky and skyline where nothing stands."""
    panorama = world.clouds(look, run)
    focal, centre_x, centre_y = camera.lens
    rows, columns = inverse_depth.shape
    per_pixel = ROUND / (2 * np.pi) / focal
    turn = (world.heading(camera.along) + camera.yaw) * ROUND / (2 * np.pi)
    u = (np.arange(columns) - centre_x) * per_pixel + turn + ROUND / 2
    v = RISE - 1 - (centre_y - np.arange(rows)) * per_pixel
    left, top = int(np.floor(u[0])) - 1, max(0, min(RISE - 2, int(v[0])))
    span = int(np.ceil(u[-1])) - left + 2
    left %= ROUND
    if left + span <= ROUND:
        piece = panorama[top:, left : left + span]
    else:
        piece = panorama[top:].take(range(left, left + span), 1, mode="wrap")
    map_u = np.tile((u - np.floor(u[0]) + 1).astype(np.float32), (rows, 1))
    map_v = np.repeat(np.clip(v - top, 0, RISE - 1 - top).astype(np.float32)[:, None], columns, 1)
    sky = cv2.remap(piece, map_u, map_v, cv2.INTER_LINEAR)
    empty = inverse_depth == 0
    picture[empty] = sky[empty]
