"""Measure what grows with places, techniques, routes and frames, and print docs/scale.md's tables.

Times are of one thread, in processor time, so that what else the machine does hardly counts. What
is finished in DIR is not measured again unless code changes. By default it takes less than ten
minutes of one processor and 5 GiB of memory.
"""

import _one_thread  # noqa: F401  (first: NumPy reads it)

# isort: split
import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from _cli import Parser, destination, run
from _scale_growth import DESCRIPTORS, GIB, Row, descriptor_bytes, drive, match
from _scale_shortlist import FILLS, driven, rendered
from amusic_agents.evaluation import held_out_routes
from tqdm import tqdm

from amusic_gym.envs.sources import ordinary
from amusic_gym.evaluation import store
from amusic_gym.evaluation.tables import Table
from amusic_gym.utils.storage import write_whole

STATISTICS = ("evidence", "belief")


class Sizes(NamedTuple):
    """What is measured."""

    places: tuple[int, ...] = (1_000, 10_000, 100_000, 1_000_000)
    techniques: tuple[int, ...] = (1, 2, 4, 8, 16)
    routes: tuple[int, ...] = (1, 16, 64, 256)
    frames: tuple[int, ...] = (1_000, 4_000, 16_000)
    usual: int = 1_000  # places, where something else grows
    drive: int = 24  # frames, where they do not grow
    rounds: int = 5
    memory: float = 2.1 * GIB  # of the largest map that is matched
    shares: tuple[float, ...] = (0.2, 0.05, 0.02, 0.01)
    simulated: int = 12  # routes
    rendered: int = 100  # places of each world


QUICK = Sizes(
    *((100, 200), (1, 2), (1, 2), (20, 40), 100, 8, 2, 1e6, (0.2,), 1, 12),
)


class Measured:
    """Rows in the folder ``out``, each measured once."""

    def __init__(self, out: Path) -> None:
        self._folder = out / "cells"
        parts = sorted(Path(__file__).parent.glob("_*.py"))
        self._code = [store.code_digest(part) for part in parts]
        self._bar = tqdm(unit="row", disable=not sys.stderr.isatty())

    def row(self, name: str, measure: Callable[[], Any]) -> Any:
        """What ``measure`` gives, or gave when it was last called by this name."""
        self._bar.set_description(name)
        stem = store.stem_of({"what": name, "code": self._code})
        if (body := store.load(self._folder, stem)) is None:
            body = {"found": measure()}
            store.save(self._folder, stem, body)
        self._bar.update()
        return body["found"]


def figure(number: float) -> str:
    """Three digits of a number, without an exponent above one."""
    rounded = float(f"{number:.3g}")
    return f"{rounded:,.0f}" if rounded >= 100 else f"{rounded:g}"


def growth(sizes: Sizes, measured: Measured) -> Iterator[Table]:
    """Time and memory of a step, by what grows."""
    few = sizes.techniques[:3][-1]
    for what in ("places", "techniques", "routes", "frames"):
        usual = {"places": sizes.usual, "techniques": few, "routes": 1, "frames": sizes.drive}
        if what == "frames":
            usual["techniques"] = 1
        rows = []
        for number in getattr(sizes, what):
            shape = tuple({**usual, what: number}.values())
            both = [
                measured.row(f"{each} {shape}", partial(drive, each, *shape)) for each in STATISTICS
            ]
            kept = [figure(row["mib"]) for row in both]
            times = [figure(row["ms"]) for row in both]
            rows.append([f"{number:,}", *times, *kept, figure(both[0]["bank_mib"])])
        fixed = ", ".join(
            f"{value:,} {name[: -1 if value == 1 else None]}"
            for name, value in usual.items()
            if name != what
        )
        heads = [
            *(what, *(f"ms of a step, {each}" for each in STATISTICS)),
            *(*(f"MiB kept, {each}" for each in STATISTICS), "MiB of the bank"),
        ]
        yield Table(f"By {what}: {fixed}", heads, rows)


def matching(sizes: Sizes, measured: Measured) -> Iterator[Table]:
    """Time and memory of matching a query with a map."""
    rows = []
    for name in DESCRIPTORS:
        largest: tuple[int, Row] | None = None
        cells = []
        for places in sizes.places:
            if descriptor_bytes(name, places) <= sizes.memory or largest is None:
                largest = (
                    places,
                    measured.row(f"{name} {places}", partial(match, name, places, sizes.rounds)),
                )
                cells.append(figure(largest[1]["ms"]))
            else:
                cells.append(f"{figure(largest[1]['ms'] * places / largest[0])} †")
        assert largest is not None
        bare = largest[1].get("product_ms")
        share = "" if bare is None else f"{bare / largest[1]['ms']:.2f}"
        size = descriptor_bytes(name, 1) // 4
        memory = descriptor_bytes(name, sizes.places[-1]) / GIB
        rows.append([name, f"{size:,}", *cells, share, figure(memory)])
    heads = [
        *("technique", "numbers", *(f"ms, {places:,} places" for places in sizes.places)),
        *("share of it in a bare product", f"GiB, {sizes.places[-1]:,} places"),
    ]
    note = f"† from the largest map measured: descriptors of at most {sizes.memory / GIB:.1f} GiB."
    yield Table("Matching one query", heads, rows, note)


def cost(sizes: Sizes, measured: Measured, out: Path) -> Iterator[Table]:
    """Accuracy and AUC after SIC and the belief where only a shortlist's scores exist."""
    tour = rendered(out, sizes.rendered)
    for statistic in STATISTICS:
        routes = {
            "simulated": held_out_routes(ordinary(statistic), sizes.simulated),
            "rendered": [tour],
        }
        rows = []
        for share, fill in [(1.0, ""), *((s, f) for s in sizes.shares for f in FILLS)]:
            row = [f"{share:.0%}", {"none": "−∞"}.get(fill, fill)]
            for kind, banks in routes.items():
                name = f"{sizes.simulated} {sizes.rendered} {kind} {statistic} {share} {fill}"
                means = measured.row(name, partial(driven, banks, share, fill, statistic))
                row += [f"{means[each]:.3f}" for each in ("single", "music", "music_auc")]
            rows.append(row)
        heads = ["scores", "the others get"] + [
            f"{kind}: {what}" for kind in routes for what in ("single", "music", "AUC of music")
        ]
        yield Table(f"Accuracy after {statistic}, by shortlist", heads, rows, words=2)


def main() -> None:
    """Measure, write and print."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    add("--quick", action="store_true", help="tiny sizes, to see that it runs")
    args = parser.parse_args()
    sizes = QUICK if args.quick else Sizes()
    measured = Measured(args.out)
    told = []
    for table in chain(
        growth(sizes, measured),
        matching(sizes, measured),
        cost(sizes, measured, args.out),
    ):
        told.append(table.markdown())
        print(f"\n{told[-1]}", flush=True)
    write_whole(args.out / "tables.md", ("\n\n".join(told) + "\n").encode())


if __name__ == "__main__":
    run(main)
