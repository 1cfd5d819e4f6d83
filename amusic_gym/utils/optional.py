"""Packages that only optional parts need, but for those of techniques.

What a technique imports must stand in its file as an import: it is part of the key of the cache.
"""

import importlib
from typing import Any


def optional(module: str, whose: str, package: str, part: str) -> Any:
    """A module of a package that may not be installed.

    The refusal, a ValueError, says ``whose`` need it is, what the ``package`` is called, and the
    command that installs the ``part`` of this package with it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ValueError(
            f'{whose} needs {package}; install it: pip install "amusic-gym[{part}]"'
        ) from None
