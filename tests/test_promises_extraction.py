"""What the project promises of extraction and its cache, on images small enough to see through."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
from extraction_cases import Signalling, Tiny, TwoSided, make_images

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.extraction import BLOCK, Cache, code, describe_map, extract
from amusic_gym.extraction.blocks import Images
from amusic_gym.extraction.describe import ExtractionPlan
from amusic_gym.routes.folders import ImageFolder

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
SECONDS = {"Tiny": 0.5}
COUNT = 3 * BLOCK


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three blocks of images; each is both query and place."""
    return make_images(tmp_path_factory.mktemp("images") / "images", COUNT)


def run(folder: Path, cache: Path, technique=None, **options) -> ScoreBank:
    return extract(
        folder,
        folder,
        [technique or Tiny()],
        **{"tolerance": 0, "seconds": SECONDS, "cache": cache, **options},
    )


def digests(bank: Path) -> list[str]:
    """Of the files of a bank."""
    return [hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(bank.iterdir())]


@pytest.fixture(scope="module")
def serial(folder, tmp_path_factory):
    """The bank that every other way must give."""
    place = tmp_path_factory.mktemp("serial")
    run(folder, place / "cache", out=place / "bank", name="bank")
    return place


# ---- 23: damage --------------------------------------------------------------------------------


def cut(path):
    os.truncate(path, path.stat().st_size - 1)


def flip(path):
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


DAMAGES = {
    "truncated": cut,
    "empty": lambda path: path.write_bytes(b""),
    "garbage": lambda path: path.write_bytes(b"\x93garbage" * 99),
    "flipped": flip,
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_23_a_damaged_cache_is_rebuilt_and_says_so(folder, serial, tmp_path, damage):
    cache = shutil.copytree(serial / "cache", tmp_path / "cache")
    entries = list(cache.rglob("*.entry"))
    assert len(entries) == 3 + 9  # blocks of descriptors, of scores
    for path in entries:
        damage(path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run(folder, cache, out=tmp_path / "bank", name="bank")
    said = [str(each.message) for each in caught]  # the first one, and how many in the end
    assert len(said) == 2
    assert re.search("is damaged .* computed again", said[0])
    assert said[1] == f"{len(entries)} entries of the cache {cache} were damaged"
    assert digests(tmp_path / "bank") == digests(serial / "bank")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(folder, cache)


# ---- 25: keys ----------------------------------------------------------------------------------


def keys(technique, digest="digest") -> set[str]:
    """Of everything that the cache may hold for one image."""
    images = Images((Path("image.png"),), (digest,))
    plan = ExtractionPlan(technique, images, images)
    return {
        plan.descriptor_key(images, query=False),
        plan.descriptor_key(images, query=True),
        plan.score_key(images, images),
        plan.key("seconds", images=images.digests),
    }


class WithWeights(Tiny):
    """Names the digest of its weights, as the package's techniques do."""

    weights = "aa"

    def parameters(self):
        return {**super().parameters(), "weights": self.weights}


def test_25_image_parameter_weights_and_class_are_in_the_keys():
    first = keys(Tiny())
    assert keys(Tiny()) == first
    assert not keys(Tiny(), "other") & first
    assert not keys(Tiny(power=2.0)) & first
    assert not keys(TwoSided()) & first
    weights = WithWeights()
    before = keys(weights)
    weights.weights = "bb"
    assert not keys(weights) & before


def test_25_code_and_versions_of_libraries_are_in_the_keys(monkeypatch):
    first = keys(Tiny())
    digest, libraries = code._code_of(Tiny)
    with monkeypatch.context() as patch:
        patch.setattr(code, "_version", lambda library: "another")
        assert not keys(Tiny()) & first
    with monkeypatch.context() as patch:
        patch.setattr(code, "_code_of", lambda kind: (digest[::-1], libraries))
        assert not keys(Tiny()) & first
    assert keys(Tiny()) == first


def test_25_a_changed_image_gives_another_bank(folder, tmp_path):
    changed = shutil.copytree(folder, tmp_path / "images")
    first = run(changed, tmp_path / "cache")
    shutil.copy(changed / "0000.png", changed / "0070.png")
    second = run(changed, tmp_path / "cache")
    assert second.row(0, 70)[0] == pytest.approx(1)
    assert first.row(0, 70)[0] < 0.999


# ---- 26: read-only -----------------------------------------------------------------------------


@pytest.fixture
def plain_user():
    """Rights of a user who owns nothing: root may write anywhere."""
    if os.geteuid() == 0:
        os.seteuid(65534)
        yield
        os.seteuid(0)
    else:
        yield


def test_26_a_read_only_cache_gives_one_warning_and_the_same_bank(
    folder, serial, monkeypatch, request
):
    with tempfile.TemporaryDirectory() as open_to_all:
        place = Path(open_to_all)
        place.chmod(0o755)
        temporary = place / "temporary"
        temporary.mkdir()
        temporary.chmod(0o777)
        images = shutil.copytree(folder, place / "images")
        cache = place / "cache"
        cache.mkdir()
        cache.chmod(0o555)
        monkeypatch.setattr(tempfile, "tempdir", str(temporary))
        request.getfixturevalue("plain_user")
        with pytest.warns(UserWarning, match="cannot be written .* not kept") as caught:
            bank = run(images, cache / "inner")
        assert len(caught) == 1
        with pytest.warns(UserWarning, match="cannot be written"):
            described = describe_map(ImageFolder(images), Tiny(), cache=cache / "inner")
        scores = described.scores(described.describe_query(ImageFolder(images)[5]))
        assert list(cache.iterdir()) == list(temporary.iterdir()) == []
        if os.geteuid() != os.getuid():
            os.seteuid(0)
    expected = ScoreBank.load(serial / "bank")
    assert np.array_equal(bank.scores, expected.scores)
    assert np.array_equal(scores, expected.row(0, 5))


# ---- 27: full disk, killed in the middle ---------------------------------------------------------

KILLED_WHILE_WRITING = """
import os, signal, sys
import numpy as np
from amusic_gym.extraction import Cache
def half(file, array, **options):
    file.write(b"half of it")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
np.lib.format.write_array = half
Cache(sys.argv[1]).put("ab" * 32, np.ones(3, np.float32))
"""


def test_27_killed_while_writing_leaves_the_old_entry_and_is_swept(tmp_path):
    key = "ab" * 32
    old = np.arange(3, dtype=np.float32)
    with Cache(tmp_path) as cache:
        cache.put(key, old)
    done = subprocess.run(
        [sys.executable, "-c", KILLED_WHILE_WRITING, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=60,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL
    assert len(list((tmp_path / "incoming").iterdir())) == 1
    with Cache(tmp_path) as cache:
        assert not list((tmp_path / "incoming").iterdir())
        assert np.array_equal(cache.get(key).array(), old)


def test_27_the_sweep_spares_what_is_being_written(tmp_path, monkeypatch):
    from amusic_gym.extraction import cache as module

    write = module._write

    def open_another_meanwhile(*arguments):
        Cache(tmp_path)
        write(*arguments)

    monkeypatch.setattr(module, "_write", open_another_meanwhile)
    with Cache(tmp_path) as cache:
        cache.put("ab" * 32, np.ones(3, np.float32))
        assert cache.get("ab" * 32) is not None


@pytest.fixture
def full_disk():
    """No file may grow beyond 4 KiB: the system's refusal comes in the middle of writing."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def test_27_a_full_disk_leaves_the_old_entry(tmp_path, request):
    old = np.arange(3, dtype=np.float32)
    with Cache(tmp_path) as cache:
        cache.put("ab" * 32, old)
        request.getfixturevalue("full_disk")
        with pytest.raises(OSError, match="writing the cache .* failed .* free some space") as info:
            cache.put("ab" * 32, np.ones(100_000, np.float32))
        assert info.value.errno == errno.EFBIG
        assert np.array_equal(cache.get("ab" * 32).array(), old)
        assert not list((tmp_path / "incoming").iterdir())


# ---- 28: two writers -----------------------------------------------------------------------------


def test_28_two_writers_and_no_torn_read(tmp_path):
    key = "ab" * 32
    values = [np.full(5000, value, np.float32) for value in (1, 2)]
    Cache(tmp_path).put(key, values[0])
    over = threading.Event()

    def write(value):
        while not over.is_set():
            Cache(tmp_path).put(key, value)

    writers = [threading.Thread(target=write, args=(value,)) for value in values]
    for writer in writers:
        writer.start()
    try:
        seen = set()
        for _ in range(100):
            read = Cache(tmp_path).get(key).array()  # a new cache: it compares the checksum
            seen |= {tuple(np.unique(read))}
    finally:
        over.set()
        for writer in writers:
            writer.join()
    assert seen <= {(1.0,), (2.0,)}


# ---- 32, 34, 35, 37: executors -----------------------------------------------------------------


def test_32_without_ray_the_command_that_installs_it(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r'needs Ray; install it: pip install "amusic-gym\[ray\]"'):
        run(folder, tmp_path, executor="ray")


def command(folder: Path, place: Path, executor: str, **environment: str):
    """`bank.py images` with a technique that sends a signal."""
    return subprocess.run(
        [
            *(sys.executable, "-W", "error", "-W", "ignore:images of"),
            *(str(ROOT / "scripts" / "bank.py"), "images"),
            *("--reference", str(folder), "--query", str(folder), "--tolerance", "0"),
            *("--techniques", "extraction_cases:FromEnvironment", "--seconds", "Tiny=0.5"),
            *("--cache", str(place / "cache"), "--out", str(place / "bank"), "--name", "bank"),
            *("--executor", executor),
        ],
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT / "tests/support"),
            "TEST_LOG": str(place / "log"),
            "TEST_MARKER": str(place / "marker"),
            **environment,
        },
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        start_new_session=True,  # a group of its own, as a terminal makes one
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def described(place: Path) -> int:
    return len((place / "log").read_text().split())


@pytest.mark.parametrize(
    ("executor", "whom"),
    [("serial", {}), ("process:2", {"TEST_WHOM": "group"})],
    ids=["serial", "process"],
)
@pytest.mark.parametrize(("number", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_34_52_what_is_finished_is_kept(folder, serial, tmp_path, executor, whom, number, status):
    stop = {"TEST_SIGNAL": number, "TEST_AFTER": str(2 * BLOCK + 5), **whom}
    first = command(folder, tmp_path, executor, **stop)
    assert first.returncode == status
    assert first.stderr == "interrupted; what was finished is kept\n"
    assert not (tmp_path / "bank").exists()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["cache", "log", "marker"]
    before = described(tmp_path)
    second = command(folder, tmp_path, executor, **stop)
    assert second.returncode == 0, second.stderr
    assert described(tmp_path) - before <= BLOCK * (1 if executor == "serial" else 2)
    assert digests(tmp_path / "bank") == digests(serial / "bank")


@pytest.mark.parametrize(
    ("executor", "whom"),
    [("serial", {}), ("process:2", {"TEST_WHOM": "parent"})],
    ids=["serial", "process"],
)
def test_35_a_killed_extraction_skips_what_is_done(folder, serial, tmp_path, executor, whom):
    stop = {"TEST_SIGNAL": "SIGKILL", "TEST_AFTER": str(2 * BLOCK + 5), **whom}
    assert command(folder, tmp_path, executor, **stop).returncode == -signal.SIGKILL
    assert not (tmp_path / "bank").exists()
    before = described(tmp_path)
    second = command(folder, tmp_path, executor, **stop)
    assert second.returncode == 0, second.stderr
    assert described(tmp_path) - before <= BLOCK * (1 if executor == "serial" else 2)
    assert digests(tmp_path / "bank") == digests(serial / "bank")


def kill_one_worker(folder, serial, place, executor):
    killer = Signalling(
        signal.SIGKILL, marker=place / "marker", after=BLOCK // 2, log=place / "log"
    )
    run(folder, place / "cache", killer, executor=executor, out=place / "bank", name="bank")
    assert (place / "marker").exists()
    assert digests(place / "bank") == digests(serial / "bank")


def test_37_a_killed_process_gives_the_same_bytes(folder, serial, tmp_path):
    kill_one_worker(folder, serial, tmp_path, "process:2")


@pytest.mark.usefixtures("two_ray_workers")
def test_37_a_killed_ray_worker_gives_the_same_bytes(folder, serial, tmp_path):
    kill_one_worker(folder, serial, tmp_path, "ray")
    broken = make_images(tmp_path / "broken", 1)  # its header is whole
    data = bytearray((broken / "0000.png").read_bytes())
    data[60] ^= 255
    (broken / "0000.png").write_bytes(data)
    with pytest.raises(ValueError, match=r"0000\.png"):
        run(broken, tmp_path / "cache", executor="ray")


def test_37_a_shard_that_kills_every_worker_is_given_up(folder, tmp_path):
    killer = Signalling(signal.SIGKILL)
    with pytest.raises(ChildProcessError, match=r"3 workers died of it, the last by .* SIGKILL"):
        run(folder, tmp_path, killer, executor="process:2")


def test_37_an_error_in_a_worker_is_no_death(tmp_path):
    folder = make_images(tmp_path / "images", 2)
    log = tmp_path / "log"
    data = bytearray((folder / "0001.png").read_bytes())
    data[60] ^= 255  # within the pixels: only decoding notices
    (folder / "0001.png").write_bytes(data)
    with pytest.raises(ValueError, match=r"0001\.png cannot be decoded"):
        run(folder, tmp_path / "cache", Tiny(log=log), executor="process:2")
    assert len(log.read_text().split()) <= 2  # the first image, not once per attempt
