"""CoHOG's matching, compiled: for each region of a query the most similar one of a reference.

A region is a square of 2×2 cells, so the dot product of two regions is a sum of four dot products
of cells; and a cell belongs to four regions. Hence all pairs of cells are multiplied once, a
quarter of what multiplying all pairs of regions takes, and the products are added up in two steps:
of two neighbours in a row, the *pairs*; then a pair and the pair below it.

The walk: take a row of the query's cells and a row of the reference's, then the next of both, down
to the end. It needs the products of one pair of rows and the pairs of the one before, 8 KB in all,
which stay in the processor's nearest memory. 61 such walks, one per distance between the rows,
visit all pairs of rows of regions.
"""

import numpy as np
from numpy.typing import NDArray

from amusic_gym.kernels.compiling import inner, without_gil
from amusic_gym.kernels.lanes import (
    LANES,
    Lanes,
    add,
    greater,
    largest,
    load,
    multiply,
    multiply_add,
    spread,
    store,
    zeros,
)

SIDE = 32  # cells per row, and rows of cells, of an image
BINS = 8  # directions per cell
ROW = (BINS + 1) * SIDE  # numbers per row of cells in a descriptor: its bins, then one per region
Floats = NDArray[np.float32]
Integers = NDArray[np.int64]

_NUMBER = BINS * SIDE  # where a row's numbers per region begin
_REGIONS = SIDE - 1  # per row, and rows of them


@inner
def _list_runs(query: Floats, runs: Integers) -> None:
    """List the pairs that the query (SIDE · ROW,) needs, row of cells by row of cells.

    To ``runs`` (SIDE, 1 + SIDE): how many runs of neighbouring pairs, then of each run the first
    cell and the cell after its last pair's first.
    """
    for y in range(SIDE):
        count = 0
        inside = False
        for x in range(SIDE):
            below = x < _REGIONS and y < _REGIONS and query[y * ROW + _NUMBER + x] > 0
            above = x < _REGIONS and y > 0 and query[(y - 1) * ROW + _NUMBER + x] > 0
            if (below or above) != inside:
                inside = not inside
                count += 1
                runs[y, count] = x
        runs[y, 0] = count // 2


@inner
def _multiply_rows(
    query: Floats, q: int, reference: Floats, r: int, runs: Integers, products: Floats
) -> None:
    """Dot products of a row of the query's cells, at ``q``, with one of the reference's, at ``r``.

    ``products`` (SIDE · SIDE,) takes them, for the pairs ``runs``, see :func:`_list_runs`. Two
    cells of the query at once: 2 · 4 sums of eight lanes stay in registers.
    """
    for run in range(runs[0]):
        begin = runs[2 * run + 1]
        for cell in range(begin - begin % 2, runs[2 * run + 2] + 1, 2):
            a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = zeros()
            for k in range(0, _NUMBER, SIDE):
                r0 = load(reference, r + k)
                r1 = load(reference, r + k + LANES)
                r2 = load(reference, r + k + 2 * LANES)
                r3 = load(reference, r + k + 3 * LANES)
                value = spread(query, q + k + cell)
                a0 = multiply_add(value, r0, a0)
                a1 = multiply_add(value, r1, a1)
                a2 = multiply_add(value, r2, a2)
                a3 = multiply_add(value, r3, a3)
                value = spread(query, q + k + cell + 1)
                b0 = multiply_add(value, r0, b0)
                b1 = multiply_add(value, r1, b1)
                b2 = multiply_add(value, r2, b2)
                b3 = multiply_add(value, r3, b3)
            at = cell * SIDE
            store(products, at, a0)
            store(products, at + LANES, a1)
            store(products, at + 2 * LANES, a2)
            store(products, at + 3 * LANES, a3)
            store(products, at + 4 * LANES, b0)
            store(products, at + 5 * LANES, b1)
            store(products, at + 6 * LANES, b2)
            store(products, at + 7 * LANES, b3)


@inner
def _similarity(products: Floats, pairs: Floats, at: int, inverse_length: Lanes) -> Lanes:
    """Similarity of eight regions whose lower pairs start at ``at``; keeps these pairs."""
    pair = add(load(products, at), load(products, at + SIDE + 1))  # the cell, the next of both
    region = add(load(pairs, at), pair)
    store(pairs, at, pair)
    similarity: Lanes = multiply(region, inverse_length)
    return similarity


@inner
def _fold_rows(
    products: Floats,
    runs: Integers,
    pairs: Floats,
    reference: Floats,
    lengths: int,
    best: Floats,
    first: int,
) -> None:
    """Add products up to regions, and keep the greatest similarity of each region of the query.

    ``products`` and ``pairs`` are (SIDE, SIDE), flat; the latter, of the row of cells above, become
    this row's. At ``lengths`` the reference has the inverse lengths of the row of regions.
    ``best`` (regions of the query, LANES), flat, is before the query's own length; ``first`` is
    its first region in this row.
    """
    n0 = load(reference, lengths)
    n1 = load(reference, lengths + LANES)
    n2 = load(reference, lengths + 2 * LANES)
    n3 = load(reference, lengths + 3 * LANES)
    for run in range(runs[0]):
        for x in range(runs[2 * run + 1], runs[2 * run + 2]):
            at = x * SIDE
            left = greater(
                _similarity(products, pairs, at, n0),
                _similarity(products, pairs, at + LANES, n1),
            )
            right = greater(
                _similarity(products, pairs, at + 2 * LANES, n2),
                _similarity(products, pairs, at + 3 * LANES, n3),
            )
            region = (first + x) * LANES
            store(best, region, greater(load(best, region), greater(left, right)))


@inner
def _weighted_sum(query: Floats, best: Floats) -> float:
    total = 0.0
    for y in range(_REGIONS):
        for x in range(_REGIONS):
            weight = query[y * ROW + _NUMBER + x]
            if weight > 0:
                total += weight * largest(load(best, (y * SIDE + x) * LANES))
    return total


@without_gil
def match_regions(query: Floats, references: Floats, scores: Floats) -> None:
    """Scores of one query against B references, each by itself, without Python's lock.

    Args:
        query: (SIDE · ROW,) float32: row of cells, bin, column; in place of a ninth bin the weight
            of the region that begins with the cell, 0 where it does not count.
        references: (B, SIDE · ROW) float32; in place of a ninth bin the inverse length of the
            region that begins with the cell, 0 where there is none.
        scores: (B,) float32, to fill: sum over the query's regions of weight · greatest
            (dot product · inverse length).
    """
    # A row of zeros comes first: lengths of the regions that would begin above the image.
    reference = np.zeros(ROW + SIDE * ROW, np.float32)
    products = np.zeros(SIDE * SIDE + LANES, np.float32)
    pairs = np.zeros(SIDE * SIDE, np.float32)
    best = np.zeros(SIDE * SIDE * LANES, np.float32)
    runs = np.zeros((SIDE, 1 + SIDE), np.int64)
    _list_runs(query, runs)
    for b in range(scores.size):
        for i in range(SIDE * ROW):  # to where vectors are aligned
            reference[ROW + i] = references[b, i]
        for i in range(best.size):
            best[i] = 0.0
        for distance in range(1 - _REGIONS, _REGIONS):
            for y in range(max(0, -distance), min(SIDE, SIDE - distance)):
                r = ROW + (y + distance) * ROW
                _multiply_rows(query, y * ROW, reference, r, runs[y], products)
                lengths = r - ROW + _NUMBER if y > 0 else _NUMBER
                first = max(y - 1, 0) * SIDE
                _fold_rows(products, runs[y], pairs, reference, lengths, best, first)
        scores[b] = _weighted_sum(query, best)
