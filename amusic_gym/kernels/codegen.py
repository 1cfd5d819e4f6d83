"""Types of what Numba hands to functions that emit code, for their annotations."""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core.base import BaseContext as Context
from numba.core.typing.context import BaseContext as Typing
from numba.core.typing.templates import Signature

__all__ = ["Builder", "Context", "Signature", "Typing", "Values"]

Builder = ir.IRBuilder
Values = Sequence[ir.Value]
