"""The part of bank.py that has to do with images: images | render."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from _bank_extract import Techniques, add_extraction, extract_bank
from _cli import Parser
from _folders import add_reading, map_of, run_of

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.utils.checks import whole

_LEAST_SIZE = 16  # of a rendered image's sides, in pixels
TRUTH_BY = ("index", "name", "position")
POSITION = ("metres", "heading")


@dataclass(frozen=True)
class _Route:
    """Two folders, what is true, and what to call it."""

    reference: Any
    query: Any
    ground_truth: GroundTruth | None
    tolerance: int | None
    name: str


def images(args: argparse.Namespace) -> None:
    """Two folders of images, or a data set -> a bank."""
    techniques = Techniques.of(args)
    route = _route(args)
    extract_bank(
        args,
        techniques,
        route.reference,
        route.query,
        tolerance=route.tolerance,
        ground_truth=route.ground_truth,
        exclude_recent=args.exclude_recent,
        name=args.name or route.name,
    )


def render(args: argparse.Namespace) -> None:
    """One made-up route, drawn under several conditions -> a folder of images for each."""
    from amusic_gym.extraction.progress import Progress
    from amusic_gym.worlds import SIZE, render_folders

    size = SIZE if args.size is None else _size(args.size)
    conditions = list(dict.fromkeys(text.strip() for text in args.condition.split(",")))
    total = args.places * (1 + len(conditions))
    with Progress(True).bar("render", total, "images") as advance:

        def one_more(done: int, total: int) -> None:
            advance(1)

        render_folders(
            args.out,
            conditions,
            seed=args.seed,
            places=args.places,
            size=size,
            kind=args.kind,
            progress=one_more,
        )
    for name in ("reference", *conditions):
        print(f"{args.out / name}: {args.places} images")


def _size(text: str) -> tuple[int, int]:
    columns, times, rows = text.lower().partition("x")
    if not (times and columns.isdecimal() and rows.isdecimal()):
        raise ValueError(f"--size {text!r} is not of the form WIDTHxHEIGHT, e.g. 320x240")
    if min(int(columns), int(rows)) < _LEAST_SIZE:
        raise ValueError(f"--size {text}: give at least {_LEAST_SIZE}x{_LEAST_SIZE} pixels")
    return int(columns), int(rows)


def _route(args: argparse.Namespace) -> _Route:
    from amusic_gym.routes.image_truth import with_copies

    if args.dataset is None:
        route = _folders(args)
    else:
        route = _dataset(args)
    if args.copies and route.ground_truth is not None:
        widened = with_copies(route.ground_truth, route.reference)
        return _Route(route.reference, route.query, widened, route.tolerance, route.name)
    return route


def _folders(args: argparse.Namespace) -> _Route:
    from amusic_gym.routes.image_truth import (
        by_index,
        by_name,
        by_position,
        from_file,
        warn_of_shared_files,
    )

    _refuse(args, ("root", "images", "first", "step"), "only goes with --dataset")
    position = {
        option: value for option in POSITION if (value := getattr(args, option)) is not None
    }
    if position and args.truth_by != "position":
        raise ValueError(f"--{next(iter(position))} only goes with --truth-by position")
    if args.ground_truth is not None and args.truth_by is not None:
        raise ValueError("--ground-truth and --truth-by both say what is true; give one of the two")
    if args.reference is None or args.query is None:
        raise ValueError("give --reference DIR and --query DIR, or --dataset NAME and --root DIR")
    if args.tolerance is None and args.ground_truth is None and args.truth_by != "position":
        raise ValueError("give --tolerance N, the places to either side that count as right")
    reference, query = map_of(args), run_of(args)
    if args.exclude_recent is None:
        warn_of_shared_files(reference, query)
    if args.ground_truth is not None:
        truth = from_file(args.ground_truth, reference, query, args.tolerance, args.trust)
    elif args.truth_by == "position":
        truth = by_position(reference, query, **position)
        if args.tolerance is not None:
            truth = truth.with_tolerance(args.tolerance)
    elif args.truth_by == "name":
        truth = by_name(reference, query, args.tolerance)
    else:
        truth = by_index(reference, query, args.tolerance, exact=args.truth_by is None)
    return _Route(reference, query, truth, args.tolerance, "")


def _dataset(args: argparse.Namespace) -> _Route:
    from amusic_gym.routes.datasets import load_dataset
    from amusic_gym.routes.image_truth import by_index

    given = ("reference", "query", "ground_truth", "truth_by", *POSITION)
    _refuse(args, given, "does not go with --dataset, which brings it")
    if args.order or args.skip_damaged:
        raise ValueError("--order and --skip-damaged do not go with --dataset; give its folders")
    if args.root is None:
        raise ValueError(f"--dataset {args.dataset} needs --root DIR, where its folders are")
    counts = {
        name: whole(f"--{name}", value, least)
        for name, least in (("images", 1), ("first", 0), ("step", 1))
        if (value := getattr(args, name)) is not None
    }
    found = load_dataset(args.dataset, args.root, **counts)
    if args.tolerance is None:
        truth, tolerance = found.ground_truth, found.tolerance
    else:
        truth, tolerance = by_index(found.reference, found.query, args.tolerance), args.tolerance
    return _Route(found.reference, found.query, truth, tolerance, found.name)


def _refuse(args: argparse.Namespace, options: Sequence[str], why: str) -> None:
    for option in options:
        if getattr(args, option) is not None:
            raise ValueError(f"--{option.replace('_', '-')} {why}")


def add_render(commands: Any) -> Parser:
    """The command ``render``."""
    parser: Parser = commands.add_parser(
        "render", help="draw a made-up route in any weather, as folders of images"
    )
    parser.set_defaults(run=render)
    add = parser.add_argument
    add(
        "--condition",
        required=True,
        metavar="A,B",
        help="winter, night, fog, …: a folder for each; A+B is both at once",
    )
    add("--places", type=int, default=200, metavar="N", help="of the route (default: %(default)s)")
    add("--seed", type=int, default=0, metavar="S", help="of the route (default: %(default)s)")
    add("--size", metavar="WxH", help="of an image in pixels, e.g. 640x480")
    add("--kind", metavar="KIND", help="street, rail or corridor (default: the seed chooses)")
    add(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="the folder for reference/, the map, and one folder per condition",
    )
    return parser


def add_images(commands: Any) -> Parser:
    """The command ``images``."""
    parser: Parser = commands.add_parser(
        "images", help="from two folders of images, or a data set by name"
    )
    parser.set_defaults(run=images)
    add = parser.add_argument
    add(
        "--reference",
        type=Path,
        metavar="DIR",
        help="the map's images, in the order of their names",
    )
    add("--query", type=Path, metavar="DIR", help="the run's images")
    add("--dataset", metavar="NAME", help="one of the six of the paper, e.g. nordland_winter")
    add("--root", type=Path, metavar="DIR", help="where the data sets' folders are")
    add("--images", type=int, metavar="N", help="of a data set, if not as many as in the paper")
    add("--first", type=int, metavar="I", help="of a data set: the first image to take, from 0")
    add("--step", type=int, metavar="K", help="of a data set: take each K-th from there")
    add(
        "--truth-by",
        choices=TRUTH_BY,
        help="frame q is at place q (index, the default where there are as many); at the image "
        "with the same name; or near images by @UTM_EAST@UTM_NORTH@ in their names",
    )
    add("--metres", type=float, metavar="M", help="how near, with --truth-by position")
    add(
        "--heading",
        type=float,
        metavar="D",
        help="with --truth-by position: seen in a direction within D degrees, too",
    )
    add(
        "--ground-truth",
        type=Path,
        metavar="FILE",
        help=".npy or text: a boolean matrix, one place per query, or pairs of numbers or file "
        "names below 'query,place'",
    )
    add("--trust", action="store_true", help="unpickle a ground truth file of VPR-Bench")
    add(
        "--exclude-recent",
        type=int,
        metavar="N",
        help="one sequence against itself (loop closure): the N frames before each, itself and "
        "those after it are no candidates",
    )
    add(
        "--copies",
        action="store_true",
        help="a place's neighbours with the same image, byte for byte, are true too",
    )
    add_reading(parser)
    add_extraction(parser, tolerance_required=False, name="--out's name, or the data set's")
    return parser
