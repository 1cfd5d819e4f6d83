"""CoHOG: description and matching against the slow oracle, exact cases, and real scores."""

from __future__ import annotations

import threading

import cohog_oracle as oracle
import cv2
import numpy as np
import pytest
from corridor import data_folder
from recordings import read_folder

from amusic_gym.techniques import make_technique
from amusic_gym.techniques._cohog_description import local_entropy
from amusic_gym.techniques.cohog import (
    cells_of,
    inverse_lengths,
    regions_of_interest,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cohog():
    return make_technique("CoHOG")


def textured(seed, height=160, width=160):
    """A colour image of soft shapes."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (height // 8, width // 8, 3)).astype(np.uint8)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)


def grey_of(image):
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def half_flat(seed=0):
    """Left half one grey value, right half noise."""
    image = np.random.default_rng(seed).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    image[:, :80] = 128
    return image


# --- description ---------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(1, 1), (3, 4), (5, 17), (30, 20)])
@pytest.mark.parametrize("values", [1, 2, 9, 256])
def test_local_entropy_is_that_of_the_disk(shape, values):
    grey = np.random.default_rng(3).integers(0, values, shape).astype(np.uint8)
    found = np.full(shape, np.nan)
    local_entropy(grey, found)
    np.testing.assert_allclose(found, oracle.entropy(grey), atol=1e-12)


def test_cells_are_the_oracles():
    grey = grey_of(textured(1))
    expected = oracle.cells(grey)
    found = cells_of(grey).transpose(0, 2, 1)
    # OpenCV's arctangent is good to a third of a degree; a bin is 45° wide.
    assert np.abs(found - expected).max() <= 0.01 * expected.max()
    assert (oracle.regions(found) * oracle.regions(expected)).sum(axis=1).min() >= 0.9999


@pytest.mark.parametrize(("turns", "direction"), [(0, 0), (3, 2), (2, 4), (1, 6)])
def test_a_ramp_has_one_direction(turns, direction):
    ramp = np.tile(np.linspace(20, 220, 512).astype(np.uint8), (512, 1))  # brighter to the right
    cells = cells_of(np.ascontiguousarray(np.rot90(ramp, turns)))[1:-1, :, 1:-1]
    sums = cells.sum(axis=(0, 2))
    assert sums[direction] > 0
    np.testing.assert_allclose(np.delete(sums, direction), 0, atol=1e-4 * sums[direction])


def test_a_gradient_half_way_between_two_bins_is_shared():
    y, x = np.mgrid[:512, :512]
    steep = np.tan(np.radians(22.5))
    cells = cells_of((20 + 0.3 * (x + steep * y)).astype(np.uint8))[1:-1, :, 1:-1]
    sums = cells.sum(axis=(0, 2)) / cells.sum()
    assert sums[0] == pytest.approx(sums[1], abs=0.1)
    assert sums[:2].sum() == pytest.approx(1, abs=0.1)


def test_brightness_counts_relative_to_the_brightest_pixel():
    grey = (grey_of(textured(2, 512, 512)) // 2).astype(np.uint8)
    dark, bright = cells_of(grey), cells_of(grey * 2)
    np.testing.assert_allclose(bright, dark, atol=1e-6 * dark.max())


def test_regions_of_interest_are_those_with_entropy():
    grey = grey_of(half_flat())
    found = regions_of_interest(grey)
    small = cv2.resize(grey, (100, 100))
    entropy = oracle.region_entropy(oracle.entropy(small))
    assert np.abs(entropy / 8 - 0.4).min() > 1e-9
    np.testing.assert_array_equal(found.ravel(), entropy / 8 >= 0.4)
    assert not found[:, :13].any()
    assert found[:, 17:].all()


def test_a_descriptor_holds_cells_and_inverse_lengths(cohog):
    image = textured(4)
    descriptor = cohog.describe(image)
    cells = cells_of(grey_of(image))
    np.testing.assert_array_equal(descriptor[:, :8], cells.astype(np.float32))
    assert not descriptor[31, 8].any()
    assert not descriptor[:, 8, 31].any()
    regions = np.concatenate(
        [cells[i : i + 31, :, j : j + 31] for i in (0, 1) for j in (0, 1)], axis=1
    )
    lengths = np.linalg.norm(regions, axis=1)
    np.testing.assert_allclose(descriptor[:31, 8, :31], 1 / lengths, rtol=1e-6)


def test_a_query_weighs_its_regions_of_interest_only(cohog):
    image = half_flat()
    interest = regions_of_interest(grey_of(image))
    weights = cohog.describe_query(image)[:31, 8, :31]
    np.testing.assert_array_equal(weights > 0, interest)
    expected = cohog.describe(image)[:31, 8, :31] / interest.sum()
    np.testing.assert_allclose(weights[interest], expected[interest], rtol=1e-6)


def test_without_regions_of_interest_all_count(cohog):
    image = np.full((64, 64, 3), 50, np.uint8)
    image[:, 32:] = 200  # one edge: 1 bit at most
    assert not regions_of_interest(grey_of(image)).any()
    lengths = cohog.describe(image)[:31, 8, :31]
    weights = cohog.describe_query(image)[:31, 8, :31]
    np.testing.assert_allclose(weights, lengths / 961, rtol=1e-6)
    share = np.count_nonzero(lengths) / 961  # regions without any gradient match nothing
    assert 0 < share < 1
    score = cohog.match(cohog.describe_query(image), cohog.describe(image)[np.newaxis])
    assert score[0] == pytest.approx(share, abs=1e-6)


def test_scores_of_images_are_the_oracles(cohog):
    query, *references = [half_flat(1), textured(5), half_flat(2), textured(6, 96, 200)]
    interest = oracle.region_entropy(oracle.entropy(cv2.resize(grey_of(query), (100, 100)))) >= 3.2
    regions = [oracle.regions(oracle.cells(grey_of(image))) for image in [query, *references]]
    expected = [oracle.score(regions[0], interest, each) for each in regions[1:]]
    described = np.stack([cohog.describe(image) for image in references])
    scores = cohog.match(cohog.describe_query(query), described)
    assert scores == pytest.approx(expected, abs=2e-4)


# --- matching ------------------------------------------------------------------------------------


def random_cells(rng, empty=0.2):
    """(32, 32, 8): row, column, bin; a share of the cells, and one corner, without gradients."""
    cells = rng.random((32, 32, 8)) ** 4 * 1000
    cells[rng.random((32, 32)) < empty] = 0
    cells[:3, :5] = 0
    return cells.astype(np.float32)


def described(cells, interest=None):
    """The descriptor of such cells: a reference's, or a query's with its regions of interest."""
    descriptor = np.zeros((32, 9, 32), np.float32)
    descriptor[:, :8] = cells.transpose(0, 2, 1)
    lengths = inverse_lengths(descriptor[:, :8].astype(float))
    if interest is not None:
        lengths = lengths * interest.reshape(31, 31) / interest.sum()
    descriptor[:31, 8, :31] = lengths
    return descriptor


def patterns(rng):
    """Regions of interest of many kinds, as (961,) booleans."""
    grid = np.zeros((31, 31), bool)
    yield ~grid
    for row, column in [(0, 0), (0, 30), (30, 0), (30, 30), (7, 8), (7, 9)]:
        one = grid.copy()
        one[row, column] = True
        yield one
    for place in (np.s_[5], np.s_[:, 6], np.s_[:, 7], np.s_[::2, ::2], np.s_[10:20, 3:9]):
        some = grid.copy()
        some[place] = True
        yield some
    for share in (0.02, 0.3, 0.9):
        yield rng.random((31, 31)) < share


def test_matching_is_the_plain_loop(cohog):
    rng = np.random.default_rng(7)
    query, *references = [random_cells(rng) for _ in range(4)]
    maps = np.stack([described(each) for each in references])
    for interest in patterns(rng):
        flat = interest.ravel()
        expected = [
            oracle.score(oracle.regions(query), flat, oracle.regions(each)) for each in references
        ]
        scores = cohog.match(described(query, flat), maps)
        np.testing.assert_allclose(scores, expected, atol=1e-6, err_msg=str(np.flatnonzero(flat)))


@pytest.mark.parametrize(
    ("down", "right"), [(0, 0), (3, 5), (-4, 1), (30, 0), (-30, 2), (0, -30), (-2, 30), (31, 0)]
)
def test_a_region_is_found_wherever_it_moved(cohog, down, right):
    rng = np.random.default_rng(8)
    cells = np.abs(rng.normal(size=(32, 32, 8))).astype(np.float32)
    moved = np.abs(rng.normal(size=(32, 32, 8))).astype(np.float32)
    moved[max(0, down) : 32 + down, max(0, right) : 32 + right] = cells[
        max(0, -down) : 32 - down, max(0, -right) : 32 - right
    ]
    inside = np.zeros((31, 31), bool)  # regions that are whole in the moved image
    inside[max(0, -down) : 31 - max(0, down), max(0, -right) : 31 - max(0, right)] = True
    if inside.any():
        score = cohog.match(described(cells, inside), described(moved)[np.newaxis])
        assert score[0] == pytest.approx(1, abs=1e-6)
    score = cohog.match(described(cells, np.ones((31, 31))), described(moved)[np.newaxis])
    assert score[0] == pytest.approx(1, abs=1e-6) if inside.all() else score[0] < 0.999


def test_a_score_does_not_depend_on_the_other_references(cohog):
    rng = np.random.default_rng(9)
    query = described(random_cells(rng), rng.random((31, 31)) < 0.7)
    block = np.stack([described(random_cells(rng)) for _ in range(9)])
    scores = cohog.match(query, block)
    order = rng.permutation(9)
    np.testing.assert_array_equal(cohog.match(query, block[order]), scores[order])
    alone = [cohog.match(query, block[i : i + 1])[0] for i in range(9)]
    np.testing.assert_array_equal(alone, scores)
    assert len(set(scores.tolist())) == 9


def test_a_score_does_not_depend_on_where_descriptors_lie(cohog):
    rng = np.random.default_rng(10)
    query = described(random_cells(rng), rng.random((31, 31)) < 0.7)
    block = np.stack([described(random_cells(rng)) for _ in range(3)])
    expected = cohog.match(query, block)
    shifted = np.zeros(block.size + 1, np.float32)[1:].reshape(block.shape)
    shifted[...] = block
    np.testing.assert_array_equal(cohog.match(query, shifted), expected)
    block.flags.writeable = query.flags.writeable = False
    np.testing.assert_array_equal(cohog.match(query, block), expected)
    np.testing.assert_array_equal(cohog.match(query, np.repeat(block, 2, axis=0)[::2]), expected)
    assert cohog.match(query, block[:0]).shape == (0,)


def test_matching_leaves_other_threads_running(cohog):
    rng = np.random.default_rng(11)
    query = described(random_cells(rng), np.ones((31, 31)))
    block = np.repeat(described(random_cells(rng))[np.newaxis], 400, axis=0)
    expected = cohog.match(query, block[:1])  # compiled by now
    begun, done, found = threading.Event(), threading.Event(), []

    def work():
        begun.set()
        found.append(cohog.match(query, block))
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    begun.wait()
    turns = 0
    while not done.wait(0.001):
        turns += 1
    thread.join()
    assert turns >= 3  # with Python's lock held there would be none
    np.testing.assert_array_equal(found[0], np.repeat(expected, 400))


@pytest.mark.parametrize(
    ("query", "references"),
    [((32, 8, 32), (2, 32, 9, 32)), ((32, 9, 32), (32, 9, 32)), ((32, 9, 32), (2, 9, 32, 32))],
)
def test_descriptors_of_another_shape_are_refused(cohog, query, references):
    with pytest.raises(ValueError, match=r"CoHOG matches .* describe the images again"):
        cohog.match(np.zeros(query, np.float32), np.zeros(references, np.float32))


# --- a real recording ----------------------------------------------------------------------------


def test_scores_on_corridor_are_those_of_vprbench(cohog):
    folder = data_folder() / "corridor"
    references = np.stack([cohog.describe(image) for image in read_folder(folder / "reference")])
    queries = [cohog.describe_query(image) for image in read_folder(folder / "query")]
    scores = np.stack([cohog.match(query, references) for query in queries])
    stored = np.load(folder / "scores" / "CoHOG.npy")
    assert np.corrcoef(scores.ravel(), stored.ravel())[0, 1] >= 0.9995
    assert np.abs(scores - stored).max() <= 0.004
    assert np.mean(scores.argmax(axis=1) == stored.argmax(axis=1)) >= 0.95
