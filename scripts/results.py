"""Make the tables of docs/results.md and docs/leaderboard.md from the recordings in $AMUSIC_DATA.

  tours     five tours of Corridor, Gardens Point and Nordland
  recorded  these three as they are
  motions   all eight as recorded, paced and kidnapped, with the statistic belief
  all       one after the other

The selectors that ship, and yours, stand against rules of every kind and peers. Prints the tables;
with --docs DIR writes them, and the figures, into DIR's documents. What is finished in --out is not
done again.
"""

import argparse
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _recordings
from _cli import Parser, destination, pairs, run

from amusic_gym.banks.costs import COST_MODELS
from amusic_gym.cli.options import MANY
from amusic_gym.evaluation.documents import filled
from amusic_gym.evaluation.study import CONDITIONS, Findings, figures
from amusic_gym.evaluation.study.rivals import peers, rivals, rivals_in_motion, study_rivals
from amusic_gym.evaluation.study.standings import leaderboard, standing, where_ahead
from amusic_gym.evaluation.study.tables import audit_table, matches_table
from amusic_gym.utils.storage import write_whole

RESULTS, LEADERBOARD = "results.md", "leaderboard.md"
SCRIPT = "scripts/results.py"
EVERY = 10.0  # seconds between two lines of progress


@dataclass(frozen=True)
class Study:
    """A kind of results."""

    routes: tuple[str, ...]  # as `_recordings.make_banks` takes them
    # techniques → policies that the selectors stand against
    rules: Callable[[Sequence[str]], list[str]]
    ships: Mapping[str, str]  # name → policy, the selectors that ship
    how: Mapping[str, Any]  # further arguments of `study_rivals`


STEADY = {"ships": "ppo", "ships, may idle": "ppo:idle"}
STUDIES = {
    "tours": Study(("tours",), rivals, STEADY, {}),
    "recorded": Study(("recorded",), rivals, STEADY, {}),
    "motions": Study(
        ("recorded", "tours"),
        rivals_in_motion,
        {"ships": "ppo@belief"},
        {"statistic": "belief", "conditions": tuple(CONDITIONS), "draws": 2},
    ),
}


def texts_of(kind: str, findings: Findings) -> dict[str, str]:
    """Document → text: tables, and sentences on them."""
    boards, results = [], []
    for condition in findings.settings["conditions"]:
        title = f"{kind.capitalize()}, {CONDITIONS[condition]}"
        boards.append(leaderboard(findings, condition, title).markdown())
        sentences = [*standing(findings, condition), *where_ahead(findings, condition)]
        results.append(matches_table(findings, condition).markdown())
        results.append("\n".join(f"- {sentence}" for sentence in sentences))
    if kind == "motions":
        shown = [row for row in findings.audit if row["front"] in STUDIES[kind].ships]
        results.append(audit_table(findings, shown).markdown())
    return {RESULTS: "\n\n".join(results), LEADERBOARD: "\n\n".join(boards)}


def study(kind: str, args: argparse.Namespace, data: Path) -> Findings:
    """Make the banks and run the study; tables and figures go to ``--out``."""
    of = STUDIES[kind]
    banks = [bank for each in of.routes for bank in _recordings.make_banks(data, each, args.out)]
    techniques = banks[0].techniques
    own = {name: each.split(",") for name, each in pairs(args.selector, "--selector").items()}
    out = args.out / kind / args.costs
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*has no correct match")
        findings = study_rivals(
            [bank.with_costs(args.costs) for bank in banks],
            {**{name: [spec] for name, spec in of.ships.items()}, **own},
            out,
            args.executor,
            policies=[*of.rules(techniques), *peers(techniques), *args.policy],
            report=_seldom(kind),
            **of.how,
        )
    figures.draw(findings, out)
    return findings


def _seldom(kind: str) -> Callable[[str], None]:
    """Progress of a study, a line every `EVERY` seconds."""
    last = time.monotonic()

    def report(line: str) -> None:
        nonlocal last
        if time.monotonic() - last >= EVERY:
            last = time.monotonic()
            print(f"{kind} {line}", flush=True)

    return report


def write(docs: Path, kind: str, texts: Mapping[str, str], picture: Path) -> None:
    """Write a study's texts into their blocks of the documents, and its picture beside them."""
    for document, text in texts.items():
        path = docs / document
        try:
            new = filled(path.read_text("utf-8"), {f"{SCRIPT} {kind}": text})
        except (ValueError, OSError) as error:
            raise ValueError(f"{path}: {error}") from None
        write_whole(path, new.encode())
    write_whole(docs / "images" / f"{kind}.png", picture.read_bytes())


def _parser() -> Parser:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("kind", choices=(*STUDIES, "all"), help="see above")
    add("--out", type=destination, required=True, metavar="DIR", help="the folder to write")
    yours = "besides those that ship: ppo:RUN; one, or five of one training"
    add("--selector", metavar="NAME=POLICY,...", help=yours, **MANY)
    besides = "besides the rules and peers: as compare takes it"
    add("--policy", metavar="POLICY", help=besides, **MANY)
    add("--costs", choices=COST_MODELS, default="paper", help="cost model (default: paper)")
    add("--docs", type=Path, metavar="DIR", help="the folder of the documents to write into")
    parser.add_shared("--executor")
    return parser


def main() -> None:
    """Run the studies, print their tables, write them into the documents."""
    args = _parser().parse_args()
    data = os.environ.get("AMUSIC_DATA")
    if not data:
        raise ValueError("AMUSIC_DATA names no folder; let it name that of the recordings")
    for kind in STUDIES if args.kind == "all" else [args.kind]:
        texts = texts_of(kind, study(kind, args, Path(data)))
        print("\n\n".join(["", *texts.values()]), flush=True)
        if args.docs:
            write(args.docs, kind, texts, args.out / kind / args.costs / "fronts.png")


if __name__ == "__main__":
    run(main)
