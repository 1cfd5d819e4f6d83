"""Progress on a terminal: a bar with rate and time left; elsewhere one line per technique."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """Says how far a long piece of work is."""

    shown: bool = False  # False: say nothing

    @contextlib.contextmanager
    def bar(self, title: str, total: int | None, unit: str) -> Iterator[Callable[[int], object]]:
        """Yield what is to be called with every amount of work that is done; None: of unknown size.

        The bar is on stderr, only where that is a terminal, and vanishes at the end.
        """
        if not (self.shown and total != 0 and sys.stderr.isatty()):
            yield lambda done: None
            return
        from tqdm import tqdm

        with tqdm(desc=title, total=total, unit=f" {unit}", leave=False, dynamic_ncols=True) as bar:
            yield bar.update

    def line(self, text: str) -> None:
        """Print a line that stays."""
        if self.shown:
            print(text, flush=True)
