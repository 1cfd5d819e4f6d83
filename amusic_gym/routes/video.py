"""Frames from video files and cameras, and videos written whole."""

import math
import os
import time
import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.routes.images import MAX_PIXELS
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils import storage
from amusic_gym.utils.checks import whole
from amusic_gym.utils.closing import Closing
from amusic_gym.utils.names import suggest

CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
"""Suffix of a video to write → its codec; both are in every build of OpenCV."""

HIGHEST_CAMERA = 2**31 - 1  # OpenCV takes no larger number
TRIES = 5  # failures in a row after which a camera, or a video with all its frames, is at its end
_MOST_TRIES = 10_000  # of a video that announces more frames
_PAUSE = 0.02  # seconds between two tries of a camera
_JITTER = 1e-3  # seconds by which a frame may come before its time
_SNIFFED = 256
_PLAYLISTS = (b"ffconcat", b"#EXTM3U", b"<?xml", b"<MPD", b"v=0", b"[playlist]")


class VideoFile:
    """Frame source of a video file; its frames are read forwards.

    What a file says of its number of frames is often wrong. So one frame is decoded ahead, and
    ``length`` is None until the last one is known as such. Frames that cannot be decoded are passed
    over, and a `UserWarning` at the end counts them and those that the file announces but lacks.

    Args:
        path: the file.
        every: take each ``every``-th frame, from the first on.
        fps: take so many frames per second of the video, by their time stamps; None: all.

    Attributes:
        name: the file's name without its suffix.
        length: number of frames that are taken, None while it is not known.
        number: of the last frame that was read, among all in the file; -1 before the first.
        seconds: since the file's begin, of that frame's time stamp.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for a folder, a playlist, frames of too many pixels, and for a file without a
            frame that OpenCV can read; for a thinning that is none.
    """

    random_access = False

    def __init__(
        self, path: str | os.PathLike[str], *, every: int = 1, fps: float | None = None
    ) -> None:
        self.path = Path(path)
        self.name = self.path.stem
        self.every = whole("every", every, 1)
        if fps is not None and not 0 < fps < math.inf:
            raise ValueError(f"fps is {fps!r}; give frames per second above 0, or None for all")
        self.fps = fps
        self.length: int | None = None
        self._capture: Any = None
        self._lost = 0
        self._ahead: tuple[Image, int, float] | None = None  # image, number and seconds
        self._next = 0  # how many frames were read
        self.number, self.seconds = -1, 0.0
        self.rewind()

    def rewind(self) -> None:
        """Open the file anew; frame 0 is next.

        Raises:
            FileNotFoundError: where the file has gone.
            ValueError: where it cannot be read any more.
        """
        import cv2

        if not self.path.exists():
            raise FileNotFoundError(f"{self.path} does not exist; check the name")
        if self.path.is_dir():
            raise ValueError(f"{self.path} is a folder; give a video file")
        _refuse_playlists(self.path)
        self.close()
        self._capture = _opened(os.fspath(self.path))
        width, height, announced = (
            int(self._capture.get(what))
            for what in (
                cv2.CAP_PROP_FRAME_WIDTH,
                cv2.CAP_PROP_FRAME_HEIGHT,
                cv2.CAP_PROP_FRAME_COUNT,
            )
        )
        if width * height > MAX_PIXELS:
            raise ValueError(
                f"{self.path} has frames of {width} x {height} pixels, more than the limit of "
                f"{MAX_PIXELS}; make them smaller"
            )
        self._announced = announced if announced > 0 else 0
        self._seen = self._lost = self._next = 0
        self._due = 0.0  # number, or time, of the next frame that is taken
        self._ahead = self._take()
        if self._ahead is None:
            what = "holds no frame that OpenCV can read" if self.path.stat().st_size else "is empty"
            raise ValueError(f"{self.path} {what}; give a video such as .mp4 or .avi")

    def read(self, frame: int) -> Image | None:
        """A frame that has not gone by since the last :meth:`rewind`; None after the last."""
        if frame < self._next:
            raise ValueError(
                f"video {self.path}: frame {frame} has gone by, a video is read forwards; rewind()"
            )
        image = None
        while self._ahead is not None and self._next <= frame:
            (image, self.number, self.seconds), self._ahead = self._ahead, self._take()
            self._next += 1
            if self._ahead is None:
                self.length = self._next
                self._lost += max(0, self._announced - self._seen)
                self._tell()
        return image if self._next == frame + 1 else None

    def _take(self) -> tuple[Image, int, float] | None:
        """The next frame that is due, its number and seconds; None after the last."""
        tries = 0
        while tries < min(max(self._announced - self._seen, TRIES), _MOST_TRIES):
            if not self._capture.grab():
                tries += 1
                continue
            self._lost += tries  # they were not the end
            number = self._seen + tries
            self._seen, tries = number + 1, 0
            at = self._seconds_of(number)
            if self._is_due(number, at):
                found, image = self._capture.retrieve()
                if found:
                    return as_colour(image), number, at
                self._lost += 1
        return None

    def _seconds_of(self, number: int) -> float:
        """Time stamp of the frame that was just grabbed; of a file without, by its frame rate."""
        import cv2

        at = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
        if at <= 0 and number:
            at = number / max(float(self._capture.get(cv2.CAP_PROP_FPS)), 1e-3)
        return at

    def _is_due(self, number: int, at: float) -> bool:
        """Whether the frame of that number and time is taken."""
        if self.fps is None:
            return number % self.every == 0
        turn = math.floor((at + _JITTER) * self.fps)
        due = turn >= self._due
        self._due = turn + 1 if due else self._due
        return due

    def _tell(self) -> None:
        if self._lost:
            warnings.warn(
                f"{self.path}: {self._lost} of {self._seen + max(0, self._announced - self._seen)}"
                " frames are missing or cannot be decoded, and were passed over; the robot seems to"
                " jump there: copy or convert the video again",
                UserWarning,
                stacklevel=3,
            )
            self._lost = 0

    def close(self) -> None:
        """Let go of the file; twice is fine."""
        if self._capture is not None:
            self._capture.release()
        self._tell()


def _refuse_playlists(path: Path) -> None:
    """Refuse a list of other files, which FFmpeg would read in its place."""
    if not path.is_file():
        raise ValueError(f"{path} is a device or a pipe; give a video file")
    with path.open("rb") as file:
        begin = file.read(_SNIFFED).lstrip(b"\xef\xbb\xbf \t\r\n")
    if begin.startswith(_PLAYLISTS):
        raise ValueError(f"{path} is a playlist; give the video itself")


class Camera:
    """Frame source of a camera, by its number from 0: a frame is what it sees when it is asked.

    Raises:
        ValueError: for a number that no camera can have.
        OSError: where there is no such camera, or it gives no picture.
    """

    random_access = False
    length: int | None = None  # nobody knows

    def __init__(self, number: int) -> None:
        import cv2

        self.number = whole("camera", number, 0)
        if self.number > HIGHEST_CAMERA:
            raise ValueError(f"camera is {number}; camera numbers are 0, 1, …")
        self.name = f"camera {self.number}"
        self._capture = _opened(self.number)
        if self.read(0) is None:
            raise OSError(f"{self.name} gives no picture; check that it is there and free")
        # The newest picture, not those that waited while a technique ran; not all cameras can.
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def rewind(self) -> None:
        """Nothing to do: the next frame is the next that the camera sees."""

    def read(self, frame: int) -> Image | None:
        """What the camera sees now, whatever the number; None when it has stopped.

        A failure is no end: it is tried again, and a `UserWarning` tells of it.
        """
        for tries in range(TRIES):
            found, image = self._capture.read()
            if found:
                if tries:
                    warnings.warn(
                        f"{self.name} gave no picture {tries} times and then went on", stacklevel=2
                    )
                return as_colour(image)
            time.sleep(_PAUSE)
        return None

    def close(self) -> None:
        """Let go of the camera; twice is fine."""
        self._capture.release()


def _opened(what: str | int) -> Any:
    """OpenCV's capture of a file or a camera."""
    import cv2

    with Quiet():
        return cv2.VideoCapture(what)


def as_colour(image: Any) -> Image:
    """A picture of a capture, (H, W, 3) uint8 BGR."""
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(image, np.uint8)


class Quiet:
    """Keeps OpenCV from writing its own lines on stderr: the refusal says what is wrong."""

    def __enter__(self) -> None:
        import cv2.utils.logging as log

        self._level = log.getLogLevel()
        log.setLogLevel(log.LOG_LEVEL_SILENT)
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when FFmpeg is first used

    def __exit__(self, *_: object) -> None:
        import cv2.utils.logging as log

        log.setLogLevel(self._level)


class VideoWriter(Closing):
    """Writes pictures to a video, under a temporary name until it is closed.

    Use it as a context manager: leaving the block finishes the file, also by Ctrl-C or an error,
    so that the pictures so far can be looked at. Without a picture there is no file.

    Args:
        path: the file; its suffix chooses the codec.
        fps: pictures per second.

    Raises:
        ValueError: for a suffix that is not in ``CODECS``.
    """

    def __init__(self, path: str | os.PathLike[str], fps: float) -> None:
        self.path = Path(path)
        suffix = self.path.suffix.lower()
        if suffix not in CODECS:
            raise ValueError(f"{self.path}: {suggest('kind of video', self.path.suffix, CODECS)}")
        if self.path.is_dir():
            raise ValueError(f"{self.path} is a folder; give a file")
        self.fps = fps
        self._file = ExitStack()
        self._writer: Any = None
        self._size = (0, 0)
        self._written = 0

    def write(self, picture: Image) -> None:
        """Add a picture, (height, width, 3) uint8 red-green-blue; all of one size.

        Raises:
            OSError: where the video cannot be written.
            ValueError: for a picture of another size.
        """
        import cv2

        size = picture.shape[1], picture.shape[0]
        if self._writer is None:
            self._writer, self._size = self._open(size), size
        if size != self._size:
            raise ValueError(f"a picture of {size} in a video of {self._size}; keep one size")
        self._writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        self._written += 1

    def _open(self, size: tuple[int, int]) -> Any:
        import cv2

        folder = self.path.parent
        folder.mkdir(parents=True, exist_ok=True)
        storage.sweep(folder)
        # Short and plain whatever the name: some backends take no other.
        unfinished = storage.unfinished(folder, self.path.suffix.lower())
        self._temporary = self._file.enter_context(unfinished)
        code = cv2.VideoWriter.fourcc(*CODECS[self.path.suffix.lower()])
        with Quiet():
            writer = cv2.VideoWriter(os.fspath(self._temporary), code, self.fps, size)
        if not writer.isOpened():
            self._file.close()
            raise OSError(f"{self.path} cannot be written; choose another folder, or .avi")
        return writer

    def close(self) -> None:
        """Finish the file and give it its name; twice is fine.

        Raises:
            OSError: where not all pictures can be read back, for example because the disk is full;
                a file that was there before is as it was.
        """
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        with self._file:
            if not self._written:
                return
            if not self._is_whole():
                raise OSError(
                    f"{self.path} cannot be written whole; nothing was changed there: free some"
                    " space or choose another folder"
                )
            os.replace(self._temporary, self.path)

    def _is_whole(self) -> bool:
        """Whether the last picture can be read back; OpenCV does not tell of a full disk."""
        import cv2

        capture = _opened(os.fspath(self._temporary))
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        capture.set(cv2.CAP_PROP_POS_FRAMES, self._written - 1)
        found = capture.read()[0]
        capture.release()
        return bool(found and count >= self._written)  # one more where a signal came between
