"""Drives in Rerun: camera, place, p̂, runs and milliseconds on one timeline."""

import os
from typing import Any

import numpy as np

from amusic_gym.live.drives import FrameResult
from amusic_gym.utils.closing import Closing
from amusic_gym.utils.optional import optional

PATIENCE = 3.0  # seconds within which a viewer must answer
QUALITY = 75  # of the camera's pictures, JPEG


class Recording(Closing):
    """Writes a drive to Rerun, frame by frame. Use it as a context manager.

    Args:
        target: the file, or ``"connect"`` for a viewer that runs on this machine.

    Raises:
        ValueError: where Rerun is not installed, or no viewer runs.
        OSError: where the file cannot be written.
    """

    def __init__(self, target: str) -> None:
        self._rerun = optional("rerun", "--rerun", "the package rerun-sdk", "rerun")
        self._stream = self._rerun.RecordingStream("amusic-gym drive")
        if target == "connect":
            self._stream.connect_grpc()
            self._stream.log("match", self._rerun.TextLog("a drive begins"))
            try:
                self._stream.flush(timeout_sec=PATIENCE)
            except RuntimeError as error:
                self._stream.disconnect()
                raise ValueError(f"no viewer of Rerun: {error}; start one: rerun") from None
        else:
            self._stream.save(os.fspath(target))

    def write(self, seen: FrameResult, answer: dict[str, Any]) -> None:
        """Log a frame and its answer (`amusic_gym.live.answers.Answers.of`)."""
        rerun, log = self._rerun, self._stream.log
        self._stream.set_time("frame", sequence=seen.frame)
        picture = rerun.Image(np.ascontiguousarray(seen.image), rerun.ColorModel.BGR)
        log("camera", picture.compress(QUALITY))
        place = (
            "unknown" if answer["place"] is None or answer["known"] is False else answer["place"]
        )
        log("place", rerun.TextLog(f"{place} {answer['name'] or ''}".strip()))
        for name in ("place", "p_correct", "milliseconds", "read_milliseconds", "compute_weight"):
            if answer[name] is not None:
                log(f"drive/{name}", rerun.Scalars(float(answer[name])))
        for t, name in enumerate(seen.techniques):
            log(f"ran/{name}", rerun.Scalars(float(seen.ran[t])))
            log(f"milliseconds/{name}", rerun.Scalars(float(seen.run_milliseconds[t])))

    def close(self) -> None:
        """Write what waits."""
        self._stream.flush()
        self._stream.disconnect()
