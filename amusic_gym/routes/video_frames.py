"""Videos as traverses: the frames that are taken, as files that can be read in any order."""

import math
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.positions import Positions
from amusic_gym.routes.tracks import Track
from amusic_gym.routes.video import VideoFile
from amusic_gym.utils import storage


@contextmanager
def frames_of(
    path: str | os.PathLike[str],
    *,
    every: int = 1,
    fps: float | None = None,
    track: Track | None = None,
    metres: float | None = None,
    advance: Callable[[int], object] = lambda done: None,
) -> Iterator[tuple[ImageFolder, Positions | None]]:
    """Yield a video's frames as a folder of PNG files, and where each was taken.

    The folder is in the temporary one of the system (``TMPDIR``) and gone at the end; what is
    computed of its images is found in the cache again, as they have the same bytes.

    Args:
        path: the video.
        every: see `VideoFile`.
        fps: likewise.
        track: positions by frame or time; None: not known.
        metres: take the first frame, and each next one at least so far from the last.
        advance: called with the number of frames written since the last call.

    Raises:
        FileNotFoundError: for a video that is not there.
        ValueError: for one without a frame, or without a position where ``metres`` needs one.
        OSError: where frames cannot be written.
    """
    import cv2

    if metres is not None and track is None:
        raise ValueError(f"{path}: to take a frame every {metres} metres, give its positions")
    if metres is not None and not 0 < metres < math.inf:
        raise ValueError(f"--every-metres is {metres!r}; give a distance above 0")
    video = VideoFile(path, every=every, fps=fps)
    above = Path(tempfile.gettempdir())
    storage.sweep(above)
    with storage.unfinished(above, make=Path.mkdir) as temporary:
        folder = temporary / video.name
        folder.mkdir()
        stamps: list[tuple[int, float]] = []
        last, seen = None, 0
        try:
            while (image := video.read(seen)) is not None:
                seen += 1
                if track is not None and metres is not None:
                    at = track.of_frames([video.number], [video.seconds], os.fspath(path)).metres[0]
                    if last is not None and np.linalg.norm(at - last) < metres:
                        continue
                    last = at
                _write(folder / f"{len(stamps):06}.png", cv2.imencode(".png", image, _QUICK)[1])
                stamps.append((video.number, video.seconds))
                advance(1)
        finally:
            video.close()
        positions = None
        if track is not None:
            numbers, seconds = zip(*stamps, strict=True)
            positions = track.of_frames(numbers, seconds, os.fspath(path))
        yield ImageFolder(folder), positions


_QUICK = (16, 1)  # cv2.IMWRITE_PNG_COMPRESSION: lossless at any level


def _write(path: Path, content: np.ndarray) -> None:
    try:
        path.write_bytes(content.tobytes())
    except OSError as error:
        raise OSError(
            error.errno,
            f"frames of a video cannot be written to {path.parent} ({error.strerror}); free some"
            " space, or set TMPDIR to another folder",
        ) from error
