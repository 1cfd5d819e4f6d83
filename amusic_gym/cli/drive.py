"""What ``navigate`` prints: a line per frame, and a summary however the drive ends."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.live.answers import Answers
from amusic_gym.live.answers import line as as_json
from amusic_gym.live.drives import FrameResult
from amusic_gym.live.rerun import Recording
from amusic_gym.live.server import AnswerServer
from amusic_gym.utils.closing import Closing

DOUBT, SETTLED = 0.5, 20
"""p̂ of a doubtful frame, and frames after which many of them are worth a word."""

Publish = Callable[[FrameResult, dict[str, Any]], object]  # takes a frame and its answer

HEADER = f"{'frame':>6} {'place':>6} {'confidence':>10} {'p':>5} {'ms':>8}  techniques"


class Journal(Closing):
    """Prints results as they come, and the summary when it is left, by Ctrl-C too."""

    def __init__(self, route: LiveRoute, answers: Answers, *, quiet: bool = False) -> None:
        self.answers = answers
        self.route = route
        self.quiet = quiet
        self.frames = self.right = self.doubtful = 0
        self.milliseconds = self.reading = 0.0
        self.runs = np.zeros(len(route.techniques), np.int64)
        self.run_milliseconds = np.zeros(len(route.techniques))

    def write(self, result: FrameResult) -> bool | None:
        """Count a frame and print its line; whether its place is right, where that is known."""
        if not self.frames and not self.quiet:
            print(HEADER if self.route.truth is None else f"{HEADER}  (!: wrong place)")
        self.frames += 1
        self.milliseconds += result.milliseconds
        self.reading += result.read_milliseconds
        self.runs += result.ran + result.late_runs
        self.run_milliseconds += result.run_milliseconds
        self.doubtful += result.p_correct is not None and result.p_correct < DOUBT
        right = None
        if self.route.truth is not None:
            right = bool(self.route.truth.correct([result.prediction], [result.frame])[0])
            self.right += right
        if not self.quiet:
            print(line(result, right, self.answers.known(result)), flush=True)
        return right

    def close(self) -> None:
        """Print the summary."""
        if self.frames:
            print("\n".join(["", *self.summary()]), flush=True)

    def summary(self) -> list[str]:
        """What the drive was like, in lines."""
        whole = self.milliseconds + self.reading
        lines = [
            f"{self.frames} frames, {1000.0 * self.frames / whole:.1f} frames/s:"
            f" {self.milliseconds / self.frames:.1f} ms per frame and"
            f" {self.reading / self.frames:.1f} ms to get its image"
        ]
        if self.route.truth is not None:
            lines.append(f"right places: {self.right / self.frames:.1%}")
        if self.frames >= SETTLED and 2 * self.doubtful > self.frames:
            lines.append(
                f"p is below {DOUBT} on {self.doubtful / self.frames:.0%} of the frames: the robot"
                " may be off the map, or not move as the statistic takes it to (evidence and mean:"
                " one place per frame; belief: up to two, forwards); thin the video or the map, or"
                " compare --statistic belief and raw:NAME"
            )
        lines.append(f"{'technique':<16} {'runs/frame':>10} {'ms/run':>8}")
        for t, name in enumerate(self.route.techniques):
            mean = f"{self.run_milliseconds[t] / self.runs[t]:.1f}" if self.runs[t] else "-"
            lines.append(f"{name:<16} {self.runs[t] / self.frames:>10.2f} {mean:>8}")
        return lines


def publishers(args: argparse.Namespace, lines: TextIO | None, stack: ExitStack) -> list[Publish]:
    """What gives answers to other programs: lines of JSON, if any, ``--http`` and ``--rerun``.

    Raises:
        ValueError: for a port that cannot be had, or Rerun where it is not installed.
    """
    found: list[Publish] = []
    if lines is not None:
        found.append(lambda _, answer: print(as_json(answer), file=lines, flush=True))
    if args.http is not None:
        try:
            server = stack.enter_context(AnswerServer(args.http, args.host))
        except (OSError, OverflowError) as error:
            raise ValueError(
                f"--http {args.http} on --host {args.host}: {error}; give another port or address"
            ) from None
        print(f"answers at {server.url}", file=sys.stderr)
        found.append(lambda _, answer: server.put(answer))
    if args.rerun is not None:
        found.append(stack.enter_context(Recording(args.rerun)).write)
    return found


def line(result: FrameResult, right: bool | None, known: bool | None = None) -> str:
    """One frame; a wrong place is marked where the truth is known, an unknown one is no number."""
    p = "-" if result.p_correct is None else f"{result.p_correct:.2f}"
    words = " + ".join(result.active) or "nothing"
    if result.selection:
        words += f"  (selection, {result.late_runs.sum()} late runs)"
    place = str(result.prediction) if result.prediction >= 0 else "-"
    place = "unknown" if known is False else place
    mark = "!" if right is False else " "
    return (
        f"{result.frame:>6} {place:>6}{mark}{result.confidence:>10.2f} {p:>5}"
        f" {result.milliseconds:>8.1f}  {words}"
    )


def check_outputs(outputs: Mapping[str, Path | None], inputs: Mapping[str, str | None]) -> None:
    """Refuse files that cannot be written, or that would replace what is read, before any work."""
    taken = [(option, Path(path)) for option, path in inputs.items() if path is not None]
    for option, path in outputs.items():
        if path is None:
            continue
        for other, used in taken:
            same = path.exists() and used.exists() and path.samefile(used)  # links, or case
            if same or path.resolve() == used.resolve():
                raise ValueError(
                    f"{option} {path} is the file of {other} too and would replace it; give"
                    " another file"
                )
        taken.append((option, path))
        if path.is_dir():
            raise ValueError(f"{option} {path} is a folder; give a file in it")
        try:
            _try_writing(path)
        except OSError as error:
            raise ValueError(
                f"{option} {path} cannot be written ({error.strerror}); give another file"
            ) from None


def _try_writing(path: Path) -> None:
    """Open ``path`` for writing, or a nameless file where its folder is or would be made."""
    if path.is_file():
        path.open("ab").close()
    elif not path.exists():
        folder = next(above for above in path.absolute().parents if above.exists())
        tempfile.TemporaryFile(dir=folder).close()
