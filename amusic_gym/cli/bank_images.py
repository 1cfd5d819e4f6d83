"""The commands of ``bank`` that have to do with images: images | tour | render."""

import argparse
import os
import re
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from amusic_gym.banks.bank_files import check_destination
from amusic_gym.cli import images as shared
from amusic_gym.cli.bank_descriptors import add_metric, read_pairs
from amusic_gym.cli.bank_truth import add_truth, check_truth, given, truth_of
from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import Parser, destination
from amusic_gym.extraction.progress import Progress
from amusic_gym.routes import image_truth, tours
from amusic_gym.routes.conditions import CONDITIONS
from amusic_gym.routes.datasets import LoadedRoute, load_dataset
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.utils.checks import whole

LEAST_SIZE = 16  # pixels of a rendered image's sides

PART = re.compile(r"([^:]+):([^:]+?)(?:@(\d+):(\d+):([1-9]\d*))?")


def images(args: argparse.Namespace) -> None:
    """Two folders of images, or a data set -> a bank."""
    from amusic_gym.extraction import extract

    named = [item.partition("=")[0] for item in args.reference_descriptors]
    techniques, seconds = shared.techniques_of(args, named)
    with ExitStack() as stack:
        route = _dataset(args) if args.dataset else _folders(args, stack)
        sides: list[ImageFolder | None] = [route.reference, route.query]
        pairs = read_pairs(args, args.reference_descriptors, args.query_descriptors, sides)
        if args.copies:
            widened = image_truth.with_copies(route.ground_truth, route.reference)
            route = replace(route, ground_truth=widened)
        bank = extract(
            route.reference,
            route.query,
            techniques,
            tolerance=route.tolerance,
            ground_truth=route.ground_truth,
            exclude_recent=args.exclude_recent,
            descriptors=pairs,
            seconds=seconds,
            **_extraction(args, route.name),
        )
    shared.tell(bank.path, bank.shape)
    if route.positions is None:
        return
    metres = image_truth.METRES if args.metres is None else args.metres
    print(
        f"right within {metres:g} m: {int(bank.truth.has_place.sum())} of {bank.queries} frames"
        f" have a place; tolerance {bank.tolerance} places"
    )
    if args.plot is not None:
        from amusic_gym.evaluation.plots.tracks import draw_matches

        print(draw_matches(bank, *route.positions, args.plot))


def tour(args: argparse.Namespace) -> None:
    """Several pairs of image folders, one drive under changing conditions -> a bank."""
    parts = [_part(text) for text in args.part]
    chosen = CONDITIONS if args.conditions is None else args.conditions.split(",")
    made = tours.make_tour(parts, list(chosen), seed=args.seed)
    made.ground_truth(args.tolerance)  # refuses a tolerance before any work
    techniques, seconds = shared.techniques_of(args)
    check_destination(args.out)
    if args.images is not None:
        tours.check_destination(args.images)
        total = len(made.reference) + len(made.query)
        with Progress(True).bar("tour", total, "images") as advance:
            print(f"{tours.write_tour(made, args.images, advance)}: {total} images")
    bank = shared.extract_tour(
        made, techniques, args.tolerance, seconds=seconds, **_extraction(args)
    )
    shared.tell(bank.path, bank.shape)
    for spell in made.spells:
        print(f"from frame {spell.first}: {spell.condition}")


def render(args: argparse.Namespace) -> None:
    """One made-up route, drawn under several conditions -> a folder of images for each."""
    from amusic_gym.worlds import SIZE, render_folders  # these need Numba

    size = SIZE if args.size is None else _size(args.size)
    conditions = list(dict.fromkeys(text.strip() for text in args.condition.split(",")))
    total = args.places * (1 + len(conditions))
    with Progress(True).bar("render", total, "images") as advance:

        def one_more(*_: int) -> None:
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


def _extraction(args: argparse.Namespace, name: str = "") -> dict[str, Any]:
    """What the options of `_add_extraction` say, as `extract` takes it."""
    return {
        "measure_again": args.measure_again,
        "cache": args.cache,
        "executor": args.executor,
        "out": args.out,
        "progress": True,
        "name": args.name or name,
    }


def _size(text: str) -> tuple[int, int]:
    columns, times, rows = text.lower().partition("x")
    if not (times and columns.isdecimal() and rows.isdecimal()):
        raise ValueError(f"--size {text!r} is not of the form WIDTHxHEIGHT, e.g. 320x240")
    if min(int(columns), int(rows)) < LEAST_SIZE:
        raise ValueError(f"--size {text}: give at least {LEAST_SIZE}x{LEAST_SIZE} pixels")
    return int(columns), int(rows)


def _part(text: str) -> tuple[ImageFolder, ImageFolder]:
    """``REFERENCE:QUERY`` or ``REFERENCE:QUERY@FIRST:STOP:STEP``, cut as Python cuts a list."""
    found = PART.fullmatch(text)
    if found is None:
        raise ValueError(
            f"--part {text!r} is not of the form REFERENCE:QUERY or "
            "REFERENCE:QUERY@FIRST:STOP:STEP, two folders with one colon between them"
        )
    reference, query, first, stop, step = found.groups()
    if first is None:
        return ImageFolder(reference), ImageFolder(query)
    taken = range(int(first), int(stop), int(step))
    if not taken:
        raise ValueError(f"--part {text!r} takes no image; give a STOP above FIRST")
    cut: dict[str, Any] = {"first": taken.start, "step": taken.step, "count": len(taken)}
    return ImageFolder(reference, **cut), ImageFolder(query, **cut)


def _folders(args: argparse.Namespace, stack: ExitStack) -> LoadedRoute:
    """The route of ``--reference`` and ``--query``."""
    _refuse(args, ("root", "images", "first", "step"), "only goes with --dataset")
    check_truth(args)
    if args.reference is None or args.query is None:
        raise ValueError("give --reference DIR and --query DIR, or --dataset NAME and --root DIR")
    if given(args, "every", "fps") and not any(map(os.path.isfile, (args.reference, args.query))):
        raise ValueError("--every and --fps thin a video, but --reference and --query are none")
    reference, query = shared.map_of(args, stack), shared.run_of(args, stack)
    if args.exclude_recent is None:
        image_truth.warn_of_shared_files(reference.folder, query.folder)
    truth, positions = truth_of(args, reference, query)
    return LoadedRoute(reference.folder, query.folder, truth, args.tolerance, "", positions)


def _dataset(args: argparse.Namespace) -> LoadedRoute:
    """The route of ``--dataset``."""
    brought = ("reference", "query", "ground_truth", "truth_by", "metres", "heading", "plot")
    thinning = ("every", "fps", "every_metres", "reference_positions", "query_positions")
    _refuse(args, thinning, "does not go with --dataset, whose images are given")
    _refuse(args, brought, "does not go with --dataset, which brings it")
    if args.order or args.skip_damaged:
        raise ValueError("--order and --skip-damaged do not go with --dataset; give its folders")
    if args.root is None:
        raise ValueError(f"--dataset {args.dataset} needs --root DIR, where its folders are")
    least = {"images": 1, "first": 0, "step": 1}
    counts = {
        name: whole(f"--{name}", value, least[name]) for name, value in given(args, *least).items()
    }
    found = load_dataset(args.dataset, args.root, **counts)
    if args.tolerance is None:
        return found
    truth = image_truth.by_index(found.reference, found.query, args.tolerance)
    return replace(found, ground_truth=truth, tolerance=args.tolerance)


def _refuse(args: argparse.Namespace, names: Sequence[str], why: str) -> None:
    for name in given(args, *names):
        option = "within" if name == "metres" else name.replace("_", "-")
        raise ValueError(f"--{option} {why}")


def add_images(parser: Parser) -> None:
    """Add the arguments of ``images``."""
    add = parser.add_argument
    parser.add_shared("--reference", "--query", "--order", "--skip-damaged")
    add("--dataset", metavar="NAME", help="one of the six of the paper, e.g. nordland_winter")
    add("--root", type=Path, metavar="DIR", help="where the data sets' folders are")
    add("--images", type=int, metavar="N", help="of a data set, if not as many as in the paper")
    add("--first", type=int, metavar="I", help="of a data set: the first image to take, from 0")
    add("--step", type=int, metavar="K", help="of a data set: take each K-th from there")
    add_truth(parser)
    drawn = "draw both tracks, and the places that each technique matches by itself"
    add("--plot", type=destination, metavar="FILE.png", help=drawn)
    parser.add_shared("--every", "--fps", "--every-metres")
    same = "a place's neighbours with the same image, byte for byte, are true too"
    add("--copies", action="store_true", help=same)
    for side in ("reference", "query"):
        beside = "of techniques that ran elsewhere, as bank descriptors takes them"
        add(f"--{side}-descriptors", metavar="NAME=PATH", help=beside, **MANY)
    add_metric(parser)
    _add_extraction(parser)


def add_tour(parser: Parser) -> None:
    """Add the arguments of ``tour``."""
    add = parser.add_argument
    parts = (
        "two folders with as many images each; frame q is at place q; of both, images FIRST, "
        "FIRST + STEP, … before STOP, or all"
    )
    cut = "REFERENCE:QUERY[@FIRST:STOP:STEP]"
    add("--part", required=True, metavar=cut, help=parts, **MANY)
    spells = (
        "of the query, a spell of 40 to 80 frames each: plain, night, blur, shift, fog, rain, "
        "glare (default: all); NAME:STRENGTH, above 0 and up to 1, and A+B for both at once"
    )
    add("--conditions", metavar="A,B", help=spells)
    add("--images", type=Path, metavar="DIR", help="write these, too, to DIR/reference, DIR/query")
    parser.add_shared("--seed", help="of the conditions (default: %(default)s)")
    parser.add_shared("--tolerance", required=True)
    parser.add_shared("--trust")
    _add_extraction(parser)


def _add_extraction(parser: Parser) -> None:
    parser.add_shared("--techniques", required=True)
    parser.add_shared(
        "--weights", "--device", "--seconds", "--cache", "--executor", "--name", "--out"
    )
    again = "measure the seconds even if the cache remembers them of this machine"
    parser.add_argument("--measure-again", action="store_true", help=again)


def add_render(parser: Parser) -> None:
    """Add the arguments of ``render``."""
    add = parser.add_argument
    each = "winter, night, fog, …: a folder for each; A+B is both at once"
    add("--condition", required=True, metavar="A,B", help=each)
    add("--places", type=int, default=200, metavar="N", help="of the route (default: %(default)s)")
    add("--size", metavar="WxH", help="of an image in pixels, e.g. 640x480")
    add("--kind", metavar="KIND", help="street, rail or corridor (default: the seed chooses)")
    parser.add_shared("--seed", help="of the route (default: %(default)s)")
    parser.add_shared("--out", metavar="DIR", help="for reference/ and a folder per condition")
