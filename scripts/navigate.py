"""Recognise places live: run a policy on a folder of images, a video or a camera.

Only what the policy activates is computed. POLICY: those of compare.py but the oracle. A query that
is a number is a camera. Techniques and policy run once on images of the map before the drive, so
that compiling and loading are not in the first frame's time.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing
from itertools import islice
from pathlib import Path
from typing import Any

from _cli import (  # first: Ctrl-C ends well from here on
    Parser,
    add_correction,
    by_technique,
    destination,
    insisted,
    number,
    pairs,
    run,
)

# isort: split
import numpy as np
from _drive import Journal, Screen, check_outputs
from _folders import add_reading, map_of, run_of

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import check_tolerance
from amusic_gym.envs.live_route import FrameSource, ImageSequence, LiveRoute
from amusic_gym.envs.pictures.sightings import Pictures
from amusic_gym.envs.task import RENDER_FPS
from amusic_gym.envs.window import Window
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.evaluation.contestants import Contestant, check_weights, contestants
from amusic_gym.evaluation.plots.labels import policy_label
from amusic_gym.extraction.cache import Cache
from amusic_gym.extraction.map import DescribedMap, describe_map
from amusic_gym.live.navigation import Sighting, TraceWriter, navigate
from amusic_gym.policies.protocol import Context
from amusic_gym.routes.folders import ImageFolder, check_apart
from amusic_gym.routes.image_truth import from_file, warn_of_shared_files
from amusic_gym.routes.video import Camera, VideoFile, VideoWriter
from amusic_gym.techniques import Technique, make_technique
from amusic_gym.utils.checks import whole

COMPUTE_WEIGHT = 0.3
"""λ of a trained selector where none is named: in the middle of what `compare.py` runs."""

TOLERANCE = 2
"""Places that count as one when matches are compared, where none is named."""

WARM_UP = 2
"""Frames of the map that the policy is run on before the drive."""


def frames_of(args: argparse.Namespace) -> FrameSource:
    """The folder, video or camera of the command line."""
    query, thinned = args.query, args.every is not None or args.fps is not None
    if args.every is not None and args.fps is not None:
        raise ValueError("--every and --fps both thin a video; give one of the two")
    if thinned and (query.lstrip("-").isdecimal() or Path(query).is_dir()):
        raise ValueError(f"--every and --fps thin a video, but --query {query} is none")
    if query.isdecimal() and not Path(query).exists():
        return Camera(int(query))
    if re.fullmatch(r"-\d+", query) and not Path(query).exists():
        raise ValueError(f"--query {query}: camera numbers are 0, 1, …")
    if Path(query).is_dir():
        return ImageSequence(run_of(args), Path(query).resolve().name)
    every = 1 if args.every is None else whole("--every", args.every, 1)
    return VideoFile(query, every=every, fps=args.fps)


def techniques_of(args: argparse.Namespace) -> list[Technique]:
    """The techniques of the command line, with their weights."""
    names = [name.strip() for name in args.techniques.split(",") if name.strip()]
    weights, unknown = by_technique(pairs(args.weights, "--weights"), names)
    made = [make_technique(name, weights.get(name)) for name in names]
    if unknown or not made:
        given = ", ".join(name.casefold() for name in unknown)
        raise ValueError(
            f"--weights for {given or 'nothing'}, but --techniques names"
            f" {', '.join(names) or 'none'}; name each technique there"
        )
    return made


def seconds_of(given: list[str], techniques: tuple[str, ...]) -> dict[int, float]:
    """Declared seconds by the technique's index, of those that are given."""
    named = pairs(given, "--seconds")
    found, unknown = by_technique(named, techniques)
    if unknown:
        first = f"{unknown[0]}={named[unknown[0]]}"
        raise ValueError(f"--seconds {first}: techniques are {', '.join(techniques)}")
    return {
        techniques.index(name): number(f"--seconds {name}", text) for name, text in found.items()
    }


def route_of(
    args: argparse.Namespace, maps: list[DescribedMap], frames: FrameSource, places: ImageFolder
) -> LiveRoute:
    """The live route; costs that are not given are measured."""
    options: dict[str, Any] = {"tolerance": args.tolerance, "places": places}
    if args.tolerance is None and args.ground_truth is None:
        options["tolerance"] = TOLERANCE
    if args.ground_truth is not None:
        if not isinstance(frames, ImageSequence):
            raise ValueError("--ground-truth needs a --query whose length is known: a folder")
        folder = frames.images
        assert isinstance(folder, ImageFolder)
        options["ground_truth"] = from_file(
            args.ground_truth, places, folder, args.tolerance, args.trust, default=TOLERANCE
        )
    given = seconds_of(args.seconds, tuple(one.technique.name for one in maps))
    if len(given) == len(maps):
        return LiveRoute(maps, frames, seconds=[given[t] for t in range(len(maps))], **options)
    route = LiveRoute(maps, frames, **options)
    if not given:
        return route
    seconds = [given.get(t, measured) for t, measured in enumerate(route.seconds)]
    return LiveRoute(maps, frames, seconds=seconds, **options)


def refuse_early(
    policy: Contestant, techniques: list[Technique], correction: Mapping[str, Any]
) -> None:
    """Let a wrong policy fail before the map is described, which can take long."""
    names = [one.name for one in techniques]
    stand_in = ScoreBank(
        np.zeros((len(names), 1, 1), np.float32), names, np.ones(len(names)), tolerance=0
    )
    policy.make(Context.of(stand_in, **correction))


def drive(
    policy: Contestant, route: LiveRoute, correction: Mapping[str, Any], seed: int
) -> Iterator[Sighting]:
    """A drive with a fresh policy."""
    made = policy.make(Context.of(route, seed=seed, **correction))
    return navigate(made, route, compute_weight=policy.compute_weights[0], **correction)


def warm_up(
    policy: Contestant, route: LiveRoute, places: ImageFolder, correction: Mapping[str, Any]
) -> None:
    """Compile, load and run everything once, on images of the map."""
    image = places[0]
    for technique in range(len(route.techniques)):
        route.run(technique, image, 0)
    short = LiveRoute(
        route.maps,
        [image] * WARM_UP,
        tolerance=route.tolerance,
        seconds=route.seconds,
        name=route.name,
    )
    for _ in drive(policy, short, correction, seed=0):
        pass


def check(args: argparse.Namespace) -> None:
    """Refuse numbers out of range, and files that cannot be written or are read, at once."""
    if args.frames is not None:
        args.frames = min(whole("--frames", args.frames, 1), sys.maxsize)
    whole("--seed", args.seed, 0)
    if args.tolerance is not None:
        check_tolerance(args.tolerance)
    inputs = {"--query": args.query, "--ground-truth": args.ground_truth}
    check_outputs({"--trace": args.trace, "--video": args.video}, inputs)


def main(arguments: list[str] | None = None) -> None:
    """Parse, describe the map, drive."""
    args = _parser().parse_args(arguments)
    correction = {**insisted(args), "statistic": args.statistic or SICSettings.statistic}
    policy = contestants(
        [args.policy], compute_weights=check_weights([args.compute_weight]), **insisted(args)
    )[0]
    check(args)
    techniques = techniques_of(args)
    refuse_early(policy, techniques, correction)
    with ExitStack() as stack:
        window = stack.enter_context(closing(_window())) if args.show else None
        video = VideoWriter(args.video, RENDER_FPS) if args.video else None
        frames = frames_of(args)
        stack.callback(getattr(frames, "close", lambda: None))
        places = map_of(args)
        if isinstance(frames, ImageSequence):
            check_apart(places, frames.images)
            if isinstance(frames.images, ImageFolder):
                warn_of_shared_files(places, frames.images)
        route = route_of(args, _maps(args, techniques, places, stack), frames, places)
        warm_up(policy, route, places, correction)
        title = f"{route.name}, {policy_label(args.policy)}"
        screen = stack.enter_context(Screen(Pictures(route, title), video, window))
        trace = stack.enter_context(TraceWriter(args.trace, route)) if args.trace else None
        journal = stack.enter_context(Journal(route, quiet=args.quiet))
        for sighting in islice(drive(policy, route, correction, args.seed), args.frames):
            journal.write(sighting)
            if trace is not None:
                trace.write(sighting)
            if not screen.show(sighting):
                break


def _maps(
    args: argparse.Namespace, techniques: list[Technique], places: ImageFolder, stack: ExitStack
) -> list[DescribedMap]:
    """The map as each technique describes it, until ``stack`` is left."""
    cache = stack.enter_context(Cache(args.cache))
    return [
        stack.enter_context(
            closing(describe_map(places, one, cache=cache, progress=not args.quiet))
        )
        for one in techniques
    ]


def _window() -> Window:
    try:
        window = Window("amusic-gym")
    except ImportError as error:
        raise ValueError(str(error)) from None
    window.check()
    return window


def _parser() -> Parser:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--reference", type=Path, required=True, metavar="DIR", help="images of the map, in order")
    add("--query", required=True, metavar="DIR|VIDEO|CAMERA", help="folder, video file or number")
    add("--policy", required=True, metavar="POLICY", help="what decides which techniques run")
    add(
        "--techniques",
        default="hog,cohog,calc,netvlad",
        metavar="A,B",
        help="which there are (default: %(default)s)",
    )
    add(
        "--weights",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=FILE",
        help="weights of a learned technique (default: those that it ships with)",
    )
    add(
        "--seconds",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=S",
        help="declared seconds of a run (default: measured before the first frame)",
    )
    add("--statistic", choices=STATISTICS, help=f"of SIC (default: {SICSettings.statistic})")
    add_correction(parser, "unless the policy brings its own")
    add(
        "--compute-weight",
        type=float,
        default=COMPUTE_WEIGHT,
        metavar="L",
        help="λ of a trained selector or voi (default: %(default)s)",
    )
    add(
        "--tolerance",
        type=int,
        metavar="N",
        help="how many places apart two matches may be and still count as the same place"
        f" (default: {TOLERANCE}, or what the ground truth lists); with --ground-truth of one"
        " place per frame also how far off a match is still right",
    )
    add(
        "--ground-truth",
        type=Path,
        metavar="FILE",
        help="the true places: only with them are matches shown as right or wrong",
    )
    add("--trust", action="store_true", help="unpickle a ground truth file of VPR-Bench")
    add("--every", type=int, metavar="N", help="of a video: take each N-th frame")
    add("--fps", type=float, metavar="F", help="of a video: take F frames per second of it")
    add_reading(parser)
    add("--cache", type=destination, metavar="DIR", help="where descriptors of the map are kept")
    add("--trace", type=destination, metavar="FILE.csv", help="write a line per frame")
    add(
        "--video",
        type=destination,
        metavar="FILE.mp4|.avi",
        help="write the picture of every frame",
    )
    add(
        "--show", action="store_true", help="show it in a window; closing the window ends the drive"
    )
    add("--frames", type=int, metavar="N", help="stop after so many")
    add("--seed", type=int, default=0, metavar="S", help="for policies that draw (default: 0)")
    add("--quiet", action="store_true", help="print the summary only")
    return parser


if __name__ == "__main__":
    run(main)
