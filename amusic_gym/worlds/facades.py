"""Houses: fronts of many materials with windows, doors, shops, signs and wear; sides and roofs."""

from dataclasses import dataclass

import cv2
import numpy as np

from amusic_gym.worlds.noise import Generator, generator, patch
from amusic_gym.worlds.paint import Colour, Paint, dim, pick, vary

PLASTER = ((190, 205, 215), (160, 190, 215), (140, 170, 205), (185, 200, 190), (200, 200, 200),
           (150, 160, 205), (165, 195, 200), (120, 150, 190))  # fmt: skip
BRICK = ((70, 85, 140), (60, 70, 115), (90, 110, 150), (80, 90, 105), (110, 140, 165))
STONE = ((150, 165, 175), (130, 140, 150), (165, 175, 180))
WOOD = ((60, 80, 130), (170, 175, 175), (80, 95, 90), (50, 55, 120), (130, 120, 95))
PANEL = ((150, 155, 155), (125, 125, 125), (175, 165, 150))
TRIM = ((225, 230, 230), (200, 205, 210), (60, 65, 70), (120, 140, 150), (70, 85, 60))
DOORS = ((50, 60, 90), (60, 90, 40), (40, 40, 120), (120, 80, 40), (40, 45, 50), (90, 100, 110))
SIGNS = ((40, 40, 190), (160, 80, 30), (50, 130, 40), (40, 180, 220), (30, 30, 30), (220, 220, 220),
         (120, 40, 110))  # fmt: skip
WALLS = {"plaster": PLASTER, "brick": BRICK, "stone": STONE, "wood": WOOD, "panel": PANEL}
MATERIALS = ("plaster", "plaster", "brick", "brick", "stone", "wood", "panel")


@dataclass(frozen=True)
class Style:
    """What houses of one type share; many stand in a row of them."""

    material: str
    wall: Colour
    trim: Colour
    door: Colour
    storey: float
    bay: float
    window: tuple[float, float]
    bars: tuple[int, int]
    arched: bool
    shutters: bool
    bands: bool
    balconies: bool


def style_of(seed: int, index: int) -> Style:
    """House type ``index`` of a world."""
    rng = generator(seed, "style", index)
    material = MATERIALS[int(rng.integers(len(MATERIALS)))]
    bay = rng.uniform(1.7, 3.6)
    storey = rng.uniform(2.7, 3.7)
    wide = bay * rng.uniform(0.35, 0.75)
    return Style(
        material=material,
        wall=pick(rng, WALLS[material]),
        trim=pick(rng, TRIM),
        door=pick(rng, DOORS),
        storey=storey,
        bay=bay,
        window=(wide, storey * rng.uniform(0.42, 0.7)),
        bars=(int(rng.integers(0, 3)), int(rng.integers(0, 3))),
        arched=rng.random() < 0.2,
        shutters=rng.random() < 0.25 and wide < 0.6 * bay,
        bands=rng.random() < 0.5,
        balconies=rng.random() < 0.2,
    )


def courses(paint: Paint, rng: Generator, material: str) -> None:
    """Bricks, ashlar, boards or panels over the whole surface."""
    rows, columns = paint.rows, paint.columns
    if material == "plaster":
        paint.shade(patch(rng, rows, columns, 0.8), 0.05)
        return
    along, up = {"brick": (0.42, 0.14), "stone": (0.7, 0.35), "wood": (50.0, 0.18),
                 "panel": (2.4, 1.5)}[material]  # fmt: skip
    y = (np.arange(rows)[::-1, None] / paint.texels) / up
    course = np.floor(y).astype(int)
    x = np.arange(columns)[None, :] / paint.texels / along + 0.5 * (course % 2)
    cell = (np.floor(x).astype(int) * 7919 + course * 104729) % 1021
    tone = rng.normal(0, 1, 1021).astype(np.float32)[cell]
    joint = ((y % 1) < 0.5 / (up * paint.texels) + 0.04) | ((x % 1) < 1.2 / (along * paint.texels))
    contrast = {"brick": 0.13, "stone": 0.09, "wood": 0.05, "panel": 0.03}[material]
    paint.shade(np.where(joint, -2.0, tone).astype(np.float32), contrast)


def window(
    paint: Paint, rng: Generator, x: float, y: float, style: Style, sill_snow: bool, lit: bool
) -> None:
    """One window with frame, bars, a reflection or a curtain, its sill and shutters."""
    wide, high = style.window
    frame = 0.07
    edge: Colour = dim(style.wall, 0.55)
    paint.box(x - 0.06, y - 0.06, x + wide + 0.06, y + high + 0.09, edge)
    paint.box(x - 0.03, y, x + wide + 0.03, y + high + 0.05, style.trim)
    depth = rng.uniform(15, 75)
    glass: Colour = (depth * 1.25, depth * 1.12, depth)
    glow = rng.uniform(120, 255) if lit else 0
    paint.box(x + frame, y + frame, x + wide - frame, y + high - frame, glass, 0)
    top, bottom = paint.at(0, y + high - frame)[1], paint.at(0, y + frame)[1]
    left, right = paint.at(x + frame, 0)[0], paint.at(x + wide - frame, 0)[0]
    pane = paint.colour[max(0, top) : bottom, max(0, left) : right]
    if pane.size:
        shine = patch(rng, pane.shape[0], pane.shape[1], 1.4)
        slope = np.linspace(1.3, 0.6, pane.shape[0], dtype=np.float32)[:, None]
        pane[:] = np.clip(pane * slope[..., None] + 22 * shine[..., None], 4, 235)
        if rng.random() < 0.4:  # curtain or blind
            share = rng.uniform(0.2, 1.0)
            pane[: max(1, int(share * pane.shape[0]))] = vary(rng, (185, 195, 200), 25)
        if lit:
            warm = np.array([120, 190, 235]) + rng.normal(0, 18, 3)
            paint.glow[max(0, top) : bottom, max(0, left) : right] = glow
            pane[:] = np.clip(0.35 * pane + 0.65 * warm, 0, 255)
    for bar in range(style.bars[0]):
        middle = x + wide * (bar + 1) / (style.bars[0] + 1)
        paint.box(middle - 0.03, y, middle + 0.03, y + high, style.trim)
    for bar in range(style.bars[1]):
        middle = y + high * (bar + 1) / (style.bars[1] + 1)
        paint.box(x, middle - 0.03, x + wide, middle + 0.03, style.trim)
    if style.arched:
        paint.disk(x + wide / 2, y + high, wide / 2, 0.22, style.trim)
    if style.shutters:
        for side in (x - 0.5 * wide - 0.05, x + wide + 0.05):
            paint.box(side, y, side + 0.5 * wide, y + high, style.door)
            for slat in np.arange(y + 0.1, y + high, 0.16):
                paint.box(side, slat, side + 0.5 * wide, slat + 0.05, vary(rng, style.door, 20))
    sill = (235, 238, 240) if sill_snow else style.trim
    paint.box(x - 0.1, y - 0.1, x + wide + 0.1, y + (0.04 if sill_snow else -0.02), sill)


def shop(paint: Paint, rng: Generator, x0: float, x1: float, high: float, open_: bool) -> None:
    """A shop front: display, door, fascia with lettering, sometimes an awning."""
    frame = pick(rng, TRIM)
    paint.box(x0, 0, x1, high, frame)
    glow = rng.uniform(120, 230) if open_ else 0
    x = x0 + 0.15
    while x < x1 - 0.6:
        wide = min(rng.uniform(0.9, 2.2), x1 - 0.15 - x)
        low = rng.choice([0.1, 0.5])
        paint.box(x, low, x + wide, high - 0.75, vary(rng, (70, 65, 60), 25), glow)
        for _ in range(int(rng.integers(3, 10))):  # goods in the window
            gx, gy = rng.uniform(x, x + wide - 0.2), rng.uniform(0.5, high - 1.1)
            size = rng.uniform(0.1, 0.45)
            end = min(gx + size, x + wide)
            paint.box(gx, gy, end, min(gy + size, high - 0.8), pick(rng, SIGNS), glow)
        x += wide + 0.12
    board = pick(rng, SIGNS)
    paint.box(x0, high - 0.65, x1, high, board, 90 if open_ else 0)
    lettering(paint, rng, x0 + 0.3, high - 0.52, x1 - x0 - 0.6, 0.38, board)
    if rng.random() < 0.35:
        cloth = pick(rng, SIGNS)
        for stripe, sx in enumerate(np.arange(x0, x1 - 0.05, 0.35)):
            tint = cloth if stripe % 2 else (225.0, 228.0, 230.0)
            paint.box(sx, high - 1.25, min(sx + 0.35, x1), high - 0.7, tint)


def lettering(
    paint: Paint, rng: Generator, x: float, y: float, wide: float, high: float,
    board: Colour,
) -> None:  # fmt: skip
    """Strokes that look like words from where a camera passes."""
    ink: Colour = (240, 240, 240) if sum(board) < 380 else (30, 30, 40)
    end = x + wide * rng.uniform(0.5, 1.0)
    while x < end:
        step = high * rng.uniform(0.45, 0.8)
        if rng.random() < 0.85:
            for ax, bx, ay, by in rng.random((3 if step > 0.6 * high else 2, 4)).tolist():
                low, top = y + high / 2 * int(3 * ay), y + high / 2 * int(3 * by)
                left = x + 0.75 * step * ax
                paint.line(left, low, x + 0.75 * step * bx, top, high * 0.16, ink)
        x += step


def facade(
    seed: int, season: str, number: int, kind: int, wide: float, storeys: int, use: str
) -> Paint:
    """A front ``wide`` metres wide; equal numbers give equal houses.

    Its type is ``kind``, see :func:`style_of`, its use "home", "shop" or "hall".
    """
    style = style_of(seed, kind)
    rng = generator(seed, "facade", number)
    high = storeys * style.storey + 0.7
    paint = Paint(wide, high, style.wall)
    courses(paint, rng, style.material)
    snow = season == "winter"
    count = max(1, int((wide - 0.4) / style.bay))
    margin = (wide - count * style.bay) / 2
    entrance = int(rng.integers(count))
    lit_share = rng.uniform(0.15, 0.55)
    for floor in range(storeys):
        base = floor * style.storey + 0.4
        if style.bands and floor:
            paint.box(0, base - 0.25, wide, base - 0.08, style.trim)
        for bay in range(count):
            lit = bool(rng.random() < lit_share)
            x = margin + bay * style.bay + (style.bay - style.window[0]) / 2
            if floor == 0 and (use == "shop" or bay == entrance):
                continue
            if use == "hall" and rng.random() < 0.3:
                continue
            sill = base + 0.22 * style.storey
            window(paint, rng, x, min(sill, high - style.window[1] - 0.3), style, snow, lit)
            if style.balconies and floor and bay % 2 == 0:
                balcony(paint, rng, x - 0.3, base + 0.1, style.window[0] + 0.6)
    if use == "shop":
        shop(paint, rng, 0.15, wide - 0.15, style.storey, open_=bool(rng.random() < 0.8))
    else:
        doorway(paint, rng, margin + (entrance + 0.5) * style.bay, style, garage=use == "hall")
    paint.box(0, high - 0.35, wide, high, style.trim)
    paint.box(0, high - 0.45, wide, high - 0.35, dim(style.wall, 0.5))
    if use != "shop":
        paint.box(0, 0, wide, 0.35, vary(rng, (105, 108, 110), 15))
    extras(paint, rng, wide, high)
    paint.weather(rng)
    if snow:
        paint.box(0, high - 0.18, wide, high, (236, 238, 240))
    ramp = np.linspace(1.03, 0.86, paint.rows, dtype=np.float32)[:, None]
    paint.colour[:] = np.clip(paint.colour * ramp[..., None], 0, 255)
    return paint


def doorway(paint: Paint, rng: Generator, x: float, style: Style, garage: bool) -> None:
    """A door with steps, or a wide gate."""
    wide, high = (2.6, 2.5) if garage else (rng.uniform(0.9, 1.4), rng.uniform(2.0, 2.4))
    paint.box(x - wide / 2 - 0.14, 0, x + wide / 2 + 0.14, high + 0.4, style.trim)
    paint.box(x - wide / 2, 0.1, x + wide / 2, high, style.door)
    for row in range(2 if not garage else 5):
        step = high / (2 if not garage else 5)
        paint.box(x - 0.4 * wide, 0.2 + row * step, x + 0.4 * wide, row * step + step - 0.08,
                  vary(rng, style.door, 14))  # fmt: skip
    paint.box(x - wide / 2, high, x + wide / 2, high + 0.28, (80, 75, 65), 140)
    paint.box(x - wide / 2 - 0.3, 0, x + wide / 2 + 0.3, 0.16, (150, 155, 158))


def balcony(paint: Paint, rng: Generator, x: float, y: float, wide: float) -> None:
    """A slab with a railing."""
    rail = vary(rng, (60, 62, 65), 15)
    paint.box(x, y - 0.12, x + wide, y, (140, 142, 145))
    paint.box(x, y + 0.9, x + wide, y + 0.96, rail)
    for bar in np.arange(x, x + wide, 0.16):
        paint.box(bar, y, bar + 0.03, y + 0.9, rail)


def extras(paint: Paint, rng: Generator, wide: float, high: float) -> None:
    """Downpipes, vents, cables, plates, ivy and graffiti: clutter at small scales."""
    if rng.random() < 0.7:
        x = rng.choice([0.15, wide - 0.25])
        paint.box(x, 0, x + 0.1, high - 0.4, vary(rng, (110, 115, 120), 20))
    for _ in range(int(rng.integers(0, 5))):
        x, y = rng.uniform(0.2, max(0.3, wide - 0.8)), rng.uniform(1.2, high - 0.8)
        paint.box(x, y, x + rng.uniform(0.15, 0.6), y + rng.uniform(0.15, 0.5),
                  vary(rng, (140, 140, 140), 45))  # fmt: skip
    if rng.random() < 0.12:
        leaves(paint, rng, wide, high)
    if rng.random() < 0.15:
        x, ink = rng.uniform(0, wide), pick(rng, SIGNS)
        for _ in range(8):
            x0, y0 = x + rng.uniform(-1, 1), rng.uniform(0.4, 1.7)
            paint.line(x0, y0, x0 + rng.uniform(-0.5, 0.5), rng.uniform(0.4, 1.7), 0.09, ink)


def leaves(paint: Paint, rng: Generator, wide: float, high: float) -> None:
    """Ivy over a part of the wall."""
    middle, reach = rng.uniform(0, wide), rng.uniform(1, 3)
    for _ in range(260):
        x, y = rng.normal(middle, reach * 0.5), abs(rng.normal(0, high * 0.35))
        paint.disk(x, y, 0.12, 0.1, vary(rng, (40, 85, 55), 20))


def roof(seed: int, season: str, number: int, wide: float, deep: float) -> Paint:
    """Tiles of a roof seen from the street."""
    rng = generator(seed, "roof", number)
    tile = pick(rng, ((60, 75, 130), (70, 70, 75), (55, 60, 95), (90, 95, 95)))
    paint = Paint(wide, deep, tile, texels=16)
    y = np.arange(paint.rows)[:, None] / 16 / 0.33
    x = np.arange(paint.columns)[None, :] / 16 / 0.3
    ribs = np.cos(2 * np.pi * x) * 0.6 + np.where((y % 1) < 0.3, -1.3, 0.4)
    paint.shade(ribs.astype(np.float32), 0.14)
    for _ in range(int(rng.integers(0, 3))):
        wx = rng.uniform(0.5, max(0.6, wide - 1.5))
        paint.box(wx, deep * 0.3, wx + 0.9, deep * 0.65, (190, 180, 170))
    paint.weather(rng)
    if season == "winter":
        cover = patch(rng, paint.rows, paint.columns, 1.3, zoom=1.5) > -0.9
        paint.colour[cover] = 232
        paint.shade(patch(rng, paint.rows, paint.columns, 1.2), 0.03)
    return paint


def side(seed: int, season: str, number: int, kind: int, deep: float, high: float) -> Paint:
    """A side wall: the material, few windows, perhaps an old advertisement."""
    style = style_of(seed, kind)
    rng = generator(seed, "side", number)
    paint = Paint(deep, high, vary(rng, style.wall, 8), texels=20)
    courses(paint, rng, style.material)
    if rng.random() < 0.35:
        board = pick(rng, SIGNS)
        x, y = rng.uniform(0, max(0.1, deep - 3)), rng.uniform(1.5, max(1.6, high - 3))
        paint.box(x, y, x + 2.8, y + 1.8, board)
        lettering(paint, rng, x + 0.2, y + 0.9, 2.3, 0.5, board)
    for floor in range(int(high / style.storey)):
        if rng.random() < 0.5:
            x = rng.uniform(0.5, max(0.6, deep - 1.5))
            y = floor * style.storey + 1.0
            window(paint, rng, x, y, style, sill_snow=False, lit=bool(rng.random() < 0.3))
    extras(paint, rng, deep, high)
    paint.weather(rng, 0.07, 0.16)
    cv2.GaussianBlur(paint.colour, (3, 3), 0.5, dst=paint.colour)
    return paint


def gable(seed: int, season: str, number: int, kind: int, deep: float, rise: float) -> Paint:
    """The triangle of a side wall under the roof."""
    paint = side(seed, season, number, kind, deep, rise)
    cover = np.zeros_like(paint.alpha)
    corners = np.array([[0, paint.rows], [paint.columns, paint.rows], [paint.columns // 2, 0]])
    cv2.fillPoly(cover, [corners.astype(np.int32)], 255)
    paint.alpha &= cover
    return paint
