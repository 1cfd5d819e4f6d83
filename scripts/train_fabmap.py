"""Train FAB-MAP's vocabulary and Chow-Liu tree on a folder of images of other places."""

from pathlib import Path

from _cli import Parser, destination, run

from amusic_gym.extraction.progress import Progress
from amusic_gym.pretraining import train_fabmap
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.utils.checks import whole


def main(words: list[str] | None = None) -> None:
    """Parse, train, say where the vocabulary is."""
    parser = Parser(description=__doc__)
    add = parser.add_argument
    add("--images", type=Path, required=True, metavar="DIR", help="of other places than the map's")
    add("--out", type=destination, required=True, metavar="FILE", help="NAME.safetensors")
    add("--words", type=int, default=1000, metavar="V", help="of the vocabulary (%(default)s)")
    parser.add_shared("--seed")
    args = parser.parse_args(words)
    whole("--seed", args.seed, 0)
    total = len(ImageFolder(args.images))
    with Progress(True).bar("features", total, "images") as advance:
        tree = train_fabmap(
            args.images, args.out, words=args.words, seed=args.seed, advance=advance
        )
    roots = int((tree.parent == range(len(tree.parent))).sum())
    print(f"{args.out}: {args.words} words, {roots} without a parent")
    print(f"use it with --techniques fabmap --weights fabmap={args.out}")


if __name__ == "__main__":
    run(main)
