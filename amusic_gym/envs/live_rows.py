"""One drive along a live route: its last images, and the score rows computed so far."""

from __future__ import annotations

import time
import warnings
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.rows import RowBuffer
from amusic_gym.estimation.sic.state import depth_for

if TYPE_CHECKING:
    from amusic_gym.envs.live_route import LiveRoute
    from amusic_gym.estimation.settings import SICSettings
    from amusic_gym.techniques.protocol import Image

ROOM = 64
"""Rows and frames that there is room for at first; it doubles when it is used up."""


class LiveRows:
    """Rows of a live route as the compiled dynamics read them, computed on demand.

    Each technique has a ring of rows. The dynamics come back to a row only to take it out of the
    running sums: for the last F frames that the technique ran on, or R, where the map ends
    sooner. With a block of M frames that may be selected over, they lag M frames behind, and runs
    after the fact are out of order by as many.

    Args:
        route: the route.
        start: the source's frame that is frame 0.
        settings: SIC's.
        block: M, or 0.

    Attributes:
        frame: the running frame, -1 before the first.
        milliseconds: (T,) wall time of each technique's run on the running frame.
        late_milliseconds: (T,) of its after-the-fact runs before that frame.
        read_milliseconds: wall time until the running frame's image was there.
        retry: frames for which a technique that raises is left out, with rows that say nothing,
            as long as others are left; 0: its error ends the step.
        out_until: (T,) frame from which each technique is tried.
    """

    retry = 0

    def __init__(self, route: LiveRoute, start: int, settings: SICSettings, block: int) -> None:
        count = len(route.techniques)
        self.route = route
        self.start = start
        self.frame = -1
        waiting = 2 * depth_for(route.references, settings.gamma)
        self.most = min(settings.history, route.references) + 2 * block + 4 + waiting
        self.buffers = [
            RowBuffer.empty(min(ROOM, self.most), route.references, settings.candidates)
            for _ in range(count)
        ]
        self.reach = route.references + block + 1  # frames that anything comes back to
        self.gone = 0  # frames whose entries were let go
        self.entries: NDArray[np.int64] = np.full((count, ROOM), -1)  # (T, frames since)
        self.counts = [0] * count  # rows computed so far
        self.milliseconds: NDArray[np.float64] = np.zeros(count)
        self.late_milliseconds: NDArray[np.float64] = np.zeros(count)
        self.read_milliseconds = 0.0
        self.out_until: NDArray[np.int64] = np.zeros(count, np.int64)
        self._told: list[int] = []  # techniques whose errors were told
        self.moved = True
        self._images: deque[Image] = deque(maxlen=block + 1)
        self._take_source()

    def _take_source(self) -> None:
        source = self.route.frames
        if not source.random_access:
            self.route.owner.turn += 1
            source.rewind()
        self._turn = self.route.owner.turn

    @property
    def frames(self) -> int | None:
        """Frames of this drive, None while that is not known."""
        length = self.route.frames.length
        return None if length is None else length - self.start

    @property
    def spent(self) -> float:
        """Wall seconds of all runs since the last frame began."""
        return float(self.milliseconds.sum() + self.late_milliseconds.sum()) / 1000.0

    def advance(self, frame: int) -> bool:
        """Read the image of ``frame``, the next one; False where the source has ended.

        Raises:
            ValueError: for an image that cannot be read, a source that ends before its length, or
                one that another route drives now.
            FileNotFoundError: for an image that is gone.
        """
        if frame == self.frame:  # it was read, but another route's image stopped the step
            return True
        source, name = self.route.frames, self.route.name
        if not source.random_access and self._turn != self.route.owner.turn:
            raise ValueError(
                f"live route {name!r} is driven by another environment or route now; only one may"
                " drive a source that cannot be read in any order"
            )
        begin = time.perf_counter()
        image = source.read(self.start + frame)
        if image is None:
            if frame == 0 or self.route.queries is not None:
                wanted = "at least one" if self.route.queries is None else self.route.queries
                raise ValueError(
                    f"live route {name!r} ended after {self.start + frame} frames; its source must"
                    f" give {wanted}"
                )
            return False
        self._images.append(image)
        self.frame = frame
        self.read_milliseconds = 1000.0 * (time.perf_counter() - begin)
        self.milliseconds[:] = 0.0
        self.late_milliseconds[:] = 0.0
        if frame - self.gone >= self.entries.shape[1]:
            self._remember_more()
        return True

    def _remember_more(self) -> None:
        """Make room for entries: let the oldest half go if nothing comes back to it, or double."""
        room = self.entries.shape[1]
        if room >= 2 * self.reach:
            self.entries[:, : room - room // 2] = self.entries[:, room // 2 :]
            self.entries[:, room - room // 2 :] = -1
            self.gone += room // 2
        else:
            self.entries = np.pad(self.entries, ((0, 0), (0, room)), constant_values=-1)
        self.moved = True

    def image(self, frame: int | None = None) -> Image:
        """Image of one of the last M + 1 frames; None: of the running one."""
        return self._images[-1 if frame is None else frame - self.frame - 1]

    def run(self, technique: int, frame: int) -> NDArray[np.float32]:
        """Run a technique on one of the last M + 1 frames, unless it ran there; its row (R,).

        Raises:
            ValueError: see :meth:`LiveRoute.run`.
        """
        entry = int(self.entries[technique, frame - self.gone])
        if entry < 0:
            row, seconds = self._run(technique, frame)
            late = frame < self.frame
            times = self.late_milliseconds if late else self.milliseconds
            times[technique] += 1000.0 * seconds
            entry = self._room(technique)
            self.buffers[technique].put(entry, row)
            self.entries[technique, frame - self.gone] = entry
        stored: NDArray[np.float32] = self.buffers[technique].rows[entry]
        return stored

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(T,) techniques that are not left out on the running frame."""
        usable: NDArray[np.bool_] = self.out_until <= self.frame
        return usable

    def _run(self, technique: int, frame: int) -> tuple[NDArray[np.float32], float]:
        """A technique's row and seconds; a constant row where it raises, or is left out."""
        if self.usable[technique]:
            try:
                return self.route.run(technique, self.image(frame), self.start + frame)
            except Exception as error:
                if not self.retry or self.usable.sum() == 1:
                    raise
                self.out_until[technique] = self.frame + self.retry
                if technique not in self._told:
                    self._told.append(technique)
                    name = self.route.techniques[technique]
                    warnings.warn(
                        f"technique {name!r} is left out, and tried again every {self.retry}"
                        f" frames: {error!r}",
                        stacklevel=2,
                    )
        return np.zeros(self.route.references, np.float32), 0.0

    def _room(self, technique: int) -> int:
        """The next entry of a technique's ring, which grows until it holds what is needed."""
        entry, buffer = self.counts[technique], self.buffers[technique]
        room = len(buffer.rows)
        if entry >= room and room < self.most:
            self.buffers[technique] = buffer.grown(min(2 * room, self.most))
            self.moved = True
        self.counts[technique] += 1
        return entry % self.most

    def point(self, runs: NDArray[Any], columns: NDArray[np.int64]) -> None:
        """Write the addresses to the RUN records (S,) of the techniques ``columns``."""
        for s, technique in enumerate(columns):
            if technique >= 0:
                self.buffers[technique].point(runs[s])
                first = self.entries[technique].ctypes.data
                runs["entries"][s] = first - self.gone * self.entries.itemsize
        self.moved = False

    def __getstate__(self) -> dict[str, Any]:
        """The drive for a copy or a pickle.

        Raises:
            TypeError: where the source can be read once only.
        """
        if not self.route.frames.random_access:
            raise TypeError(
                f"live route {self.route.name!r} cannot be copied while it is driven: its"
                f" {type(self.route.frames).__name__} gives every frame once; use a folder of"
                " images"
            )
        return self.__dict__
