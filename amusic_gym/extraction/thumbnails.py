"""Small images of a map's places, as JPEG data one after the other."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.blocks import Images
from amusic_gym.techniques.protocol import Image

LONGEST = 320  # pixels of a thumbnail's longer side, at most
_QUALITY = 85


class Thumbnails:
    """Images of R places, decoded when they are asked for.

    All their ``data`` (N,) uint8 follow each other; ``ends`` (R,) tells where each ends.
    """

    def __init__(
        self, path: str | os.PathLike[str], data: NDArray[Any], ends: NDArray[Any]
    ) -> None:
        self.path, self.data, self.ends = Path(path), data, ends

    @classmethod
    def of(cls, images: Images, advance: Callable[[int], object]) -> Thumbnails:
        """Of a traverse; ``advance`` is called with the number that was made."""
        import cv2

        encoded: list[NDArray[Any]] = []
        for at in range(len(images)):
            image: Any = images.read(at)
            scale = LONGEST / max(image.shape[:2])
            if scale < 1:
                image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            quality = (cv2.IMWRITE_JPEG_QUALITY, _QUALITY)
            encoded.append(cv2.imencode(".jpg", image, quality)[1].ravel())
            advance(1)
        return cls("", np.concatenate(encoded), np.cumsum([len(each) for each in encoded]))

    def joined(self, other: Thumbnails) -> Thumbnails:
        """These and then the others."""
        data = np.concatenate([self.data, other.data])
        return Thumbnails(self.path, data, np.concatenate([self.ends, other.ends + len(self.data)]))

    def __len__(self) -> int:
        return len(self.ends)

    def __getitem__(self, index: int) -> Image:
        """(height, width, 3) uint8, blue-green-red.

        Raises:
            IndexError: beyond the last.
            ValueError: for one that is damaged.
        """
        import cv2

        at = range(len(self))[index]
        begin = int(self.ends[at - 1]) if at else 0
        image = cv2.imdecode(self.data[begin : self.ends[at]], cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError(f"{self.path}: the thumbnail of place {at} is damaged")
        return np.asarray(image, np.uint8)
