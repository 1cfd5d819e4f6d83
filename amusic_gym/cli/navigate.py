"""Recognise places live: run a policy on a folder of images, a video or a camera.

Only what the policy activates is computed. POLICY: those of compare but the oracle. A query that is
a number is a camera, and one that begins with http:// or rtsp:// a camera on the network.
Techniques and policy run once on images of the map before the drive, so that compiling and loading
are not in the first frame's time.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, redirect_stdout
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth, check_tolerance
from amusic_gym.cli.bank_truth import given
from amusic_gym.cli.described import (
    TECHNIQUES,
    Described,
    from_file,
    from_images,
    techniques_for,
    truth_of,
)
from amusic_gym.cli.drive import Journal, check_outputs, publishers
from amusic_gym.cli.images import run_of, thinning
from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import (
    Parser,
    add_statistic,
    by_technique,
    correction_of,
    destination,
    insisted,
    numbers,
)
from amusic_gym.envs.frames import FrameSource, ImageSequence
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.envs.pictures.drive import Pictures
from amusic_gym.envs.task import RENDER_FPS
from amusic_gym.envs.window import Window
from amusic_gym.evaluation.contestants import Contestant, check_weights, contestants
from amusic_gym.evaluation.plots.labels import policy_label
from amusic_gym.live.answers import Answers
from amusic_gym.live.drives import FrameResult
from amusic_gym.live.limits import Keeper, Limits
from amusic_gym.live.localiser import COMPUTE_WEIGHT, TOLERANCE
from amusic_gym.live.navigation import TraceWriter, navigate
from amusic_gym.policies.protocol import Context, Policy
from amusic_gym.routes import image_truth
from amusic_gym.routes.network_camera import NetworkCamera
from amusic_gym.routes.positions import Positions
from amusic_gym.routes.video import Camera, VideoFile, VideoWriter
from amusic_gym.techniques import Image
from amusic_gym.utils.checks import share, whole

LIMITS = ("budget_ms", "budget_fps", "budget_joules", "cap_ms")

WARM_UP = 2  # frames of the map that the policy is run on before the drive


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    parser.add_shared("--reference")
    made = "in place of --reference and --techniques: what `map build` made of them"
    add("--map", type=Path, metavar="MAP", help=made)
    parser.add_shared("--query", required=True, metavar="DIR|VIDEO|CAMERA", help="what is seen")
    parser.add_shared("--policy", required=True)
    parser.add_shared("--techniques", help=f"(default: {TECHNIQUES})")
    parser.add_shared("--weights", "--device", "--seconds")
    add_statistic(parser, "unless the policy brings its own")
    weight = "λ of a trained selector or voi (default: %(default)s)"
    add("--compute-weight", type=float, default=COMPUTE_WEIGHT, metavar="L", help=weight)
    budget = "per frame on average, which λ is steered to; give one of the three"
    add("--budget-ms", type=float, metavar="MS", help=f"milliseconds {budget}")
    add("--budget-fps", type=float, metavar="FPS", help="the same as frames per second")
    add("--budget-joules", type=float, metavar="J", help="joules likewise; with --joules")
    add("--joules", **MANY, metavar="NAME=J", help="of a run, of each technique")
    add("--cap-ms", type=float, metavar="MS", help="milliseconds that no frame may exceed")
    add(
        "--tolerance",
        type=int,
        metavar="N",
        help="how many places apart two matches may be and still count as the same place"
        f" (default: {TOLERANCE}, or what the ground truth lists); with --ground-truth of one"
        " place per frame also how far off a match is still right",
    )
    parser.add_shared("--ground-truth", "--trust", "--order", "--skip-damaged", "--seed")
    parser.add_shared("--reference-positions", "--query-positions", "--every-metres")
    near = f"with both: right within so many metres (default: {image_truth.METRES:g})"
    add("--within", type=float, metavar="METRES", help=near)
    parser.add_shared("--every", "--fps")
    parser.add_shared("--cache", type=destination, help="where descriptors of the map are kept")
    add("--trace", type=destination, metavar="FILE.csv", help="write a line per frame")
    add("--video", type=destination, metavar="FILE.mp4|.avi", help="write a picture per frame")
    add("--show", action="store_true", help="show it in a window, until that is closed")
    least = "estimated correctness below which a place is unknown (default: none is)"
    add("--min-p", type=float, metavar="P", help=least)
    lines = "jsonl: a line of JSON per frame on stdout, all words on stderr (default: %(default)s)"
    add("--output", choices=("text", "jsonl"), default="text", help=lines)
    served = "serve /last (JSON), /events (server-sent) and a page at /; 0 takes a free port"
    add("--http", type=int, metavar="PORT", help=served)
    whose = "address that --http listens on; 0.0.0.0 lets all read (default: %(default)s)"
    add("--host", default="127.0.0.1", metavar="ADDRESS", help=whose)
    rerun = "record for Rerun's viewer, or show it in one that runs"
    add("--rerun", metavar="FILE.rrd|connect", help=rerun)
    add("--frames", type=int, metavar="N", help="stop after so many")
    add("--quiet", action="store_true", help="print the summary only")


def main(args: argparse.Namespace) -> None:
    """Describe the map, drive."""
    correction = correction_of(args)
    weights = check_weights([args.compute_weight])
    (policy,) = contestants([args.policy], compute_weights=weights, **insisted(args))
    _check(args)
    with ExitStack() as stack:
        lines = None
        if args.output == "jsonl":
            lines = sys.stdout
            stack.enter_context(redirect_stdout(sys.stderr))
        publish = publishers(args, lines, stack)
        if args.map is None:
            techniques, seconds = techniques_for(args)
            names = [one.name for one in techniques]
        else:
            described = from_file(args, stack)
            names = [one.technique.name for one in described.maps]
        limits = _limits(args, names)
        _refuse_early(policy, names, correction)
        window = stack.enter_context(closing(_window())) if args.show else None
        video = stack.enter_context(VideoWriter(args.video, RENDER_FPS)) if args.video else None
        frames, there = _frames(args, stack)
        stack.callback(getattr(frames, "close", lambda: None))
        if args.map is None:
            described = from_images(args, techniques, seconds, frames, stack)
        truth = truth_of(args, described, frames, there, TOLERANCE)
        route = _route(args, described, frames, truth)
        measured = len(by_technique(args.seconds, names, "--seconds")) < len(names)
        keep = partial(
            limits.keeper,
            techniques=route.techniques,
            seconds=route.seconds,
            measured=measured,
            weight=args.compute_weight,
        )
        route = route.with_seconds(limits.costs(route.techniques, route.seconds))
        _warm_up(policy, route, described.images[0], correction)
        pictures = Pictures(route, f"{route.name}, {policy_label(args.policy)}")
        trace = stack.enter_context(TraceWriter(args.trace, route)) if args.trace else None
        drive = _drive(policy, route, correction, args.seed, keep)
        images = described.images if described.file is None else described.file
        answers = Answers(getattr(images, "names", None), described.positions, args.min_p)
        journal = stack.enter_context(Journal(route, answers, quiet=args.quiet or bool(lines)))
        for result in islice(drive, args.frames):
            answer = answers.of(result, journal.write(result))
            for each in publish:
                each(result, answer)
            if trace:
                trace.write(result)
            picture = pictures.draw(result) if video or window else None
            if video and picture is not None:
                video.write(picture)
            if window and picture is not None:
                window.show(picture)
                if window.closed_by_user:
                    break


def _check(args: argparse.Namespace) -> None:
    """Refuse numbers out of range, and files that cannot be written or are read, at once."""
    if args.frames is not None:
        args.frames = min(whole("--frames", args.frames, 1), sys.maxsize)
    whole("--seed", args.seed, 0)
    if args.min_p is not None:
        share("--min-p", args.min_p)
    if args.tolerance is not None:
        check_tolerance(args.tolerance)
    inputs = {"--query": args.query, "--ground-truth": args.ground_truth}
    rerun = None if args.rerun in (None, "connect") else Path(args.rerun)
    check_outputs({"--trace": args.trace, "--video": args.video, "--rerun": rerun}, inputs)


def _limits(args: argparse.Namespace, names: Sequence[str]) -> Limits:
    """What a frame may cost, refused at once where the policy cannot keep to it."""
    joules = numbers(by_technique(args.joules, names, "--joules"), "--joules")
    fields = {name: getattr(args, name) for name in LIMITS}
    limits = Limits(**fields, joules=joules or None)
    limits.check(args.policy)
    return limits


def _refuse_early(policy: Contestant, names: Sequence[str], correction: Mapping[str, Any]) -> None:
    """Let a wrong policy fail before the map is described, which can take long."""
    stand_in = ScoreBank(
        np.zeros((len(names), 1, 1), np.float32), names, np.ones(len(names)), tolerance=0
    )
    policy.make(Context.of(stand_in, **correction))


def _window() -> Window:
    try:
        window = Window("amusic-gym")
    except ImportError as error:
        raise ValueError(str(error)) from None
    window.check()
    return window


def _frames(args: argparse.Namespace, stack: ExitStack) -> tuple[FrameSource, Positions | None]:
    """The folder, video or camera of the command line, and where a folder's images were taken."""
    query, taken = args.query, thinning(args)
    is_url = "://" in query and not Path(query).exists()
    is_camera = is_url or (query.lstrip("-").isdecimal() and not Path(query).exists())
    filmed = args.reference is not None and args.reference.is_file()
    if given(args, "every", "fps") and not filmed and (is_camera or Path(query).is_dir()):
        raise ValueError(f"--every and --fps thin a video, but --query {query} is none")
    if is_camera and query.startswith("-"):
        raise ValueError(f"--query {query}: camera numbers are 0, 1, …")
    if Path(query).is_dir():
        run = run_of(args, stack)
        return ImageSequence(run.folder, Path(query).resolve().name), run.positions
    for name in ("query_positions", "every_metres"):
        if getattr(args, name) is not None:
            option = name.replace("_", "-")
            raise ValueError(f"--{option} needs a folder of images, but --query is {query}")
    if is_camera:
        return NetworkCamera(query) if is_url else Camera(int(query)), None
    return VideoFile(query, **taken), None


def _route(
    args: argparse.Namespace,
    described: Described,
    frames: FrameSource,
    truth: GroundTruth | None,
) -> LiveRoute:
    """The live route; seconds that are not given are measured."""
    maps, given = described.maps, described.seconds
    options: dict[str, Any] = {"places": described.images, "ground_truth": truth}
    options["tolerance"] = TOLERANCE if truth is args.tolerance is None else args.tolerance
    names = [one.technique.name for one in maps]
    known = dict(given)
    if len(given) < len(names):
        route = LiveRoute(maps, frames, **options)
        if not given:
            return route
        known = {**dict(zip(names, route.seconds, strict=True)), **given}
    return LiveRoute(maps, frames, seconds=[known[name] for name in names], **options)


def _warm_up(
    policy: Contestant, route: LiveRoute, image: Image, correction: Mapping[str, Any]
) -> None:
    """Compile, load and run everything once, on an image of the map."""
    for technique in range(len(route.techniques)):
        route.run(technique, image, 0)
    short = LiveRoute(
        route.maps,
        [image] * WARM_UP,
        tolerance=route.tolerance,
        seconds=route.seconds,
        name=route.name,
    )
    for _ in _drive(policy, short, correction, seed=0):
        pass


def _drive(
    policy: Contestant,
    route: LiveRoute,
    correction: Mapping[str, Any],
    seed: int,
    keep: Callable[[Policy], Keeper | None] = lambda policy: None,
) -> Iterator[FrameResult]:
    made = policy.make(Context.of(route, seed=seed, **correction))
    weight = policy.compute_weights[0]
    return navigate(made, route, compute_weight=weight, keeper=keep(made), **correction)
