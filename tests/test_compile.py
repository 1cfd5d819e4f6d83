"""Compiled functions: what their cached machine code depends on, and caches that fail."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

import numpy as np
import pytest
from numba.core import caching
from numba.core.dispatcher import Dispatcher

from amusic_gym.envs import episode
from amusic_gym.estimation.belief import filter as belief_filter
from amusic_gym.estimation.sic import look_back, update
from amusic_gym.kernels import compiling as _compile
from amusic_gym.techniques import _cohog_description, _cohog_kernel
from amusic_gym.utils import imports
from amusic_gym.utils.imports import PACKAGE, digest_of, source_files

KERNELS = [
    episode.choose_routes,
    episode.select_routes,
    episode.observe_routes,
    update.update_routes,
    look_back.look_back,
    belief_filter.filter_routes,
    belief_filter.update_routes,
    belief_filter.look_back,
    _cohog_kernel.match_regions,
    _cohog_description.local_entropy,
]


def twice(x: float) -> float:
    return 2.0 * x


def stamp(kernel):
    return kernel._cache._cache_file._source_stamp[1]


def callees(kernel) -> set[Path]:
    """Files of a compiled function and of all compiled ones that it calls."""
    seen, pending = set(), [kernel.py_func]
    for function in pending:
        if function not in seen:
            seen.add(function)
            named = map(function.__globals__.get, function.__code__.co_names)
            pending += [value.py_func for value in named if isinstance(value, Dispatcher)]
    return {Path(function.__code__.co_filename) for function in seen}


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.__name__)
def test_53_a_kernel_is_stale_when_any_file_of_its_code_changes(kernel, tmp_path):
    entry = Path(kernel.py_func.__code__.co_filename)
    files = source_files(entry, lazily=False)
    assert stamp(kernel) == digest_of(*files)
    assert callees(kernel) | {Path(_compile.__file__)} <= set(files)
    package = tmp_path / "amusic_gym"
    for file in files:
        target = package / file.relative_to(PACKAGE)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, target)
    copied = [package / file.relative_to(PACKAGE) for file in files]
    inside = package / entry.relative_to(PACKAGE)
    assert list(source_files(inside, package=package, lazily=False)) == copied
    for file in copied:
        text = file.read_bytes()
        file.write_bytes(text + b"\n")
        assert digest_of(*copied) != stamp(kernel), file
        file.write_bytes(text)
    assert digest_of(*copied) == stamp(kernel)


def test_53_constants_of_the_observation_are_part_of_a_step():
    assert PACKAGE / "envs" / "observation.py" in source_files(Path(episode.__file__), lazily=False)


def test_imports_count_wherever_they_stand_but_for_type_checkers():
    text = b"""
from __future__ import annotations
import numpy as np, a.b
if TYPE_CHECKING:
    import unseen
else:
    import other
try:
    from .near import thing
except ImportError:
    from ..far import thing
def later():
    with x:
        import inside
"""
    found = set(imports.imports_of(text, "top.sub.module", is_package=False))
    assert found == {
        *("__future__", "__future__.annotations", "numpy", "a.b", "other", "inside"),
        *("top.sub.near", "top.sub.near.thing", "top.far", "top.far.thing"),
    }


# ---- where machine code cannot be kept ------------------------------------------------------


@pytest.fixture
def one_warning():
    _compile._warn_of_no_cache.cache_clear()
    with pytest.warns(UserWarning, match="set NUMBA_CACHE_DIR") as said:
        yield
    assert len(said) == 1
    _compile._warn_of_no_cache.cache_clear()


def test_without_a_place_for_the_cache_functions_work_and_one_warning_names_the_mend(
    monkeypatch, one_warning
):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert _compile.compiled(twice)(3.0) == _compile.without_gil(twice)(3.0) == 6.0


@pytest.mark.parametrize("fails", ["_save_index", "_save_data"])
def test_27_on_a_full_disk_functions_work_and_one_warning_names_the_mend(
    fails, monkeypatch, tmp_path, one_warning
):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(caching.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(caching.IndexDataCacheFile, fails, full)
    assert _compile.compiled(twice)(3.0) == _compile.compiled(twice)(3.0) == 6.0


@pytest.mark.parametrize("end", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", ["empty", "cut short", "garbage"])
def test_23_a_damaged_file_of_compiled_code_is_made_anew(end, damage, monkeypatch, tmp_path):
    monkeypatch.setattr(caching.config, "CACHE_DIR", str(tmp_path))
    assert _compile.compiled(twice)(3.0) == 6.0
    (file,) = tmp_path.rglob(f"*{end}")
    whole = file.read_bytes()
    cut = {"empty": b"", "cut short": whole[: len(whole) // 2], "garbage": bytes(range(256))}
    file.write_bytes(cut[damage])
    again = _compile.compiled(twice)
    assert again(3.0) == 6.0
    assert sum(again.stats.cache_hits.values()) == 0
    third = _compile.compiled(twice)
    assert third(np.float64(3.0)) == 6.0
    assert sum(third.stats.cache_hits.values()) == 1


def test_23_a_damaged_index_that_cannot_be_replaced_is_gone_without(
    monkeypatch, tmp_path, one_warning
):
    def read_only(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(caching.config, "CACHE_DIR", str(tmp_path))
    assert _compile.compiled(twice)(3.0) == 6.0
    (file,) = tmp_path.rglob("*.nbi")
    file.write_bytes(b"")
    monkeypatch.setattr(caching.IndexDataCacheFile, "_open_for_write", read_only)
    assert _compile.compiled(twice)(3.0) == 6.0


@pytest.mark.parametrize("terminal", [True, False])
def test_the_first_compilation_says_on_a_terminal_how_long_it_takes(
    terminal, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(caching.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)
    _compile._announce.cache_clear()
    assert _compile.compiled(twice)(3.0) == _compile.compiled(twice)(3) == 6
    said = capsys.readouterr().err
    assert said == terminal * "amusic_gym: compiling kernels, once; this takes 10 to 30 seconds\n"
    assert _compile.compiled(twice)(3.0) == 6.0  # from the cache
    assert not capsys.readouterr().err
