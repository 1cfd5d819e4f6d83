"""Frame sources: where the images of a query come from."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Protocol, runtime_checkable

from amusic_gym.techniques.protocol import Image


@runtime_checkable
class FrameSource(Protocol):
    """Where the images of a query come from: a folder, a video, a camera.

    Attributes:
        name: what to call the route.
        length: number of frames; None while it is not known. A video that decodes one frame ahead
            sets it when it comes to the last one, and the episode ends there. Where it stays None,
            the episode ends with a step of its own, on which nothing is processed.
        random_access: whether any frame may be read at any time, by several readers and by a
            reader in another process. If not, frames are read in rising order after a
            :meth:`rewind`, each once, and only one route of one environment may drive the source.
    """

    @property
    def name(self) -> str:
        """What to call the route."""
        ...

    @property
    def length(self) -> int | None:
        """Number of frames, None while it is not known."""
        ...

    @property
    def random_access(self) -> bool:
        """Whether frames may be read in any order and by several readers."""
        ...

    def read(self, frame: int) -> Image | None:
        """Image of a frame, which the source does not change afterwards; None after the last.

        Raises:
            ValueError: for an image that cannot be read, naming it.
            FileNotFoundError: for one that is gone.
        """
        ...

    def rewind(self) -> None:
        """Begin anew: the next frame asked for counts from the start (a camera's: from now)."""
        ...


@runtime_checkable
class Indexed(Protocol):
    """Images with a number each: an image folder, or a list of arrays."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def __getitem__(self, index: int, /) -> Image:
        """Image of a number from 0."""
        ...


class ImageSequence:
    """Frame source of images that can be read in any order.

    Args:
        images: an image folder, or a list of images.
        name: what to call the route.

    Raises:
        ValueError: for no image at all.
    """

    random_access = True

    def __init__(self, images: Indexed, name: str = "images") -> None:
        if len(images) == 0:
            raise ValueError(f"{name}: no image; a route has at least one frame")
        self.images = images
        self.name = name
        self.length: int | None = len(images)

    def read(self, frame: int) -> Image | None:
        """Image of a frame; None after the last."""
        return self.images[frame] if frame < len(self.images) else None

    def rewind(self) -> None:
        """Nothing to do."""


class ImageStream:
    """Frame source of images that come one after the other: an iterator, a generator.

    Args:
        images: gives each image once.
        name: what to call the route.
    """

    random_access = False
    length: int | None = None

    def __init__(self, images: Iterable[Image], name: str = "images") -> None:
        self.name = name
        self._images = iter(images)
        self._first: Image | None = None  # kept while it may be read again
        self._next = 0

    def read(self, frame: int) -> Image | None:
        """The next image; None after the last.

        Raises:
            ValueError: for one that has gone by.
        """
        if frame == 0 and self._first is not None:
            return self._first
        if frame < self._next:
            raise ValueError(f"{self.name}: frame {frame} has gone by, an iterator goes forwards")
        image = None
        while self._next <= frame:
            image = next(self._images, None)
            self._next += 1
        self._first = image if frame == 0 else None
        return image

    def rewind(self) -> None:
        """Nothing to do while no more than the first image was read.

        Raises:
            ValueError: later.
        """
        if self._next > 1:
            raise ValueError(f"{self.name}: an iterator gives each image once; make a new one")


def as_frames(
    frames: str | os.PathLike[str] | FrameSource | Indexed | Iterable[Image],
) -> FrameSource:
    """Turn what a user may give as the query's frames into a frame source.

    Raises:
        ValueError: for anything else.
        FileNotFoundError: for a folder that is not there.
    """
    if isinstance(frames, str | os.PathLike):
        from amusic_gym.routes.folders import ImageFolder

        return ImageSequence(ImageFolder(frames), os.path.basename(os.path.abspath(frames)))
    if isinstance(frames, FrameSource):
        return frames
    if isinstance(frames, Indexed):
        folder = getattr(frames, "path", None)
        return ImageSequence(frames, folder.name) if folder else ImageSequence(frames)
    if isinstance(frames, Iterable):
        return ImageStream(frames)
    raise ValueError(f"frames are {frames!r}; give a folder, a FrameSource, or images")
