"""The picture: what stands where, and that it tells the truth about its scene."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest

from amusic_gym.envs.pictures import Scene, Trail, layout, route
from amusic_gym.envs.pictures.canvas import INK, PAPER, Box, Canvas, fitted, plain, text_width
from amusic_gym.envs.pictures.layout import (
    BAR,
    GAUGES,
    LEFT_PANEL,
    RIGHT_PANEL,
    TECHNIQUES,
    draw,
    tile,
)
from amusic_gym.envs.pictures.substitutes import peaks
from amusic_gym.utils.colours import CORRECT_COLOUR, WRONG_COLOUR, technique_colours

NAMES = ("HOG", "CoHOG", "CALC", "NetVLAD")


def rgb(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def colour_at(picture, x: int, y: int) -> tuple[int, ...]:
    return tuple(int(c) for c in picture[y, x])


def cut(picture, box: Box):
    return picture[box.top : box.bottom, box.left : box.right]


def holds(picture, colour: str) -> bool:
    return bool((picture == rgb(colour)).all(axis=2).any())


def trail_of(predictions, *, ran=(True, False, True, False), trusted=2, correct=None) -> Trail:
    trail = Trail()
    for prediction in predictions:
        places = [prediction + 2 * t for t in range(len(ran))]
        trail.add(prediction, trusted, ran, places, 0.5, correct)
    return trail


def scene(**changes) -> Scene:
    given = {
        "title": "corridor, A-MuSIC",
        "techniques": NAMES,
        "references": 101,
        "frames": 50,
        "trail": trail_of(range(20)),
        "confidence": 4.0,
        "p_correct": 0.75,
        "query": np.full((60, 80, 3), (255, 0, 0), np.uint8),  # blue, as OpenCV has it
        "place": np.full((60, 80, 3), (0, 128, 0), np.uint8),
    }
    return Scene(**{**given, **changes})


def rows(scene: Scene, seed: int = 0) -> dict[int, np.ndarray]:
    rng = np.random.default_rng(seed)
    ran = np.flatnonzero(scene.ran)
    return {int(t): rng.normal(size=scene.references).astype(np.float32) for t in ran}


# ---- layout ------------------------------------------------------------------------------


def test_photographs_are_shown_in_their_colours_side_by_side():
    picture = draw(scene())
    assert picture.shape == (540, 960, 3)
    assert picture.dtype == np.uint8
    for panel, colour in ((LEFT_PANEL, (0, 0, 255)), (RIGHT_PANEL, (0, 128, 0))):
        middle = (panel.left + panel.right) // 2, (panel.top + panel.bottom) // 2
        assert colour_at(picture, *middle) == colour


@pytest.mark.parametrize("size", [(30, 90), (90, 30), (1000, 2000), (1, 1)])
def test_photographs_are_whole_undistorted_and_in_the_middle(size):
    canvas = Canvas(300, 200)
    box = Box(20, 10, 220, 110)
    image = np.full((*size, 3), 7, np.uint8)
    at = canvas.photograph(image, box)
    assert at.height / at.width == pytest.approx(size[0] / size[1], rel=0.05)
    assert at.width == box.width or at.height == box.height
    assert abs((at.left - box.left) - (box.right - at.right)) <= 1
    assert (cut(canvas.pixels, at) == 7).all()
    assert (canvas.pixels == 7).all(axis=2).sum() == at.width * at.height


def test_lamps_are_lit_where_a_technique_ran_and_the_trusted_one_is_framed():
    picture = draw(scene())
    colours = list(technique_colours(NAMES).values())
    for i, ran in enumerate((True, False, True, False)):
        y = TECHNIQUES.top + i * 40 + 6
        assert colour_at(picture, TECHNIQUES.left + 6, y) == rgb(colours[i] if ran else PAPER)
        edge = colour_at(picture, TECHNIQUES.left + 2, y + 10)
        assert (edge == rgb(INK)) == (i == 2)


def test_milliseconds_stand_on_the_lamps_that_are_lit():
    without, given = draw(scene()), draw(scene(milliseconds=np.array([12.3, 0.0, 4.5, 0.0])))
    for i, ran in enumerate((True, False, True, False)):
        lamp = Box(TECHNIQUES.left, TECHNIQUES.top + 40 * i, TECHNIQUES.right, 380 + 40 * i)
        assert (cut(without, lamp) != cut(given, lamp)).any() == ran


@pytest.mark.parametrize(
    ("changes", "row", "share"),
    [
        ({"p_correct": 0.75}, 0, 0.75),
        ({"p_correct": 0.0}, 0, 0.0),
        ({"p_correct": None}, 0, 0.0),
        ({"confidence": 4.0}, 1, 0.5),
        ({"confidence": -3.0}, 1, 0.0),
        ({}, 2, 0.5),
    ],
)
def test_bars_are_as_long_as_they_say(changes, row, share):
    line = draw(scene(**changes))[GAUGES.top + 8 + 54 * row + 16, GAUGES.left : GAUGES.right]
    long = (line == rgb(BAR)).all(axis=1).sum() + (line == rgb(INK)).all(axis=1).sum()
    assert long == pytest.approx(share * GAUGES.width, abs=3)


@pytest.mark.parametrize(("correct", "colour"), [(True, CORRECT_COLOUR), (False, WRONG_COLOUR)])
def test_right_and_wrong_are_shown_only_where_the_truth_is_given(correct, colour):
    judged = draw(scene(trail=trail_of(range(20), correct=correct)))
    frame = RIGHT_PANEL.left - 3, RIGHT_PANEL.top + 40
    assert colour_at(judged, *frame) == rgb(colour)
    unknown = draw(scene())
    assert colour_at(unknown, *frame) == rgb(PAPER)
    assert not holds(unknown, CORRECT_COLOUR)
    assert not holds(unknown, WRONG_COLOUR)


def test_right_and_wrong_differ_without_colour():
    grey = [
        draw(scene(trail=trail_of(range(20), correct=np.bool_(correct)))).mean(axis=2)
        for correct in (True, False)
    ]
    frame = RIGHT_PANEL.top + 40, RIGHT_PANEL.left - 3
    assert abs(grey[0][frame] - grey[1][frame]) > 60


def test_pictures_are_tiled_in_the_size_of_one():
    one = draw(scene())
    assert tile([one]) is one
    three = tile([np.full_like(one, value) for value in (10, 20, 30)])
    assert three.shape == one.shape
    corners = [three[5, 5, 0], three[5, -5, 0], three[-5, 5, 0], three[-5, -5, 0]]
    assert corners == [10, 20, 30, 255]


# ---- the route's strip -------------------------------------------------------------------


def trail_dots(picture, colour: str) -> np.ndarray:
    """(n, 2) y and x in the strip of the trail."""
    plot = layout.ROUTE._replace(bottom=layout.ROUTE.bottom - 50)
    return np.argwhere((cut(picture, plot) == rgb(colour)).all(axis=2))


def test_the_trail_runs_from_the_lower_left_to_the_upper_right():
    picture = draw(scene(references=50, trail=trail_of(range(50))))
    dots = trail_dots(picture, technique_colours(NAMES)["CALC"])
    heights = dots[np.argsort(dots[:, 1])][:, 0]
    assert heights[0] > heights[len(heights) // 2] > heights[-1]
    assert dots[:, 1].min() <= 4
    half = draw(scene(references=50, trail=trail_of(range(25))))
    ended = trail_dots(half, technique_colours(NAMES)["CALC"])[:, 1].max()
    assert ended == pytest.approx(layout.ROUTE.width / 2, abs=14)


def test_dots_have_the_colour_of_the_trusted_technique():
    other = draw(scene(trail=trail_of(range(20), trusted=0)))
    assert not trail_dots(other, technique_colours(NAMES)["CALC"]).size
    assert trail_dots(other, technique_colours(NAMES)["HOG"]).size


def test_frames_without_a_place_leave_no_dot():
    empty = draw(scene(trail=trail_of([-1, -1, -1])))
    assert not trail_dots(empty, technique_colours(NAMES)["CALC"]).size
    assert not trail_dots(empty, INK).size


def test_wrong_places_are_crossed_out():
    trail = trail_of(range(10), correct=True)
    assert not holds(cut(draw(scene(trail=trail)), layout.ROUTE), WRONG_COLOUR)  # the whole strip
    trail.add(90, 0, (True,) * 4, (90,) * 4, 1.0, correct=np.bool_(False))
    assert holds(cut(draw(scene(trail=trail)), layout.ROUTE), WRONG_COLOUR)


def test_lanes_show_what_ran_and_grow_paler_where_a_pixel_holds_frames_without():
    trail = Trail()
    for frame in range(1600):  # four to a pixel
        trail.add(0, 0, (True, False, frame % 2 == 0, False), (0,) * 4, 0.5)
    picture = draw(scene(frames=1600, trail=trail))
    colours = [np.array(rgb(c), float) for c in technique_colours(NAMES).values()]
    top = layout.ROUTE.bottom - route.AXIS - 4 * route.LANE - 1
    shown = [picture[top + lane * route.LANE + 2, layout.ROUTE.left + 50] for lane in range(4)]
    for lane, share in enumerate((1.0, 0.0, 0.5, 0.0)):
        np.testing.assert_allclose(shown[lane], 255 + share * (colours[lane] - 255), atol=1)


@pytest.mark.parametrize(
    ("frames", "seen", "span"), [(50, 20, 50), (None, 20, 64), (None, 64, 64), (None, 65, 128)]
)
def test_a_route_of_unknown_length_makes_room_as_it_goes(frames, seen, span):
    assert route.span_of(scene(frames=frames, trail=trail_of(range(seen)))) == span


# ---- without images ----------------------------------------------------------------------


def test_score_rows_and_last_matches_stand_in_for_photographs():
    bare = scene(query=None, place=None)
    picture = draw(dataclasses.replace(bare, rows=rows(bare)))
    for panel in (LEFT_PANEL, RIGHT_PANEL):
        for name, ran in zip(NAMES, (True, False, True, False), strict=True):
            assert holds(cut(picture, panel), technique_colours(NAMES)[name]) == ran


def test_a_camera_without_images_of_the_places_shows_its_matches():
    picture = draw(scene(place=None))
    assert holds(cut(picture, LEFT_PANEL), "#0000FF")
    assert holds(cut(picture, RIGHT_PANEL), technique_colours(NAMES)["HOG"])


@pytest.mark.parametrize("size", [1, 2, 40, 450, 5000])
def test_no_peak_of_a_row_is_lost_between_pixels(size):
    row = np.zeros(size, np.float32)
    row[size // 2] = 1.0
    pixels, z = peaks(row, 450)
    assert pixels.size == min(size, 450)
    assert (np.diff(pixels) > 0).all()
    best = pixels[np.argmax(z)]
    assert best == size // 2 * 449 // max(1, size - 1)
    assert z.max() == pytest.approx((1 - row.mean()) / row.std() if size > 1 else 0.0, rel=1e-4)


def test_a_constant_row_is_flat():
    assert not peaks(np.full(30, 0.4, np.float32), 20)[1].any()


# ---- whatever comes ----------------------------------------------------------------------


@pytest.mark.parametrize("techniques", [1, 2, 5, 6, 16])
@pytest.mark.parametrize("references", [1, 2, 3000])
@pytest.mark.parametrize("frames", [1, 30, None])
@pytest.mark.parametrize("seen", [0, 1, 30, 200])
def test_any_scene_can_be_drawn(techniques, references, frames, seen):
    rng = np.random.default_rng(seen)
    names = tuple(f"technique with a long name {i}" for i in range(techniques))
    trail = Trail()
    for _ in range(min(seen, frames or seen)):
        ran = rng.random(techniques) < 0.5
        places = rng.integers(-1, references, techniques)
        trail.add(places[0], rng.integers(-1, techniques), ran, places, rng.random() * 3)
    bare = scene(techniques=names, references=references, frames=frames, trail=trail,
                 query=None, place=None)  # fmt: skip
    picture = draw(dataclasses.replace(bare, rows=rows(bare)))
    edge = np.concatenate([picture[:, -6:].reshape(-1, 3), picture[-4:].reshape(-1, 3)])
    assert (edge == 255).all()  # nothing runs out of the picture


def test_the_images_of_a_scene_are_left_as_they_are():
    given = scene()
    query, place = given.query.copy(), given.place.copy()
    draw(given)[:] = 0
    np.testing.assert_array_equal(given.query, query)
    np.testing.assert_array_equal(given.place, place)


def test_text_is_shortened_to_fit_and_spelt_with_the_letters_there_are():
    assert plain("Café λ 北") == "Cafe ? ?"
    long = fitted("a technique with quite a long name", 90, 0.46)
    assert long.endswith("..")
    assert 60 < text_width(long, 0.46) <= 90
    assert fitted("HOG", 90, 0.46) == "HOG"
    assert fitted("HOG", 2, 0.46) == ""


def test_a_picture_is_drawn_fast():
    """At most 10 ms on a calm machine; here with room for a busy one."""
    given = scene(frames=3000, references=3000, trail=trail_of(range(3000)))
    draw(given)
    seconds = []
    for _ in range(15):
        begin = time.perf_counter()
        draw(given)
        seconds.append(time.perf_counter() - begin)
    assert min(seconds) < 0.03
