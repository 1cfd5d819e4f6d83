"""A window for pictures, by pygame: an optional part."""

from __future__ import annotations

import importlib.util
import os
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

INSTALL = 'pip install "amusic-gym[human]"'

UNSEEN = ("dummy", "offscreen")
"""Drivers of SDL whose windows nobody sees; it falls back to them where there is no display."""


class Window:
    """Opens with the first picture. The user may close it; later pictures then go nowhere.

    A process has one window: pygame knows no more. Copies and pickles of a ``Window`` open anew.

    Args:
        title: in the window's bar.
        fps: the most pictures per second, by waiting; None: no waiting.

    Raises:
        ImportError: without pygame, with the command that installs it.
    """

    def __init__(self, title: str, fps: float | None = None) -> None:
        if importlib.util.find_spec("pygame") is None:
            raise ImportError(f"the window needs pygame, which is not installed: {INSTALL}")
        self.title = title
        self.fps = fps
        self.closed_by_user = False
        self._surface: Any = None
        self._clock: Any = None

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture, (height, width, 3) uint8 red-green-blue.

        Raises:
            OSError: where no window can be opened, with what to do instead.
        """
        if self.closed_by_user:
            return
        pygame = _pygame()
        size = picture.shape[1], picture.shape[0]
        if self._surface is None or pygame.display.get_surface() is not self._surface:
            self._open(pygame, size)
        image = pygame.image.frombuffer(np.ascontiguousarray(picture), size, "RGB")
        self._surface.blit(image, (0, 0))
        pygame.display.flip()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.closed_by_user = True
            self.close()
        elif self.fps is not None:
            self._clock.tick(self.fps)

    def check(self) -> None:
        """Refuse now what :meth:`show` would refuse with the first picture.

        Raises:
            OSError: where no window can be opened.
        """
        pygame = _pygame()
        if not pygame.display.get_init():
            _begin(pygame)
            pygame.display.quit()

    def _open(self, pygame: Any, size: tuple[int, int]) -> None:
        _begin(pygame)
        try:
            self._surface = pygame.display.set_mode(size)
        except pygame.error as error:
            raise _refusal(str(error)) from error
        pygame.display.set_caption(self.title)
        self._clock = pygame.time.Clock()

    def close(self) -> None:
        """Close the window; twice is fine."""
        if self._surface is None:
            return
        pygame = _pygame()
        if pygame.display.get_init() and pygame.display.get_surface() is self._surface:
            pygame.display.quit()
        self._surface = self._clock = None

    def __getstate__(self) -> dict[str, Any]:
        """All but the handles of the open window."""
        return self.__dict__ | {"_surface": None, "_clock": None}


def _begin(pygame: Any) -> None:
    """Begin with the display, unless nobody would see what is on it and nobody asked for that."""
    try:
        pygame.display.init()
    except pygame.error as error:
        raise _refusal(str(error)) from error
    if pygame.display.get_driver() in UNSEEN and not os.environ.get("SDL_VIDEODRIVER"):
        pygame.display.quit()
        raise _refusal("no display")


def _refusal(why: str) -> OSError:
    return OSError(
        f"no window can be opened here ({why}); ask for pictures without one "
        "(render_mode='rgb_array', amusic navigate --video), or set SDL_VIDEODRIVER=dummy"
    )


def _pygame() -> Any:
    """Pygame, without its greeting and without the warnings of its own imports."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import pygame
    return pygame
