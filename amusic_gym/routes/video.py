"""Frames from video files and cameras, and videos written whole."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from amusic_gym import storage
from amusic_gym.checks import whole
from amusic_gym.names import suggest
from amusic_gym.techniques.protocol import Image

CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
"""Suffix of a video to write → its codec; both are in every build of OpenCV."""

HIGHEST_CAMERA = 2**31 - 1
"""OpenCV takes no larger number."""


class VideoFile:
    """Frame source of a video file; its frames are read forwards.

    What a file says of its number of frames is often wrong. So one frame is decoded ahead, and
    ``length`` is None until the last one is known as such.

    Args:
        path: the file.

    Attributes:
        path: the file.
        name: the file's name without its suffix.
        length: number of frames, None while it is not known.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: for a folder, and for a file without a frame that OpenCV can read.
    """

    random_access = False

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.name = self.path.stem
        self.length: int | None = None
        self._capture: Any = None
        self._ahead: Image | None = None
        self._next = 0  # number of the frame ahead
        self.rewind()

    def rewind(self) -> None:
        """Open the file anew; frame 0 is next.

        Raises:
            FileNotFoundError: where the file has gone.
            ValueError: where it cannot be read any more.
        """
        if not self.path.exists():
            raise FileNotFoundError(f"{self.path} does not exist; check the name")
        if self.path.is_dir():
            raise ValueError(f"{self.path} is a folder; give a video file")
        self.close()
        self._capture, self._ahead = _opened(os.fspath(self.path))
        self._next = 0
        if self._ahead is None:
            what = "holds no frame that OpenCV can read" if self.path.stat().st_size else "is empty"
            raise ValueError(f"{self.path} {what}; give a video such as .mp4 or .avi")

    def read(self, frame: int) -> Image | None:
        """A frame that was not read since the last :meth:`rewind`; None after the last.

        Raises:
            ValueError: for a frame that has gone by.
        """
        if frame < self._next:
            raise ValueError(
                f"video {self.path}: frame {frame} has gone by, a video is read forwards; rewind()"
            )
        image = None
        while self._ahead is not None and self._next <= frame:
            image, self._ahead = self._ahead, _grab(self._capture)
            self._next += 1
            if self._ahead is None:
                self.length = self._next
        return image if self._next == frame + 1 else None

    def close(self) -> None:
        """Let go of the file; twice is fine."""
        if self._capture is not None:
            self._capture.release()


class Camera:
    """Frame source of a camera: a frame is what it sees at the moment of asking.

    Args:
        number: of the camera, from 0.

    Attributes:
        number: of the camera.
        name: ``"camera 0"`` and so on.
        length: None; nobody knows.

    Raises:
        ValueError: for a number that no camera can have.
        OSError: where there is no such camera, or it gives no picture.
    """

    random_access = False
    length: int | None = None

    def __init__(self, number: int) -> None:
        import cv2

        self.number = whole("camera", number, 0)
        if self.number > HIGHEST_CAMERA:
            raise ValueError(f"camera is {number}; camera numbers are 0, 1, …")
        self.name = f"camera {self.number}"
        self._capture, first = _opened(self.number)
        if first is None:
            raise OSError(f"{self.name} gives no picture; check that it is there and free")
        # The newest picture, not those that waited while a technique ran; not all cameras can.
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def rewind(self) -> None:
        """Nothing to do: the next frame is the next that the camera sees."""

    def read(self, frame: int) -> Image | None:
        """What the camera sees now, whatever the number; None when it has stopped."""
        return _grab(self._capture)

    def close(self) -> None:
        """Let go of the camera; twice is fine."""
        self._capture.release()


def _opened(what: str | int) -> tuple[Any, Image | None]:
    """OpenCV's capture of a file or a camera, and its first frame; None where there is none."""
    import cv2

    with _Quiet():
        capture = cv2.VideoCapture(what)
        return capture, _grab(capture)


def _grab(capture: Any) -> Image | None:
    """The next frame, (H, W, 3) uint8 BGR; None after the last."""
    found, image = capture.read()
    if not found:
        return None
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(image, np.uint8)


class _Quiet:
    """Keeps OpenCV from writing its own lines on stderr: the refusal says what is wrong."""

    def __enter__(self) -> None:
        import cv2.utils.logging as log

        self._level = log.getLogLevel()
        log.setLogLevel(log.LOG_LEVEL_SILENT)
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when FFmpeg is first used

    def __exit__(self, *_: object) -> None:
        import cv2.utils.logging as log

        log.setLogLevel(self._level)


class VideoWriter:
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

    def _open(self, size: tuple[int, int]) -> Any:
        import cv2

        folder = self.path.parent
        folder.mkdir(parents=True, exist_ok=True)
        storage.sweep(folder)
        # Short and plain whatever the name: some backends take no other.
        unfinished = storage.unfinished(folder, self.path.suffix.lower())
        self._temporary = self._file.enter_context(unfinished)
        code = cv2.VideoWriter.fourcc(*CODECS[self.path.suffix.lower()])
        with _Quiet():
            writer = cv2.VideoWriter(os.fspath(self._temporary), code, self.fps, size)
        if not writer.isOpened():
            self._file.close()
            raise OSError(f"{self.path} cannot be written; choose another folder, or .avi")
        return writer

    def close(self) -> None:
        """Finish the file and give it its name; twice is fine."""
        if self._writer is not None:
            self._writer.release()
            self._writer = None
            with self._file:
                os.replace(self._temporary, self.path)

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        self.close()
