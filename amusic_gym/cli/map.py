"""Make and inspect maps: build | append | info.

A map is a folder with descriptors, small images and, if given, positions of all places. `navigate
--map` and `amusic_gym.live.localiser` load it; the images are no longer needed.
"""

import argparse
import math
from contextlib import ExitStack
from pathlib import Path

from amusic_gym.cli import images as shared
from amusic_gym.cli.parser import Parser, add_commands, pairs


def build(args: argparse.Namespace) -> None:
    """Images or a video -> a map."""
    from amusic_gym.extraction.map_files import check_destination
    from amusic_gym.extraction.place_map import build_map

    specs, weights = shared.specs_of(args)
    _, seconds = shared.techniques_of(args)  # refuses what cannot be made, before any work
    check_destination(args.out)
    with ExitStack() as stack:
        folder, positions = shared.traverse(args, args.images, stack, args.positions)
        build_map(
            folder,
            specs,
            args.out,
            weights=weights,
            positions=positions,
            seconds=seconds,
            name=args.name or "",
            cache=args.cache,
            executor=args.executor,
            progress=True,
        )
        print(f"{args.out}: {len(specs)} techniques, {len(folder)} places")


def append(args: argparse.Namespace) -> None:
    """A map, and images or a video of further places -> the map with these behind."""
    from amusic_gym.extraction.place_map import append_to_map

    with ExitStack() as stack:
        folder, positions = shared.traverse(args, args.images, stack, args.positions)
        append_to_map(
            args.map,
            folder,
            weights=pairs(args.weights, "--weights"),
            positions=positions,
            cache=args.cache,
            executor=args.executor,
            progress=True,
        )
        print(f"{args.map}: {len(folder)} places more")


def info(args: argparse.Namespace) -> None:
    """Check a map whole and print what is in it."""
    from amusic_gym.extraction import map_files
    from amusic_gym.extraction.place_map import PlaceMap

    found = map_files.read(args.map, verify=True)
    print(f"map         {found.name}  ({args.map.resolve()})")
    print(f"places      {' + '.join(map(str, found.parts))}")
    where = found.positions
    print(f"positions   {f'{where.system}' if where else '-'}")
    print(f"\n{'technique':<20} {'seconds':>10} {'descriptor':>14} {'MB':>8}  parameters")
    for each, blocks in zip(found.techniques, found.descriptors, strict=True):
        shape = blocks[0].shape[1:]
        size = sum(4 * math.prod(block.shape) for block in blocks) / 1e6
        told = ", ".join(f"{name} {value}" for name, value in each.identity["parameters"].items())
        words = f"{'x'.join(map(str, shape)):>14} {size:>8.1f}  {told}"
        print(f"{each.name:<20} {each.seconds:>10.6f} {words}")
    try:
        PlaceMap.load(args.map, weights=pairs(args.weights, "--weights")).close()
    except (ValueError, FileNotFoundError) as error:
        print(f"\nnot usable here: {error}")


def add_arguments(parser: Parser) -> None:
    """Add the commands, and the arguments of each."""
    add_commands(
        parser,
        (build, _add_build, "describe images or a video by techniques"),
        (append, _add_append, "add the places of another traverse behind a map's"),
        (info, _add_info, "check a map and print what is in it"),
    )


def _add_build(parser: Parser) -> None:
    _add_images(parser)
    parser.add_shared("--techniques", required=True)
    parser.add_shared("--weights", "--seconds", "--name")
    parser.add_shared("--out", metavar="MAP")
    parser.set_defaults(device="cpu", trust=False)  # a map is loaded without a question, anywhere


def _add_append(parser: Parser) -> None:
    parser.add_argument("map", type=Path, metavar="MAP", help="its folder")
    _add_images(parser)
    parser.add_shared("--weights", help="where these are not where they were")


def _add_info(parser: Parser) -> None:
    parser.add_argument("map", type=Path, metavar="MAP", help="its folder")
    parser.add_shared("--weights", help="where these are not where they were")


def _add_images(parser: Parser) -> None:
    what = "the reference traverse: a folder of images, or a video"
    parser.add_argument("images", type=Path, metavar="IMAGES|VIDEO", help=what)
    about = "where the images were taken: a table, poses of TUM or KITTI, a ROS bag, their EXIF"
    parser.add_argument("--positions", metavar="FILE|exif", help=about)
    parser.add_shared("--order", "--skip-damaged", "--every", "--fps", "--every-metres")
    parser.add_shared("--cache", "--executor")
