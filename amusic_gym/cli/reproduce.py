"""Run the paper's experiments on those of its data sets that are there.

Writes DIR/index.html, tables.md, tables II and III as CSV and LaTeX, figures 3 to 7 as PNG and PDF,
a sweep of E and M, results.json and the traces; of several data sets, one drive along all, too.
DIR/banks holds the scores; what is finished is not done again. docs/datasets.md says how the
folders of --root are laid out.
"""

import argparse
from functools import partial
from pathlib import Path

from amusic_gym.cli.parser import Parser, by_technique, page_folder
from amusic_gym.evaluation.reproduction.paper import TITLES


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    root = "where the data sets' folders are"
    parser.add_argument("--root", type=Path, required=True, metavar="DIR", help=root)
    parser.add_shared("--out", type=page_folder, metavar="DIR")
    named = "only these (default: all six)"
    parser.add_argument("--dataset", nargs="+", choices=TITLES, default=list(TITLES), help=named)
    parser.add_shared("--weights", "--cache", "--executor")


def main(args: argparse.Namespace) -> None:
    """Extract, drive, tabulate, draw."""
    from amusic_gym.evaluation.reproduction.paper import TECHNIQUES
    from amusic_gym.evaluation.reproduction.run import reproduce

    names = [name.lower() for name in TECHNIQUES]
    page = reproduce(
        args.root,
        args.out,
        datasets=args.dataset,
        weights=by_technique(args.weights, names, "--weights"),
        cache=args.cache,
        executor=args.executor,
        report=partial(print, flush=True),
    )
    print(f"\n{page}")
