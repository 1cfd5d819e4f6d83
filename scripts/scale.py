"""Measure what grows with places, techniques, routes and frames, and print docs/scale.md's tables.

Times are of one thread, in processor time, so that what else the machine does hardly counts. By
default it takes less than ten minutes of one processor and 5 GiB of memory.
"""

import _one_thread  # noqa: F401  (first: NumPy reads it)

# isort: split
import argparse
import warnings
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _cli import Parser, destination, run
from _drives import drive
from _scale_growth import DESCRIPTORS, GIB, Row, descriptor_bytes, match, step_of
from amusic_agents.evaluation import held_out_routes

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ranking import highest
from amusic_gym.cli.demo_tours import FIRST_WORLD, WORLDS, render_world
from amusic_gym.cli.images import extract_tour
from amusic_gym.envs.sources import ordinary
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.evaluation.tables import Table
from amusic_gym.routes.tours import make_tour
from amusic_gym.utils.storage import write_whole

STATISTICS = ("evidence", "belief")
TOLERANCE = 2
TECHNIQUES = ("hog", "calc", "netvlad")  # on rendered images
SECONDS = {"HOG": 1.0, "CALC": 1.0, "NetVLAD": 1.0}  # which change nothing here

FILLS = ("floor", "mean", "none")
"""What places beyond the shortlist get: the least score of it, the row's mean, −∞."""


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


QUICK = Sizes((100, 200), (1, 2), (1, 2), (20, 40), 100, 8, 2, 1e6, (0.2,), 1, 12)


def figure(number: float) -> str:
    """Three digits of a number, without an exponent above one."""
    rounded = float(f"{number:.3g}")
    return f"{rounded:,.0f}" if rounded >= 100 else f"{rounded:g}"


def growth(sizes: Sizes) -> Iterator[Table]:
    """Time and memory of a step, by what grows."""
    few = sizes.techniques[:3][-1]
    for what in ("places", "techniques", "routes", "frames"):
        usual = {"places": sizes.usual, "techniques": few, "routes": 1, "frames": sizes.drive}
        if what == "frames":
            usual["techniques"] = 1
        rows = []
        for number in getattr(sizes, what):
            shape = tuple({**usual, what: number}.values())
            both = [step_of(each, *shape) for each in STATISTICS]
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


def matching(sizes: Sizes) -> Iterator[Table]:
    """Time and memory of matching a query with a map."""
    rows = []
    for name in DESCRIPTORS:
        measured = {
            places: match(name, places, sizes.rounds)
            for places in sizes.places
            if places == sizes.places[0] or descriptor_bytes(name, places) <= sizes.memory
        }
        largest = max(measured)
        ms, bare = measured[largest]["ms"], measured[largest].get("product_ms")
        cells = [
            figure(measured[places]["ms"])
            if places in measured
            else f"{figure(ms * places / largest)} †"
            for places in sizes.places
        ]
        share = "" if bare is None else f"{bare / ms:.2f}"
        size = descriptor_bytes(name, 1) // 4
        memory = descriptor_bytes(name, sizes.places[-1]) / GIB
        rows.append([name, f"{size:,}", *cells, share, figure(memory)])
    heads = [
        *("technique", "numbers", *(f"ms, {places:,} places" for places in sizes.places)),
        *("share of it in a bare product", f"GiB, {sizes.places[-1]:,} places"),
    ]
    note = f"† from the largest map measured: descriptors of at most {sizes.memory / GIB:.1f} GiB."
    yield Table("Matching one query", heads, rows, note)


def cost(sizes: Sizes, out: Path) -> Iterator[Table]:
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
            for banks in routes.values():
                means = driven(banks, share, fill, statistic)
                row += [f"{means[each]:.3f}" for each in ("single", "music", "music_auc")]
            rows.append(row)
        heads = ["scores", "the others get"] + [
            f"{kind}: {what}" for kind in routes for what in ("single", "music", "AUC of music")
        ]
        yield Table(f"Accuracy after {statistic}, by shortlist", heads, rows, words=2)


def rendered(out: Path, places: int) -> ScoreBank:
    """A tour through the demo's rendered worlds, joined in one map; images are kept in ``out``."""
    parts = [
        render_world(places, out / "images" / world.kind, world, seed)
        for seed, world in enumerate(WORLDS, FIRST_WORLD)
    ]
    tour = make_tour(parts, seed=1)
    return extract_tour(tour, TECHNIQUES, TOLERANCE, seconds=SECONDS, cache=out / "cache")


def shortened(bank: ScoreBank, share: float, fill: str) -> ScoreBank:
    """The bank as a shortlist leaves it: of every row only the best share of the scores exists."""
    scores = np.array(bank.scores)
    count = max(1, round(share * bank.references))
    for row in scores.reshape(-1, bank.references):
        kept = highest(row, count)
        rest = {"floor": row[kept[-1]], "mean": row.mean(), "none": -np.inf}[fill]
        best = row[kept]
        row[:] = np.minimum(rest, best[-1])
        row[kept] = best
    return ScoreBank(
        scores,
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=bank.truth,
        name=bank.name,
    )


def driven(banks: Sequence[ScoreBank], share: float, fill: str, statistic: str) -> Row:
    """Means over routes of which a shortlist is left.

    Returns:
        ``single``: accuracy of each technique alone; ``music`` and ``music_auc``: accuracy and AUC
        of all of them.
    """
    left = [shortened(bank, share, fill) for bank in banks] if fill else banks
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* has no correct match", UserWarning)
        single = [
            summarise(drive(f"single:{name}", bank, statistic))["accuracy"]
            for bank in left
            for name in bank.techniques
        ]
        music = [summarise(drive("music", bank, statistic)) for bank in left]
    return {
        "single": float(np.mean(single)),
        "music": float(np.mean([row["accuracy"] for row in music])),
        "music_auc": float(np.mean([row["auc"] for row in music])),
    }


def main() -> None:
    """Measure, write and print."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    add("--quick", action="store_true", help="tiny sizes, to see that it runs")
    args = parser.parse_args()
    sizes = QUICK if args.quick else Sizes()
    told = []
    for table in chain(growth(sizes), matching(sizes), cost(sizes, args.out)):
        told.append(table.markdown())
        print(f"\n{told[-1]}", flush=True)
    write_whole(args.out / "tables.md", ("\n\n".join(told) + "\n").encode())


if __name__ == "__main__":
    run(main)
