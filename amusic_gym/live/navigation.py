"""Runs a policy along a live route, frame by frame, as a robot would."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.policies.protocol import Correction, Localiser, Policy, Rows, Selector, highest_z
from amusic_gym.policies.trace import CSV_COLUMNS, csv_line
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.escaping import CsvWriter

if TYPE_CHECKING:
    from amusic_gym.envs.live_rows import LiveRows


@dataclass(frozen=True, eq=False)
class FrameResult:
    """One frame of a drive: what ran, where the robot is, and how long it took.

    Attributes:
        frame: number of the frame, from 0.
        image: the query image.
        prediction: place, -1 before the first.
        confidence: higher = surer.
        similarity: z-score of the place in this frame's row of the technique that MuSIC trusted;
            of a localiser, the largest in the rows it asked for; 0 where nothing ran.
        p_correct: SIC-estimated correctness; None where the policy gives none.
        technique: the one that MuSIC trusted, -1: none.
        ran: (T,) bool, on the frame itself.
        late_runs: (T,) after-the-fact runs before it.
        selection: whether a selection was done before it.
        run_milliseconds: (T,) wall time of the runs, after-the-fact ones included.
        read_milliseconds: wall time until the image was there: disk, decoder or camera.
        milliseconds: wall time of all the rest: the policy, the runs and the localisation.
        techniques: T names.
    """

    frame: int
    image: Image
    prediction: int
    confidence: float
    similarity: float
    p_correct: float | None
    technique: int
    ran: NDArray[np.bool_]
    late_runs: NDArray[np.int64]
    selection: bool
    run_milliseconds: NDArray[np.float64]
    read_milliseconds: float
    milliseconds: float
    techniques: tuple[str, ...]

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the techniques that ran on the frame."""
        return tuple(n for n, on in zip(self.techniques, self.ran, strict=True) if on)


def navigate(
    policy: Policy,
    route: LiveRoute,
    *,
    statistic: str = SICSettings.statistic,
    carry: bool | None = None,
    discount: bool | None = None,
    compute_weight: float | None = None,
) -> Iterator[FrameResult]:
    """Run a policy along a live route, one frame at a time.

    A frame's image is read, and its techniques run, when the iterator is asked for it; the
    predictions are those of the same policy on a score bank of the same images.

    Args:
        policy: selector or localiser.
        route: the map and where the images come from; it may be endless.
        statistic: SIC's statistic, unless the policy needs its own.
        carry: whether places are carried on as candidates, unless the policy needs its own; None:
            as the statistic has it.
        discount: whether MuSIC discounts alike rows; as `carry`.
        compute_weight: λ; None for policies that have none.

    Raises:
        ValueError: for what :class:`~amusic_gym.envs.task.Task` and the route refuse.
        FileNotFoundError: for an image that is gone.
    """
    if isinstance(policy, Selector):
        how = Correction.under(policy, statistic, carry, discount)
        return _select(policy, route, how, compute_weight)
    return _localise(policy, route)


def _select(
    policy: Selector, route: LiveRoute, how: Correction, compute_weight: float | None
) -> Iterator[FrameResult]:
    from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

    needs = policy.needs
    env = TechniqueSelectionVectorEnv(
        1,
        route,
        slots=len(route.techniques),
        reselection=needs.reselection,
        coverage=needs.coverage,
        allow_idle=needs.allow_idle,
        **how._asdict(),
        **needs.extra,
    )
    weight = 1.0 if compute_weight is None else compute_weight
    observation, info = env.reset(options={"start": 0, "compute_weight": weight})
    policy.reset(np.ones(1, np.bool_))
    drive = env.task.episodes.drives[0]
    assert drive is not None
    while True:
        begin, last = time.perf_counter(), drive.frame
        observation, _, terminated, truncated, info = env.step(policy.act(observation, info))
        if drive.frame > last:
            elapsed = 1000.0 * (time.perf_counter() - begin)
            yield _seen(drive, elapsed, **_told(info, len(route.techniques)))
        if terminated[0] or truncated[0]:
            return


def _told(info: dict[str, Any], techniques: int) -> dict[str, Any]:
    """What the infos of a batch of one say of the frame."""
    selection = info.get("selection")
    none = np.zeros(techniques, np.int64)
    return {
        "prediction": int(info["prediction"][0]),
        "confidence": float(info["confidence"][0]),
        "similarity": float(info["similarity"][0]),
        "p_correct": float(info["p_correct"][0]),
        "technique": int(info["technique"][0]),
        "ran": info["ran"][0],
        "late_runs": none if selection is None else selection["late_runs"][0],
        "selection": selection is not None and bool(selection["happened"][0]),
    }


def _localise(policy: Localiser, route: LiveRoute) -> Iterator[FrameResult]:
    drive = route.drive(0, SICSettings(), 0)
    techniques = len(route.techniques)
    policy.reset(route.references, techniques)
    frame = 0
    while drive.frames is None or frame < drive.frames:
        begin = time.perf_counter()
        if not drive.advance(frame):
            return
        ran = np.zeros(techniques, np.bool_)
        rows: Rows = {}

        def run(
            technique: int, ran: NDArray[np.bool_] = ran, rows: Rows = rows
        ) -> NDArray[np.float32]:
            ran[technique] = True
            rows[technique] = row = drive.run(technique, drive.frame)
            return row.copy()  # its memory will hold another frame

        place, confidence = policy.locate(frame, run)
        yield _seen(
            drive,
            1000.0 * (time.perf_counter() - begin),
            prediction=place,
            confidence=confidence,
            similarity=highest_z(rows.values(), place),
            p_correct=None,
            technique=-1,
            ran=ran,
            late_runs=np.zeros(techniques, np.int64),
            selection=False,
        )
        frame += 1


def _seen(drive: LiveRows, elapsed: float, **told: Any) -> FrameResult:
    """A frame with what the drive knows of it; ``elapsed`` milliseconds in all."""
    return FrameResult(
        frame=drive.frame,
        image=drive.image(),
        run_milliseconds=drive.milliseconds + drive.late_milliseconds,
        read_milliseconds=drive.read_milliseconds,
        milliseconds=elapsed - drive.read_milliseconds,
        techniques=drive.route.techniques,
        **told,
    )


class TraceWriter:
    """Writes a drive as CSV, a whole line per frame as it comes: what is there stays readable.

    The columns are those of :meth:`amusic_gym.policies.trace.Trace.write_csv`, then the
    milliseconds of the frame without reading its image, of reading it, and of each technique's
    runs. ``correct`` is empty where the ground truth is not known.

    Args:
        path: the file; one that is there is replaced.
        route: the route that is driven.

    Example:
        >>> with TraceWriter("trace.csv", route) as writer:  # doctest: +SKIP
        ...     for result in navigate(policy, route):
        ...         writer.write(result)
    """

    def __init__(self, path: str | Path, route: LiveRoute) -> None:
        self.truth = route.truth
        self.columns = (
            *CSV_COLUMNS,
            "milliseconds",
            "read_milliseconds",
            *(f"{name}_milliseconds" for name in route.techniques),
        )
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        # One line is one write: none is ever half in the file.
        self._file: TextIO = Path(path).open("w", encoding="utf-8", newline="", buffering=1)
        self._writer = CsvWriter(self._file)
        self._writer.writerow(self.columns)

    def write(self, result: FrameResult) -> None:
        """Write a frame's line."""
        frame, prediction = result.frame, result.prediction
        known = None if self.truth is None else bool(self.truth.correct([prediction], [frame])[0])
        line = csv_line(
            frame,
            prediction,
            float(result.confidence),
            float(result.similarity),
            result.p_correct,
            known,
            result.active,
            int(result.late_runs.sum()),
        )
        self._writer.writerow(
            [
                *line,
                f"{result.milliseconds:.3f}",
                f"{result.read_milliseconds:.3f}",
                *(f"{ms:.3f}" for ms in result.run_milliseconds),
            ]
        )

    def close(self) -> None:
        """Close the file; a second time, nothing."""
        self._file.close()

    def __enter__(self) -> TraceWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
