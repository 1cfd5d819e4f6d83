"""Objects that are closed at the end of a ``with`` block."""

from typing import Self


class Closing:
    """A context that ends with :meth:`close`."""

    def close(self) -> None:
        """End what was started."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
