"""The roofline: operations per second against operations per byte, and what the machine allows."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from _bench_images import Roof
from _bench_kernels import BYTES_PER_PLACE
from _bench_material import Sizes
from _bench_reference import COHOG_CELLS, COHOG_OPERATIONS
from _timing import Medians

from amusic_gym.utils.storage import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ADD_OPERATIONS = 3  # per place: less the mean, times 1/σ, added
LOOKED_UP = 4 + 8 + 8  # bytes per candidate: its place, its sum, its factor
COHOG_BYTES = COHOG_CELLS**2 * (8 * 4 + 4)  # per reference: cells of 8 bins and their weights


class Point(NamedTuple):
    """A part that was timed.

    Attributes:
        name: of the part.
        operations: floating-point operations per byte.
        rate: operations per second.
    """

    name: str
    operations: float
    rate: float


def points_of(sizes: Sizes, seconds: dict[str, Medians]) -> tuple[float, list[Point]]:
    """Bytes per second of a plain stream, and the parts of a step, from their times."""
    row, correction = BYTES_PER_PLACE * sizes.places, ADD_OPERATIONS * sizes.places
    looked_up = LOOKED_UP * sizes.candidates
    parts = {
        "row add": (row, correction, row * seconds["sic_share_of_limit"].ours),
        "one SIC correction": (
            row + looked_up,
            correction + sizes.candidates,
            seconds["sic_vs_numpy"].ours,
        ),
        "step of the vector env": (
            sizes.techniques * (row + looked_up),
            sizes.techniques * (correction + sizes.candidates),
            seconds["step_share_of_limit"].ours,
        ),
    }
    points = [Point(name, ops / size, ops / time) for name, (size, ops, time) in parts.items()]
    return 1.0 / seconds["sic_share_of_limit"].theirs, points


def draw_growth(places: Sequence[int], seconds: Sequence[Medians], file: Path) -> None:
    """Draw the time of a correction against the map's size, and that of the stream over its row."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    ours, stream = ([1e6 * of for of in side] for side in zip(*seconds, strict=True))
    axes.loglog(places, ours, "o-", label="one SIC correction")
    axes.loglog(places, stream, "--", color="0.3", label="plain stream over its row")
    axes.legend(loc="upper left", frameon=False)
    axes.set_xlabel("places of the map")
    axes.set_ylabel("µs per technique and frame")
    axes.grid(alpha=0.3)
    _write(figure, file)
    plt.close(figure)


def draw_roofline(measured: tuple[float, list[Point]], roof: Roof, file: Path) -> None:
    """Draw the roofs of memory and arithmetic, and the parts below them."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    bandwidth, points = measured
    cohog = Point("CoHOG matching", COHOG_OPERATIONS / COHOG_BYTES, roof.cohog)
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    x = np.geomspace(0.03, 4.0 * cohog.operations, 200)
    axes.loglog(x, np.minimum(bandwidth * x, roof.product) / 1e9, color="0.3")
    axes.annotate(
        "plain stream",
        (0.3, 0.3 * bandwidth / 1e9),
        (8, -8),
        textcoords="offset points",
        color="0.3",
    )
    axes.text(x[-1], 1.05 * roof.product / 1e9, "matrix product", ha="right", color="0.3")
    for number, point in enumerate([*points, cohog]):
        share = 100 * point.rate / min(bandwidth * point.operations, roof.product)
        label = f"{point.name}: {share:.0f} % of what the machine allows"
        axes.plot(point.operations, point.rate / 1e9, "o", color=f"C{number}", label=label)
    axes.set_ylim(0.5, 2.0 * roof.product / 1e9)
    axes.legend(loc="lower right", frameon=False)
    axes.set_xlabel("operations per byte")
    axes.set_ylabel("10⁹ operations per second")
    axes.grid(alpha=0.3)
    _write(figure, file)
    plt.close(figure)


def _write(figure: Figure, file: Path) -> None:
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=120)
    write_whole(file, image.getvalue())
