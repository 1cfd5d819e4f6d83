"""The cache of extraction, and the keys of its entries."""

from __future__ import annotations

import importlib
import sys
import warnings

import numpy as np
import pytest
from extraction_cases import Tiny, TwoSided

from amusic_gym.extraction import cache as cache_module
from amusic_gym.extraction import code
from amusic_gym.extraction.blocks import Images
from amusic_gym.extraction.cache import Cache, default_cache
from amusic_gym.extraction.describe import ExtractionPlan
from amusic_gym.techniques import Technique

KEY = code.key_of(test=1)
ARRAY = np.arange(24, dtype=np.float32).reshape(2, 3, 4)


def entry(cache: Cache, key: str = KEY):
    return cache.folder / key[:2] / f"{key}.entry"


def test_an_entry_comes_back_memory_mapped_read_only_and_aligned(tmp_path):
    with Cache(tmp_path / "deep" / "cache") as cache:
        assert cache.get(KEY) is None
        cache.put(KEY, ARRAY)
    with Cache(tmp_path / "deep" / "cache") as cache:
        array = cache.get(KEY).array()
    assert np.array_equal(array, ARRAY)
    assert array.dtype == np.float32
    assert array.ctypes.data % 64 == 0
    assert isinstance(array.base, np.memmap)
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 0


def test_an_entry_is_replaced_while_it_is_in_use(tmp_path):
    cache = Cache(tmp_path)
    old = cache.put(KEY, ARRAY).array()
    new = cache.put(KEY, ARRAY + 1).array()
    assert np.array_equal(old, ARRAY)
    assert np.array_equal(new, ARRAY + 1)


def test_an_entry_under_the_name_of_another_is_not_believed(tmp_path):
    cache = Cache(tmp_path)
    cache.put(KEY, ARRAY)
    other = code.key_of(test=2)
    entry(cache, other).parent.mkdir(exist_ok=True)
    entry(cache).rename(entry(cache, other))
    with pytest.warns(UserWarning, match="damaged"):
        assert Cache(tmp_path).get(other) is None


def test_the_checksum_is_compared_once_per_run(tmp_path, monkeypatch):
    cache = Cache(tmp_path)
    cache.put(KEY, ARRAY)
    calls = []
    digest = cache_module._digest
    monkeypatch.setattr(cache_module, "_digest", lambda *args: calls.append(1) or digest(*args))
    again = Cache(tmp_path)
    again.get(KEY)
    again.get(KEY)
    assert len(calls) == 1


def test_the_folder_is_that_of_the_user(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_cache() == tmp_path / "amusic-gym"
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert default_cache() == tmp_path / "home" / ".cache" / "amusic-gym"


def test_a_file_is_no_cache(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="is a file; give a folder"):
        Cache(tmp_path / "file")
    with pytest.raises(OSError, match="cannot be used"):
        Cache(tmp_path / "file" / "inner")


@pytest.mark.parametrize("home", ["file", "file/inner"])
def test_an_unusable_default_is_warned_of_and_done_without(tmp_path, monkeypatch, home):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / home))
    with pytest.warns(UserWarning, match="file.*/amusic-gym cannot be written .*--cache") as said:
        cache = Cache()
    assert len(said) == 1
    assert cache.is_temporary
    assert np.array_equal(cache.put(KEY, ARRAY).array(), cache.get(KEY).array())
    cache.close()


def test_a_user_without_a_home_is_told_so(monkeypatch):
    def unknown():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache_module.Path, "home", unknown)
    with pytest.raises(ValueError, match="no home folder .* choose a folder for the cache"):
        Cache()


def test_a_folder_in_an_entrys_place_is_refused(tmp_path):
    cache = Cache(tmp_path)
    entry(cache).mkdir(parents=True)
    with pytest.raises(OSError, match="entry is a folder, where a file should be; remove it"):
        cache.get(KEY)


def test_damaged_entries_are_warned_of_once_and_counted(tmp_path):
    keys = [code.key_of(test=number) for number in range(3)]
    with Cache(tmp_path) as cache:
        for key in keys:
            cache.put(key, ARRAY)
            entry(cache, key).write_bytes(b"")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for few in (1, 3):
            with Cache(tmp_path) as cache:
                assert [cache.get(key) for key in keys[:few]] == [None] * few
    said = [str(each.message) for each in caught]
    assert ["is damaged" in each for each in said] == [True, True, False]
    assert said[2] == f"3 entries of the cache {tmp_path} were damaged"


def test_queries_share_the_maps_entries_where_they_are_described_alike():
    images = Images((), ("digest",))
    same, other = (ExtractionPlan(technique, images, images) for technique in (Tiny(), TwoSided()))
    keys = [plan.descriptor_key(images, query=query) for plan in (same, other) for query in (0, 1)]
    assert keys[0] == keys[1]
    assert len(set(keys)) == 3


def test_parameters_must_be_plain():
    class Bad(Tiny):
        def parameters(self):
            return {"sizes": [1, 2]}

    with pytest.raises(ValueError, match=r"parameter 'sizes' of technique 'Tiny' is \[1, 2\]"):
        code.identity(Bad())


def test_numpy_numbers_are_plain():
    class Good(Tiny):
        def parameters(self):
            return {"size": np.int64(3)}

    assert code.identity(Good())["parameters"] == {"size": 3}


def forget():
    for each in (code._file_of, code._code_of, code._is_own):
        each.cache_clear()


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of the user's with a technique that imports a neighbour and a library."""
    folder = tmp_path / "users_package"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "helper.py").write_text("FACTOR = 1\n")
    (folder / "unused.py").write_text("import torch\n")
    (folder / "mine.py").write_text(
        "from amusic_gym.techniques import Technique\n"
        "class Mine(Technique):\n"
        "    name = 'Mine'\n"
        "    def describe(self, image):\n"
        "        import scipy.fft\n"
        "        from .helper import FACTOR\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    technique = importlib.import_module("users_package.mine").Mine()
    yield folder, technique
    for name in [name for name in sys.modules if name.startswith("users_package")]:
        del sys.modules[name]
    forget()


def test_the_code_is_that_of_the_class_and_of_what_it_imports(package):
    folder, technique = package

    def now():
        code._code_of.cache_clear()
        return code.identity(technique)

    first = now()
    assert now() == first
    (folder / "unused.py").write_text("import torch  # changed\n")
    assert now() == first
    (folder / "helper.py").write_text("FACTOR = 2\n")
    second = now()
    assert second["code"] != first["code"]
    (folder / "mine.py").write_text((folder / "mine.py").read_text() + "# changed\n")
    assert now()["code"] != second["code"]


def test_the_code_is_also_that_of_modules_of_ones_own(tmp_path, monkeypatch):
    """Plain modules next to the technique's, also by way of others and of packages."""
    files = {
        "own_edit.py": "from amusic_gym.techniques import Technique\n"
        "from own_helper import f\n"
        "class Edit(Technique):\n"
        "    name = 'Edit'\n"
        "    def describe(self, image):\n"
        "        import own_late\n",
        "own_helper.py": "import own_package\ndef f(): pass\n",
        "own_late.py": "import json, scipy\n",
        "own_package/__init__.py": "from .inner import x\nfrom . import other\n",
        "own_package/inner.py": "x = 1\n",
        "own_package/other.py": "",
        "own_unused.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    technique = importlib.import_module("own_edit").Edit()

    def now():
        forget()
        return code.identity(technique)

    try:
        digest, libraries = now()["code"], now()["libraries"]
        assert "scipy" in libraries
        assert not [name for name in libraries if name.startswith(("own_", "json"))]
        for name in files:
            (tmp_path / name).write_text(files[name] + "# changed\n")
            assert (now()["code"] == digest) == (name == "own_unused.py"), name
            digest = now()["code"]
        (tmp_path / "own_late.py").write_text("not Python")
        assert now()["code"] != digest
    finally:
        for name in [name for name in sys.modules if name.startswith("own_")]:
            del sys.modules[name]
        forget()


def test_the_libraries_are_those_that_the_code_imports(package):
    libraries = code.identity(package[1])["libraries"]
    assert {"numpy", "scipy", "cv2"} <= set(libraries)
    assert not {"torch", "gymnasium"} & set(libraries)
    assert libraries["numpy"] == np.__version__
    assert libraries["cv2"].startswith("4.")


def test_code_that_was_typed_in_counts_too():
    def typed(constant):
        space = {"Technique": Technique, "__name__": "typed_in"}
        exec(f"class Typed(Technique):\n    def describe(self, i): return {constant}", space)
        space["Typed"].name = "Typed"
        return code.identity(space["Typed"]())["code"]

    assert typed(1) != typed(2)


def test_an_entry_that_is_swept_as_it_begins_is_written_again(tmp_path, monkeypatch):
    write, swept = cache_module._write, []

    def swept_once(file, *arguments):
        if not swept:
            swept.extend((tmp_path / "incoming").iterdir())
            swept[0].unlink()
        write(file, *arguments)

    monkeypatch.setattr(cache_module, "_write", swept_once)
    Cache(tmp_path).put(KEY, ARRAY)
    assert swept
    assert np.array_equal(Cache(tmp_path).get(KEY).array(), ARRAY)
