"""The commands of ``bank`` that have to do with descriptors: descriptors | describe."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from amusic_gym.banks.bank_files import check_destination, refuse_within_bank
from amusic_gym.banks.descriptors import METRICS, DescriptorPair, Descriptors
from amusic_gym.banks.ranking import TOP
from amusic_gym.cli import images as shared
from amusic_gym.cli.bank_truth import add_truth, check_truth, truth_of
from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import Parser, by_technique, numbers, pairs
from amusic_gym.extraction.progress import Progress
from amusic_gym.routes.descriptor_files import named, read_descriptors, read_traverse
from amusic_gym.routes.folders import ImageFolder

SIDES = ("reference", "query")


def descriptors(args: argparse.Namespace) -> None:
    """Descriptors of one or several techniques -> a bank."""
    from amusic_gym.banks.importers import from_descriptors

    check_destination(args.out)
    check_truth(args)
    paths = (args.reference_images, args.query_images)
    if args.order and None in paths:
        raise ValueError("--order goes with --reference-images DIR and --query-images DIR")
    images = [
        None if path is None else read_traverse(path, shared.order_of(args, side))
        for path, side in zip(paths, (0, -1), strict=True)
    ]
    made = read_pairs(args, args.reference, args.query, images)
    reference, query = (
        folder or _numbered(made[0].sides[side], SIDES[side], args.truth_by)
        for side, folder in enumerate(images)
    )
    truth, _ = truth_of(args, shared.Traverse(reference), shared.Traverse(query))
    names = [pair.technique for pair in made]
    with Progress(True).bar("descriptors", sum(map(len, made)), "pairs") as advance:
        bank = from_descriptors(
            made,
            numbers(by_technique(args.seconds, names, "--seconds"), "--seconds"),
            tolerance=args.tolerance,
            ground_truth=truth,
            exclude_recent=args.exclude_recent,
            name=args.name or args.out.name,
            out=args.out,
            advance=advance,
        )
    shared.tell(bank.path, bank.shape)


def describe(args: argparse.Namespace) -> None:
    """Images -> descriptors of techniques, and pairs of similar images, as hloc has them."""
    from amusic_gym.extraction.export import save_descriptors

    refuse_within_bank(args.out)
    techniques, _ = shared.techniques_of(args)
    query = None if args.query is None else shared.image_folder(args, args.query, -1)
    for technique in techniques:
        written = save_descriptors(
            args.out,
            technique,
            shared.image_folder(args, args.reference, 0),
            query,
            top=args.top_k,
            cache=args.cache,
            executor=args.executor,
            progress=True,
        )
        print(*written, sep="\n", flush=True)


def read_pairs(
    args: argparse.Namespace,
    reference: Sequence[str],
    query: Sequence[str],
    images: list[ImageFolder | None],
) -> list[DescriptorPair]:
    """The techniques of ``NAME=PATH``, each with its descriptors of the map and of the run.

    The map's descriptors name the techniques. Of ``images``, the map's and the run's, None is
    replaced by the names of the first file that has some.
    """
    files = [pairs(reference, "descriptors of the map:")]
    names = list(files[0])
    files.append(by_technique(query, names, "descriptors of the run"))
    if args.metric and not names:
        raise ValueError("--metric only goes with descriptors")
    if len(args.metric) == 1 and "=" not in args.metric[0]:
        metrics = dict.fromkeys(names, args.metric[0])
    else:
        metrics = by_technique(args.metric, names, "--metric")
    made = []
    for name in names:
        if name not in files[1]:
            raise ValueError(f"technique {name!r} has no descriptors of the run; give both sides")
        sides = []
        for at, side in enumerate(SIDES):
            found = read_descriptors(files[at][name], images[at], side)
            if images[at] is None and found.names is not None:
                images[at] = named(Path(found.source), [found.names[row] for row in found.rows])
            sides.append(found)
        made.append(DescriptorPair(name, sides[0], sides[1], metrics.get(name)))
    return made


def _numbered(found: Descriptors, side: str, by: str | None) -> ImageFolder:
    """A traverse whose images have no names."""
    if by in ("name", "position"):
        raise ValueError(f"{found.source} names no images; --truth-by {by} needs --{side}-images")
    return named(Path(found.source), [str(at) for at in range(len(found))])


def add_descriptors(parser: Parser) -> None:
    """Add the arguments of ``descriptors``."""
    for side, whose in zip(SIDES, ("map", "run"), strict=True):
        layouts = f"the {whose}'s: NAME=FILE.npy, NAME=FILE.h5[/GROUP] or NAME=DIR"
        parser.add_argument(f"--{side}", required=True, metavar="NAME=PATH", help=layouts, **MANY)
    for side, whose in zip(SIDES, ("map", "run"), strict=True):
        images = f"the {whose}'s images, or a list of their names: they give the order"
        parser.add_argument(f"--{side}-images", type=Path, metavar="DIR|LIST", help=images)
    parser.add_shared("--order", help="of DIRs whose names do not tell it: lists of names")
    add_metric(parser)
    parser.add_shared("--seconds", required=True, help="seconds of one run on one frame")
    add_truth(parser)
    parser.add_shared("--name", "--out")


def add_describe(parser: Parser) -> None:
    """Add the arguments of ``describe``."""
    parser.add_shared("--reference", required=True)
    parser.add_shared("--query", help="the run's images; without them, pairs are of the map's own")
    parser.add_shared("--order", "--skip-damaged")
    parser.add_shared("--techniques", required=True)
    parser.add_shared("--weights", "--device", "--trust", "--cache", "--executor")
    pairs = "pairs for each image of the run (default: %(default)s)"
    parser.add_argument("--top-k", type=int, default=TOP, metavar="K", help=pairs)
    parser.add_shared("--out", metavar="DIR", help="for NAME.h5 and NAME-pairs.txt")
    parser.set_defaults(seconds=[])


def add_metric(parser: Parser) -> None:
    """Add the metric of descriptors."""
    which = f"{', '.join(METRICS)} (default: dot, where all descriptors are equally long)"
    parser.add_argument("--metric", metavar="[NAME=]METRIC", help=which, **MANY)
