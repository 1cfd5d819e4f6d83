"""The compiled drawing kernels: textured planes with depth, and the ground.

A canvas is (H, W, 4) float32: blue, green, red as the surface reflects it in white light (0-255),
and glow, how much of that the surface sends out by itself (0-255). Beside it stands the inverse
depth (H, W) float32 in 1/metre, 0 at infinity. Camera axes: x right, y up, z ahead, in metres.
"""

import numpy as np
from numpy.typing import NDArray

from amusic_gym.kernels.compiling import compiled, inner

NEAR = 0.6  # metres: nothing nearer is drawn
Floats = NDArray[np.float32]
Vector = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Table = NDArray[np.int64]
Lens = tuple[float, float, float]


@inner
def _bilinear(
    pixels: Bytes, start: int, width: int, height: int, u: float, v: float, out: Floats
) -> None:
    """Sample five channels; outside the texture all are 0."""
    u0 = int(np.floor(u))
    v0 = int(np.floor(v))
    fu = np.float32(u - u0)
    fv = np.float32(v - v0)
    one = np.float32(1.0)
    top_left = (one - fu) * (one - fv)
    top_right = fu * (one - fv)
    bottom_left = (one - fu) * fv
    bottom_right = fu * fv
    if u0 < 0 or u0 + 1 >= width:
        left_in, right_in = 0 <= u0 < width, 0 <= u0 + 1 < width
        top_left, bottom_left = top_left * left_in, bottom_left * left_in
        top_right, bottom_right = top_right * right_in, bottom_right * right_in
    if v0 < 0 or v0 + 1 >= height:
        top_in, bottom_in = 0 <= v0 < height, 0 <= v0 + 1 < height
        top_left, top_right = top_left * top_in, top_right * top_in
        bottom_left, bottom_right = bottom_left * bottom_in, bottom_right * bottom_in
    u1 = min(max(u0 + 1, 0), width - 1)
    v1 = min(max(v0 + 1, 0), height - 1)
    u0 = min(max(u0, 0), width - 1)
    v0 = min(max(v0, 0), height - 1)
    a = start + 5 * (v0 * width + u0)
    b = start + 5 * (v0 * width + u1)
    c = start + 5 * (v1 * width + u0)
    d = start + 5 * (v1 * width + u1)
    for channel in range(5):
        out[channel] = (
            top_left * np.float32(pixels[a + channel])
            + top_right * np.float32(pixels[b + channel])
            + bottom_left * np.float32(pixels[c + channel])
            + bottom_right * np.float32(pixels[d + channel])
        )


@inner
def _level_of(texels: float, levels: int) -> int:
    """The halved copy in which one screen pixel covers about one texel."""
    level = 0
    while texels > 1.5 and level < levels - 1:
        texels *= 0.5
        level += 1
    return level


@inner
def _clip(corner: Vector, along: Vector) -> tuple[float, float]:
    """The part of ``along`` in front of the camera, from and to; empty if not from < to."""
    begin, end = 0.0, 1.0
    if along[2] != 0.0:
        cut = (NEAR - corner[2]) / along[2]
        if along[2] > 0.0:
            begin = max(begin, cut)
        else:
            end = min(end, cut)
    elif corner[2] < NEAR:
        end = -1.0
    return begin, end


@inner
def _screen_box(
    corner: Vector, along: Vector, up: Vector, lens: Lens, begin: float, end: float
) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of a parallelogram on the screen."""
    focal, centre_x, centre_y = lens
    left, right, top, bottom = 1e9, -1e9, 1e9, -1e9
    for a in (begin, end):
        for b in (0.0, 1.0):
            z = corner[2] + a * along[2]
            x = centre_x + focal * (corner[0] + a * along[0] + b * up[0]) / z
            y = centre_y - focal * (corner[1] + a * along[1] + b * up[1]) / z
            left, right = min(left, x), max(right, x)
            top, bottom = min(top, y), max(bottom, y)
    return left, right, top, bottom


@inner
def _invert(corner: Vector, along: Vector, up: Vector, lens: Lens, out: Vector) -> bool:
    """From screen to texture: (x, y, 1) = M (a, b, 1) / depth; ``out`` takes M^-1, row by row.

    False when the plane is seen edge-on.
    """
    focal, centre_x, centre_y = lens
    az, bz, cz = along[2], up[2], corner[2]
    ax, ay = focal * along[0] + centre_x * az, -focal * along[1] + centre_y * az
    bx, by = focal * up[0] + centre_x * bz, -focal * up[1] + centre_y * bz
    cx, cy = focal * corner[0] + centre_x * cz, -focal * corner[1] + centre_y * cz
    whole = ax * (by * cz - cy * bz) - bx * (ay * cz - cy * az) + cx * (ay * bz - by * az)
    if abs(whole) < 1e-9:
        return False
    out[0], out[1], out[2] = by * cz - cy * bz, cx * bz - bx * cz, bx * cy - cx * by
    out[3], out[4], out[5] = cy * az - ay * cz, ax * cz - cx * az, cx * ay - ax * cy
    out[6], out[7], out[8] = ay * bz - by * az, bx * az - ax * bz, ax * by - bx * ay
    for index in range(9):
        out[index] /= whole
    return True


@inner
def _blend(
    canvas: Floats, inverse_depth: Floats, y: int, x: int, near: float, sample: Floats, gain: Floats
) -> None:
    """Lay a sample over a pixel."""
    alpha = sample[3] / np.float32(255.0)
    if alpha < np.float32(0.02):
        return
    rest = np.float32(1.0) - alpha
    for channel in range(3):
        canvas[y, x, channel] = canvas[y, x, channel] * rest + sample[channel] * gain[channel]
    canvas[y, x, 3] = canvas[y, x, 3] * rest + sample[4]
    if alpha > np.float32(0.5):
        inverse_depth[y, x] = near


@inner
def _fill(
    canvas: Floats, inverse_depth: Floats, pixels: Bytes, table: Table, m: Vector, gain: Floats,
    box: tuple[int, int, int, int],
) -> None:  # fmt: skip
    """Draw the texture over the pixels of a box, where nothing nearer stands."""
    x0, x1, y0, y1 = box
    levels = table.shape[0]
    full_width, full_height = table[0, 1], table[0, 2]
    sample = np.zeros(5, np.float32)
    level = 0
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            near = m[6] * x + m[7] * y + m[8]
            if near <= 1e-4 or near > 1.0 / NEAR or near < 0.998 * inverse_depth[y, x]:
                continue
            far = 1.0 / near
            a = (m[0] * x + m[1] * y + m[2]) * far
            b = 1.0 - (m[3] * x + m[4] * y + m[5]) * far
            if a < -0.1 or a > 1.1 or b < -0.1 or b > 1.1:
                continue
            if x == x0 or x & 3 == 0:
                step_x = abs(m[0] - a * m[6]) * far * full_width
                step_y = abs(m[4] - (1.0 - b) * m[7]) * far * full_height
                wide = max(0.6 * max(step_x, step_y), min(step_x, step_y))
                level = _level_of(wide, levels)
            w, h = table[level, 1], table[level, 2]
            _bilinear(pixels, table[level, 0], w, h, a * w - 0.5, b * h - 0.5, sample)
            _blend(canvas, inverse_depth, y, x, near, sample, gain)


@compiled
def draw_plane(
    canvas: Floats, inverse_depth: Floats, pixels: Bytes, table: Table, corner: Vector,
    along: Vector, up: Vector, lens: Lens, gain: Floats,
) -> None:  # fmt: skip
    """Draw a textured parallelogram where nothing nearer stands.

    Args:
        canvas: (H, W, 4) float32, changed in place.
        inverse_depth: (H, W) float32, changed in place.
        pixels: (N,) uint8, all levels of the texture, five channels each: blue, green and red
            times alpha, alpha, glow times alpha.
        table: (L, 3) int64: start in ``pixels``, width, height of each level.
        corner: (3,) float64 camera coordinates of the texture's lower left.
        along: (3,) from there to the lower right.
        up: (3,) from there to the upper left; its depth is 0.
        lens: (focal length, centre x, centre y) in pixels.
        gain: (3,) float32 by which blue, green, red are multiplied.
    """
    begin, end = _clip(corner, along)
    if begin >= end:
        return
    left, right, top, bottom = _screen_box(corner, along, up, lens, begin, end)
    height, width = inverse_depth.shape
    if left > width or right < -1 or top > height or bottom < -1:
        return
    x0, x1 = max(0, int(left)), min(width - 1, int(right) + 1)
    box = (x0, x1, max(0, int(top)), min(height - 1, int(bottom) + 1))
    m = np.empty(9)
    if (right - left) * (bottom - top) >= 0.5 and _invert(corner, along, up, lens, m):
        _fill(canvas, inverse_depth, pixels, table, m, gain, box)


@compiled
def draw_level(
    canvas: Floats, inverse_depth: Floats, pixels: Bytes, table: Table, detail: Floats,
    height: float, view: tuple[float, float, float, float], bends: Vector, lens: Lens,
) -> None:  # fmt: skip
    """Draw the ground (``height`` below the camera) or a ceiling (above it) to the horizon.

    Args:
        canvas: (H, W, 4) float32, changed in place.
        inverse_depth: (H, W) float32, changed in place.
        pixels: (N,) uint8 all levels of the map seen from above, five channels as `draw_plane`'s.
            Rows run ahead along the path, columns from left to right.
        table: (L, 3) int64: start, columns, rows of each level.
        detail: (D, D) float32 tileable grain around 1, 64 texels per metre.
        height: of the plane over the camera in metres; negative for the ground.
        view: (metres ahead of the map's first row at which the camera stands, its metres from the
            map's left edge, texels per metre along, texels per metre across).
        bends: (B,) float64 how far the path has bent to the right after each metre ahead.
        lens: (focal length, centre x, centre y) in pixels.
    """
    focal, centre_x, centre_y = lens
    ahead, across, texels_along, texels_across = view
    rows, columns = inverse_depth.shape
    sample = np.zeros(5, np.float32)
    grain = detail.shape[0]
    levels = table.shape[0]
    for y in range(rows):
        drop = (centre_y - y) / focal
        if drop * height <= 1e-6:
            continue
        z = height / drop
        if z < 0.3 or z > 400.0:
            continue
        metre = min(int(z), len(bends) - 2)
        part = min(z - metre, 1.0)
        bend = bends[metre] * (1.0 - part) + bends[metre + 1] * part
        step_along = z * z / (focal * abs(height)) * texels_along
        step_across = z / focal * texels_across
        level = _level_of(max(0.35 * step_along, step_across), levels)
        w, h = table[level, 1], table[level, 2]
        scale = 1.0 / (1 << level)
        v = min((ahead + z) * texels_along * scale - 0.5, h - 1.0)
        strength = np.float32(min(1.0, max(0.0, 1.5 - step_along / texels_along * 16.0)))
        grain_row = int((ahead + z) * 64.0) % grain
        for x in range(columns):
            if inverse_depth[y, x] > 1.0 / z:
                continue
            lateral = (x - centre_x) / focal * z + across - bend
            u = min(max(lateral * texels_across * scale - 0.5, 0.0), w - 1.0)
            _bilinear(pixels, table[level, 0], w, h, u, v, sample)
            factor = np.float32(1.0)
            if strength > 0.0:
                factor += strength * (detail[grain_row, int(lateral * 64.0) % grain] - factor)
            for channel in range(3):
                canvas[y, x, channel] = sample[channel] * factor
            canvas[y, x, 3] = sample[4]
            inverse_depth[y, x] = 1.0 / z
