"""Frames from a camera on the network, which is opened anew whenever it stops."""

import threading
import time
import warnings
from typing import Any
from urllib.parse import urlsplit

from amusic_gym.routes.video import Quiet, as_colour
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils.names import suggest

SCHEMES = ("http", "https", "rtsp", "rtsps")  # begins of addresses that are a camera's
SILENT = 2.0  # seconds without a picture after which that is told
PATIENCE = 300.0  # seconds without a picture after which a drive ends
PAUSE = 0.5  # seconds between two tries to open it
TIMEOUT = 5.0  # seconds that opening and reading may block


class NetworkCamera:
    """Frame source of a camera's address: a frame is the newest picture since the last one.

    A thread of its own reads, so that pictures do not wait while a technique runs, and opens the
    address anew when it gives none. The address is of a stream that FFmpeg reads: MJPEG over HTTP,
    or RTSP.

    Raises:
        ValueError: for an address of another kind.
        OSError: where it gives no picture at first.
    """

    random_access = False
    length: int | None = None  # nobody knows

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in SCHEMES:
            raise ValueError(suggest("kind of address", parts.scheme, SCHEMES))
        self.name = f"{parts.hostname}{parts.path}"  # a password in the address is told nobody
        self._url = url
        self._image: Image | None = None
        self._changed = threading.Condition()
        self._closed = False
        capture = self._opened()
        if not capture.isOpened():
            raise OSError(f"camera {self.name} gives no picture; check address and camera")
        self._thread = threading.Thread(target=self._watch, args=(capture,), daemon=True)
        self._thread.start()

    def _opened(self) -> Any:
        import cv2

        times = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, cv2.CAP_PROP_READ_TIMEOUT_MSEC)
        limits = [word for name in times for word in (name, int(1000 * TIMEOUT))]
        with Quiet():
            return cv2.VideoCapture(self._url, cv2.CAP_FFMPEG, limits)

    def _watch(self, capture: Any) -> None:
        """Keep the newest picture until the camera is closed."""
        while not self._closed:
            found, image = capture.read()
            if found:
                with self._changed:
                    self._image = as_colour(image)
                    self._changed.notify()
            else:
                capture.release()
                time.sleep(PAUSE)
                capture = self._opened()
        capture.release()

    def rewind(self) -> None:
        """Nothing to do: the next frame is the next that the camera sees."""

    def read(self, frame: int) -> Image | None:
        """The newest picture, whatever the number; None when there was none for `PATIENCE`.

        A silence is no end; a `UserWarning` tells of it.
        """
        with self._changed:
            if not self._changed.wait_for(self._is_there, SILENT):
                warnings.warn(
                    f"camera {self.name} gives no picture; it is opened anew for {PATIENCE:g} s",
                    stacklevel=2,
                )
                self._changed.wait_for(self._is_there, PATIENCE)
            image, self._image = self._image, None
        return image

    def _is_there(self) -> bool:
        return self._image is not None

    def close(self) -> None:
        """Let go of the camera; twice is fine."""
        self._closed = True
        self._thread.join(2 * TIMEOUT)
