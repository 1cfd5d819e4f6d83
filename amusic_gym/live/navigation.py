"""Runs a policy along a live route, frame by frame, as a robot would."""

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.live.drives import FrameResult, drive_along
from amusic_gym.live.limits import Keeper
from amusic_gym.policies.protocol import Correction, Policy
from amusic_gym.policies.trace import CSV_COLUMNS, csv_line
from amusic_gym.utils.closing import Closing
from amusic_gym.utils.escaping import CsvWriter


def navigate(
    policy: Policy,
    route: LiveRoute,
    *,
    statistic: str = SICSettings.statistic,
    carry: bool | None = None,
    discount: bool | None = None,
    compute_weight: float | None = None,
    keeper: Keeper | None = None,
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
        keeper: holds the drive within limits, see `Limits.keeper`.

    Raises:
        ValueError: for what :class:`~amusic_gym.envs.task.Task` and the route refuse.
        FileNotFoundError: for an image that is gone.
    """
    how = Correction.under(policy, statistic, carry, discount)
    drive = drive_along(policy, route, how, compute_weight=compute_weight, keeper=keeper)
    while (seen := drive.step()) is not None:
        yield seen


class TraceWriter(Closing):
    """Writes a drive as CSV, a whole line per frame as it comes: what is there stays readable.

    The columns are those of :meth:`amusic_gym.policies.trace.Trace.write_csv`, then the
    milliseconds of the frame without reading its image, of reading it, and of each technique's
    runs. ``correct`` is empty where the ground truth is not known. A file that is there is
    replaced.

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
