"""Compiled functions where their machine code cannot be kept."""

from __future__ import annotations

import pytest
from numba.core import caching

from amusic_gym import _compile


def twice(x: float) -> float:
    return 2.0 * x


def test_without_a_place_for_the_cache_functions_work_and_one_warning_names_the_mend(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    _compile._warn_of_no_cache.cache_clear()
    with pytest.warns(UserWarning, match="set NUMBA_CACHE_DIR"):
        first = _compile.compiled(twice)
    second = _compile.standalone()(twice)  # a second warning would be an error
    assert first(3.0) == second(3.0) == 6.0
    _compile._warn_of_no_cache.cache_clear()


def test_where_there_is_one_the_stamp_depends_on_the_sources():
    one, two = _compile.compiled(twice), _compile.standalone("rows.py")(twice)
    stamps = [f._cache._cache_file._source_stamp for f in (one, two)]
    assert stamps[0][0] == stamps[1][0]
    assert stamps[0][1] != stamps[1][1]
