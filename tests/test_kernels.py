"""Records and tables that compiled functions read by name, which reach into Numba."""

from __future__ import annotations

import ast
import copy
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

import amusic_gym
from amusic_gym.kernels import compiling
from amusic_gym.kernels.tables import Record, Table, array, part, reader, view


@contextmanager
def uses_of(file: str) -> Iterator[None]:
    """Says what to mend where a release of Numba has changed what a file uses of it."""
    try:
        yield
    except Exception as error:
        pytest.fail(
            f"Numba {numba.__version__} changed what amusic_gym/kernels/{file} uses of it"
            f" ({error}); mend that file, or allow only older releases in pyproject.toml"
        )


class Entry(Record):
    count: int
    share: float
    on: bool
    several: Annotated[Any, np.int64, 3]


class Inner(Table):
    factor: float
    values: NDArray[np.float64] = array(np.float64, "routes", "places")
    scratch: NDArray[np.float64] = array(np.float64, "places", kept=False)


class Outer(Table):
    inner: Inner
    number: int
    flag: bool
    entries: NDArray[Any] = array(Entry, "routes")
    weights: NDArray[np.float64] = array(np.float64, "places")


outer_at: Any = reader(Outer)
SIZES = {"routes": 2, "places": 3}


@compiling.compiled
def read_and_write(address: int) -> float:
    outer = outer_at(address)
    entry = outer.entries[1]
    entry.count, entry.share, entry.on, entry.several[2] = 7, 0.5, True, 9
    outer.inner.values[1, 2] = outer.number * outer.inner.factor
    return 100.0 if outer.flag else outer.inner.values[0, 0]


def made(**given: Any) -> Outer:
    inner = Inner(SIZES, factor=2.5)
    inner.values[0, 0] = 3.0
    return Outer(SIZES, inner=inner, number=4, flag=False, **given)


def test_kernels_read_and_write_numbers_arrays_and_records_of_a_table_by_name():
    outer = made()
    with uses_of("tables.py"):
        words = outer.write()
        assert read_and_write(words.ctypes.data) == 3.0
    assert outer.entries["several"][1].tolist() == [0, 0, 9]
    assert (outer.entries["count"][1], outer.entries["share"][1]) == (7, 0.5)
    assert outer.inner.values[1, 2] == 10.0
    assert not outer.entries[0]["on"]
    outer.flag = True
    words = outer.write()
    assert read_and_write(words.ctypes.data) == 100.0


def test_a_record_lists_its_fields_once():
    assert Entry.dtype.names == ("count", "share", "on", "several")
    kinds = [Entry.dtype[name] for name in Entry.dtype.names]
    assert kinds == [np.int64, np.float64, np.bool_, np.dtype((np.int64, 3))]
    assert Entry.dtype.isalignedstruct


def test_a_table_is_allocated_as_it_lists_its_arrays():
    outer = made(weights=np.arange(3.0))
    assert outer.entries.shape == (2,)
    assert outer.inner.values.shape == (2, 3)
    assert outer.weights.tolist() == [0.0, 1.0, 2.0]


def test_a_grown_table_keeps_what_is_to_be_kept():
    inner = Inner(SIZES, factor=2.5)
    inner.values[:] = np.arange(6).reshape(2, 3)
    inner.scratch[:] = 1.0
    grown = inner.grown({"routes": 2, "places": 5})
    assert grown.values.tolist() == [[0, 1, 2, 0, 0], [3, 4, 5, 0, 0]]
    assert not grown.scratch.any()
    assert grown.factor == 2.5
    assert inner.values.shape == (2, 3)


def test_in_a_repeated_table_every_route_stands_several_times():
    outer = made(weights=np.arange(3.0))
    outer.entries["count"] = [5, 6]
    twin = outer.repeated(2, inner=outer.inner.repeated(2))
    assert twin.entries["count"].tolist() == [5, 5, 6, 6]
    assert twin.weights.tolist() == [0.0, 1.0, 2.0]
    assert twin.inner.values[:, 0].tolist() == [3.0, 3.0, 0.0, 0.0]
    twin.entries["count"] = 0
    assert outer.entries["count"].tolist() == [5, 6]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda t: pickle.loads(pickle.dumps(t))])
def test_copies_share_nothing(copied):
    outer = made()
    twin = copied(outer)
    words = twin.write()
    read_and_write(words.ctypes.data)
    assert twin.entries["count"][1] == 7
    assert outer.entries["count"][1] == 0
    assert not outer.inner.values[1].any()


def test_an_array_of_another_kind_than_listed_is_refused():
    outer = made(weights=np.arange(3))
    with pytest.raises(AssertionError):
        outer.write()
    outer = made(weights=np.arange(6.0)[::2])
    with pytest.raises(AssertionError):
        outer.write()


@compiling.compiled
def sum_at(address: int, size: int) -> float:
    total = 0.0
    for value in view(address, size, np.float64):
        total += value
    return total


def test_a_view_is_of_memory_at_an_address():
    numbers = np.array([1.0, 2.0, 4.0, 8.0])
    with uses_of("tables.py"):
        assert sum_at(numbers.ctypes.data, 3) == 7.0
        assert sum_at(numbers[1:].ctypes.data, 2) == 6.0


@compiling.compiled
def double_part(values: NDArray[np.float64], start: int, size: int) -> None:
    some = part(values, start, size)
    for i in range(some.size):
        some[i] *= 2.0


def test_a_part_is_a_slice():
    values = np.arange(5.0)
    with uses_of("tables.py"):
        double_part(values, 1, 3)
    assert values.tolist() == [0.0, 2.0, 4.0, 6.0, 4.0]


@compiling.apart
def half(x: int) -> float:
    return x / 2


@compiling.inner
def third(x: int) -> float:
    return x / 3


@numba.njit  # not cached: else nothing is compiled the second time
def constants(x: int) -> float:
    return half(8) + half(x) + third(9) + third(x)


def test_functions_inside_are_compiled_once_whatever_constants_they_get():
    with uses_of("compiling.py"):
        assert constants(6) == 4.0 + 3.0 + 3.0 + 2.0
    assert len(half.overloads) == len(third.overloads) == 1


def test_functions_that_sum_in_any_order_write_to_no_array():
    """Else the order would depend on where arrays lie in memory: see `summing`."""
    found = 0
    for file in Path(amusic_gym.__file__).parent.rglob("*.py"):
        for function in ast.walk(ast.parse(file.read_text("utf-8"))):
            decorators = getattr(function, "decorator_list", [])
            if "summing" in [ast.unparse(each) for each in decorators]:
                found += 1
                writes = [
                    ast.unparse(node)
                    for node in ast.walk(function)
                    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store)
                ]
                assert not writes, f"{file}: {function.name} writes {writes}"
    assert found
