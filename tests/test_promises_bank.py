"""What the project promises of banks when input is bad or the program dies: one test per row."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import socket
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amusic_gym.banks import bank_files, importers
from amusic_gym.banks.bank import GroundTruth, ScoreBank
from amusic_gym.banks.importers import from_arrays, from_vprbench
from amusic_gym.utils import reading, storage

ROOT = Path(__file__).resolve().parent.parent


def make_bank(value: float = 0.0, techniques: int = 2) -> ScoreBank:
    names = [f"T{i}" for i in range(techniques)]
    scores = np.full((techniques, 6, 8), value)
    return ScoreBank(
        scores,
        names,
        np.ones(techniques),
        tolerance=1,
        name="route",
        ground_truth=np.arange(scores.shape[1]),
    )


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return make_bank().save(tmp_path / "bank")


def run_python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a process of its own, which can be killed."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=120,
        check=False,
    )


def run_script(*arguments: object) -> subprocess.CompletedProcess[str]:
    script = ROOT / "scripts" / "bank.py"
    return subprocess.run(
        [sys.executable, str(script), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


# ---- what is in a bank -------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 5), (3, 1, 1)])
def test_12_one_query_or_reference_works(shape, tmp_path):
    names = [f"T{i}" for i in range(shape[0])]
    bank = ScoreBank(np.zeros(shape), names, np.ones(shape[0]), tolerance=3, ground_truth=[0])
    assert bank.shape == ScoreBank.load(bank.save(tmp_path / "b"), verify=True).shape == shape
    assert bank.truth.correct([0]).tolist() == [True]
    assert bank.prepared(50).candidates == shape[2]


@pytest.mark.parametrize("shape", [(0, 2, 2), (1, 0, 2), (1, 2, 0)])
def test_12_zero_of_anything_is_refused(shape):
    with pytest.raises(ValueError, match="at least one of each"):
        ScoreBank(np.zeros(shape), ["A"] * shape[0], np.ones(shape[0]), tolerance=0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300, -1e300])
def test_13_a_score_that_is_not_finite_is_refused_by_technique_and_frame(bad):
    scores = np.zeros((2, 8, 8))
    scores[1, 4, 2] = bad
    with pytest.raises(ValueError, match="technique 'T1' at frame 4, place 2 is"):
        ScoreBank(scores, ["T0", "T1"], [1, 1], tolerance=0)


def test_49_minus_infinity_is_no_candidate_and_stays(tmp_path):
    scores = np.zeros((2, 8, 8))
    scores[1, 4, 2] = -np.inf
    bank = ScoreBank(scores, ["T0", "T1"], [1, 1], tolerance=0)
    loaded = ScoreBank.load(bank.save(tmp_path / "bank"), verify=True)
    loaded.check_finite()
    assert loaded.scores[1, 4, 2] == -np.inf


def test_13_a_bank_on_disk_is_checked_on_demand(saved):
    with (saved / "scores.npy").open("r+b") as file:
        file.seek(-4, os.SEEK_END)
        file.write(np.float32(np.nan).tobytes())
    with pytest.raises(ValueError, match="technique 'T1' at frame 5, place 7 is nan"):
        ScoreBank.load(saved).check_finite()


@pytest.mark.parametrize(
    ("ground_truth", "sentence"),
    [
        (np.zeros((6, 7), bool), r"shape \(6, 7\).*give shape \(6, 8\) or \(6,\)"),
        (np.zeros((8, 6), bool), r"shape \(8, 6\)"),
        (np.zeros(5, int), r"shape \(5,\)"),
        (np.zeros((6, 8), int), "give a boolean matrix"),
        (np.zeros(6), "give a list of integers"),
        (np.array([0, 1, 2, 3, 4, 8]), r"true place 8 \(entry 5\) is out of range; valid: -1 to 7"),
        (np.array([0, -2, 2, 3, 4, 5]), r"true place -2 \(entry 1\)"),
        (GroundTruth.from_places([0, 1], 0, 8), r"shape \(2, 8\)"),
    ],
)
def test_21_ground_truth_of_wrong_shape_or_range_is_refused(ground_truth, sentence):
    with pytest.raises(ValueError, match=sentence):
        ScoreBank(np.zeros((1, 6, 8)), ["A"], [1], tolerance=0, ground_truth=ground_truth)


def test_21_a_query_without_a_true_place_counts_wrong():
    truth = GroundTruth.from_places([0, -1], 0, 3)
    assert truth.has_place.tolist() == [True, False]
    assert truth.correct([0, 2]).tolist() == [True, False]
    assert truth.correct([-1, -1]).tolist() == [False, False]
    np.testing.assert_array_equal(truth.distance([-1, -1]), [3.0, np.nan])


# ---- damage ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bank.json", "scores.npy", "ground_truth.npz"])
@pytest.mark.parametrize("damage", ["missing", "empty", "garbage", "truncated", "longer"])
def test_23_a_damaged_bank_is_refused_by_name(saved, name, damage):
    file = saved / name
    content = file.read_bytes()
    match damage:
        case "missing":
            file.unlink()
        case "empty":
            file.write_bytes(b"")
        case "garbage":
            file.write_bytes(bytes(range(256)) * 4)
        case "truncated":
            file.write_bytes(content[:-9])
        case "longer":
            file.write_bytes(content + b"{}")
    expected = FileNotFoundError if damage == "missing" else ValueError
    with pytest.raises(expected, match=rf"{name}.*; \w+"):  # the file, and the mend
        ScoreBank.load(saved)


def test_23_bit_flips_are_found_in_small_files_always_and_in_the_scores_on_request(saved):
    for name in sorted(os.listdir(saved)):
        file = saved / name
        content = file.read_bytes()
        for at in range(0, len(content), 7):
            flipped = bytearray(content)
            flipped[at] ^= 1
            file.write_bytes(flipped)
            with pytest.raises((ValueError, FileNotFoundError), match=name.replace(".", r"\.")):
                ScoreBank.load(saved, verify=name == "scores.npy")
        file.write_bytes(content)
    ScoreBank.load(saved, verify=True)


def test_23_scores_of_another_shape_than_bank_json_says_are_refused(saved):
    np.save(saved / "scores.npy", np.zeros((2, 6, 9), np.float32))
    with pytest.raises(ValueError, match=r"shape \(2, 6, 9\) where bank.json says \(2, 6, 8\)"):
        ScoreBank.load(saved)
    np.save(saved / "scores.npy", np.zeros((2, 6, 8)))
    with pytest.raises(ValueError, match="float64 where float32"):
        ScoreBank.load(saved)


def test_23_what_is_no_bank_at_all_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="none does not exist; check the name"):
        ScoreBank.load(tmp_path / "none")
    with pytest.raises(
        FileNotFoundError, match="has no bank.json, so it is not a whole bank; copy"
    ):
        ScoreBank.load(tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(ValueError, match="file is a file; give a folder"):
        ScoreBank.load(tmp_path / "file")


def rewrite(saved: Path, **entries: object) -> None:
    """Change bank.json as an attacker would: with the right checksums."""
    manifest = json.loads((saved / "bank.json").read_text()) | entries
    manifest["files"]["ground_truth.npz"] = bank_files.size_and_checksum(saved / "ground_truth.npz")
    manifest["sha256"] = bank_files.checksum(manifest)
    (saved / "bank.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    ("entries", "sentence"),
    [
        (
            {"tolerance": 2**62},
            "tolerance is 4611686018427387904; give at most 2147483647",
        ),
        ({"tolerance": -1}, "tolerance is -1"),
        ({"tolerance": True}, "tolerance is True"),
        ({"tolerance": 10**400}, "is not whole JSON of finite numbers"),
        ({"queries": "6"}, "queries is '6'"),
        ({"queries": 0}, "queries is 0"),
        ({"queries": 2**70}, r"shape \(2, 6, 8\) where"),
        ({"references": 8.0}, r"references is 8\.0"),
        ({"costs": "free"}, "unknown cost model 'free'"),
        ({"techniques": [{"name": 5, "seconds": 1}, {"name": "B", "seconds": 1}]}, "name 5 is"),
        ({"techniques": [{"name": "A", "seconds": "1"}] * 2}, "seconds is '1'; give a number"),
        ({"techniques": [{"name": "A", "seconds": 0}, {"name": "B", "seconds": 1}]}, "A' are 0.0"),
        ({"techniques": [{"name": "A", "seconds": 1e308}] * 2}, "'A' is named twice"),
        ({"techniques": {"A": 1, "B": 2}}, "lacks an entry or has a wrong one"),
        ({"techniques": 5}, "lacks an entry or has a wrong one"),
        ({"format_version": 0}, "names no format version"),
    ],
)
def test_23_every_number_of_a_bank_is_bounded_where_it_is_read(saved, entries, sentence):
    rewrite(saved, **entries)
    with pytest.raises(ValueError, match=sentence) as refused:
        ScoreBank.load(saved)
    assert str(saved) in str(refused.value)


@pytest.mark.parametrize(
    "text",
    [
        b'{"format_version": Infinity}',
        b'{"format_version": 1e999}',
        b'{"format_version": ' + b"9" * 5000 + b"}",
        b'{"a": ' * 100_000,
        b'{"a": ' * 900 + b"1" + b"}" * 900,
        b"[" * 3000 + b"]" * 3000,
        b"[]",
        b"\xff",
    ],
)
def test_23_odd_json_is_refused_in_a_sentence(saved, text):
    (saved / "bank.json").write_bytes(text)
    with pytest.raises(ValueError, match=r"bank\.json (is damaged|names no|was damaged).*; copy"):
        ScoreBank.load(saved)


@pytest.mark.parametrize("name", sorted(bank_files.FILES - {bank_files.IMAGES}))
@pytest.mark.parametrize("kind", ["fifo", "/dev/zero", "socket"])
def test_23_what_is_no_regular_file_is_refused_at_once(saved, name, kind):
    (saved / name).unlink()
    match kind:
        case "fifo":
            os.mkfifo(saved / name)  # nobody writes to it: reading would wait for ever
        case "socket":
            with socket.socket(socket.AF_UNIX) as end:
                end.bind(os.path.relpath(saved / name))  # such an address is short
        case _:
            (saved / name).symlink_to(kind)
    with pytest.raises(ValueError, match=rf"{name} is a device or a pipe; give a regular file"):
        ScoreBank.load(saved)


@pytest.mark.parametrize("bomb", ["compressed", "larger than any", "long list"])
def test_23_a_ground_truth_that_unpacks_to_more_is_refused_unread(saved, bomb):
    truth = saved / "ground_truth.npz"
    arrays = {"indptr": np.zeros(10**6, np.int64), "places": np.arange(6), "references": 8}
    if bomb == "compressed":
        np.savez_compressed(truth, **arrays)
        assert truth.stat().st_size < 9000
    elif bomb == "larger than any":
        np.savez(truth, **arrays)
    else:
        with zipfile.ZipFile(truth, "w") as archive:
            for i in range(1000):
                archive.writestr(f"{i:060}", b"")
    rewrite(saved)
    with pytest.raises(
        ValueError, match=r"ground_truth.npz (cannot be read \(compr|has more than)"
    ):
        ScoreBank.load(saved)


@pytest.mark.parametrize("limit", [0, 3, 4])
def test_23_a_regular_file_is_read_up_to_a_limit(tmp_path, limit):
    (tmp_path / "x").write_bytes(b"four")
    if limit == 4:
        assert reading.read_regular(tmp_path / "x", limit) == b"four"
        return
    with pytest.raises(ValueError, match=rf"x has more than the {limit} bytes"):
        reading.read_regular(tmp_path / "x", limit)


def npy(header: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(4)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-1, -1)}",
        f"{{'descr': '<f4', 'fortran_order': False, 'shape': (0, {2**70})}}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (1e400,)}",
        "{'descr': '|V0', 'fortran_order': False, 'shape': (1, 1)}",
        "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1, 1)}",
        "{'descr': ('<f4', (2, 2)), 'fortran_order': False, 'shape': (1,)}",
        "{'descr': '<U1', 'fortran_order': False, 'shape': (1, 1)}",
        "{'descr': '<c8', 'fortran_order': False, 'shape': (1, 1)}",
        "[" * 5000,
        "-" * 5000 + "1",
    ],
)
def test_23_odd_npy_headers_are_refused_in_a_sentence(saved, header):
    (saved / "scores.npy").write_bytes(npy(header))
    with pytest.raises(ValueError, match=r"scores.npy .*; \w+"):
        ScoreBank.load(saved)
    with pytest.raises(ValueError, match=r"scores.npy .*; \w+"):
        from_arrays({"A": saved / "scores.npy"}, {"A": 1}, tolerance=0)


class Bomb:
    """Leaves a file behind when its pickle is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_24_pickled_objects_are_refused_and_never_run(saved, tmp_path):
    bomb = np.array([Bomb(tmp_path / "exploded")], dtype=object)
    np.save(saved / "scores.npy", bomb, allow_pickle=True)
    with pytest.raises(ValueError, match="pickled objects are never read"):
        ScoreBank.load(saved)
    with pytest.raises(ValueError, match="holds pickled Python objects"):
        from_arrays({"A": saved / "scores.npy"}, {"A": 1}, tolerance=0)
    (tmp_path / "bare.npy").write_bytes(pickle.dumps(Bomb(tmp_path / "exploded")))
    with pytest.raises(ValueError, match="is not a NumPy .npy file"):
        from_arrays({"A": tmp_path / "bare.npy"}, {"A": 1}, tolerance=0)
    assert not (tmp_path / "exploded").exists()


def test_24_vprbench_files_are_unpickled_only_with_trust(tmp_path):
    folder = tmp_path / "matches" / "X"
    folder.mkdir(parents=True)
    bomb = np.array([Bomb(tmp_path / "exploded")], dtype=object)
    np.save(folder / "precomputed_data_corrected.npy", bomb, allow_pickle=True)
    with pytest.raises(ValueError, match=r"if you trust who made it, pass trust=True \(--trust\)"):
        from_vprbench(folder.parent, ["X"], np.arange(2))
    assert not (tmp_path / "exploded").exists()
    with pytest.raises(ValueError, match="is not laid out as"):
        from_vprbench(folder.parent, ["X"], np.arange(2), trust=True)
    assert (tmp_path / "exploded").exists()  # what trust means


def test_29_a_newer_format_is_refused_with_the_version_it_needs(saved):
    manifest = json.loads((saved / "bank.json").read_text())
    manifest["format_version"] = 7
    (saved / "bank.json").write_text(json.dumps(manifest))
    with pytest.raises(ValueError, match=r"needs an amusic-gym that reads version 7.*upgrade"):
        ScoreBank.load(saved)


# ---- writers that die, and writers at once ------------------------------------------------

KILLED_AT_EVERY_CALL = """
import contextlib, json, os, shutil, signal, sys
from pathlib import Path
import numpy as np
from amusic_gym.utils import reading, storage
from amusic_gym.banks.bank import ScoreBank

folder, swap = Path(sys.argv[1]), sys.argv[2] == "swap"
if not swap:
    storage._swap = lambda *_: False

def bank(value):
    return ScoreBank(np.full((2, 6, 6), value), ["A", "B"], [1, 1], tolerance=1)

def killed_at(call):
    left = [call]
    def counted(function):
        def wrapper(*args, **kwargs):
            left[0] -= 1
            if left[0] < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*args, **kwargs)
        return wrapper
    for module, names in ((os, ("mkdir", "open", "fsync", "rename", "unlink", "rmdir")),
                          (storage, ("_swap",)), (np.lib.format, ("write_array_header_1_0",)),
                          (Path, ("write_text",)), (np, ("savez",))):
        for name in names:
            setattr(module, name, counted(getattr(module, name)))
    bank(2.0).save(folder / "bank")
    os._exit(0)

bank(1.0).save(folder / "bank")
calls, outcomes = 0, set()
while True:
    child = os.fork()
    if child == 0:
        killed_at(calls)
    status = os.waitpid(child, 0)[1]
    loaded = ScoreBank.load(folder / "bank", verify=True)
    outcomes.add(float(loaded.scores[0, 0, 0]))
    assert (loaded.scores == loaded.scores[0, 0, 0]).all()
    bank(1.0).save(folder / "bank")
    assert os.listdir(folder) == ["bank"], os.listdir(folder)
    if status == 0:
        break
    assert os.WTERMSIG(status) == signal.SIGKILL
    calls += 1
print(json.dumps([calls, sorted(outcomes)]))
"""


@pytest.mark.parametrize("way", ["swap", "two renames"])
def test_27_sigkill_at_any_call_leaves_a_whole_bank_and_the_next_writer_sweeps(tmp_path, way):
    done = run_python(KILLED_AT_EVERY_CALL, tmp_path, way)
    assert done.returncode == 0, done.stderr
    calls, outcomes = json.loads(done.stdout)
    assert calls > 12
    assert outcomes == [1.0, 2.0]  # killed before and after the exchange


FULL_DISK = """
import resource, sys
import numpy as np
from amusic_gym.banks.bank import ScoreBank
bank = ScoreBank(np.ones((2, 100, 100)), ["A", "B"], [1, 1], tolerance=1)
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))  # scores.npy needs 80,128
try:
    bank.save(sys.argv[1])
except OSError as error:
    print(error.strerror)
"""


def test_27_a_full_disk_leaves_the_old_bank_and_no_leftovers(saved):
    done = run_python(FULL_DISK, saved)
    assert done.stdout.startswith(f"writing {saved} failed (File too large); nothing was changed")
    assert ScoreBank.load(saved, verify=True).techniques == ("T0", "T1")
    assert os.listdir(saved.parent) == ["bank"]


def test_27_an_error_between_the_two_renames_puts_the_old_bank_back(saved, monkeypatch):
    rename, calls = os.rename, []

    def failing(source, target):
        calls.append(source)
        if len(calls) == 3:  # the first finds the name taken, the second moves the old aside
            raise PermissionError(13, "Permission denied")
        rename(source, target)

    monkeypatch.setattr(storage, "_swap", lambda *_: False)
    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(OSError, match=r"failed \(Permission denied\); nothing was changed"):
        make_bank(3.0).save(saved)
    assert len(calls) == 4
    assert (ScoreBank.load(saved, verify=True).scores == 0).all()
    assert os.listdir(saved.parent) == ["bank"]


def test_27_a_living_writer_s_folder_is_not_swept(saved, tmp_path):
    other = make_bank(5.0, techniques=1).save(tmp_path / "elsewhere" / "bank")
    with storage.replacing_folder(saved, "bank.json", bank_files.FILES) as folder:
        make_bank(4.0).save(saved)  # another writer comes between
        assert (ScoreBank.load(saved).scores == 4).all()
        for file in other.iterdir():
            shutil.copy(file, folder)
    assert (ScoreBank.load(saved, verify=True).scores == 5).all()  # the later rename


TWO_WRITERS = """
import os, sys
from pathlib import Path
import numpy as np
from amusic_gym.utils import reading, storage
from amusic_gym.banks.bank import ScoreBank

path = Path(sys.argv[1])
for name in "ab":
    (path.parent / name).mkdir()
swaps = sys.argv[2] == "swap" and storage._swap(path.parent / "a", path.parent / "b")
for name in "ab":
    (path.parent / name).rmdir()
if not swaps:  # as on file systems that cannot
    storage._swap = lambda *_: False

def bank(value):
    return ScoreBank(np.full((value, 30, 30), value), [f"{value}-{i}" for i in range(value)],
                     np.full(value, value), tolerance=value, name=str(value))

bank(1).save(path)
writers = []
for value in (2, 3):
    child = os.fork()
    if child == 0:
        made = bank(value)
        for _ in range(60):
            made.save(path)
        os._exit(0)
    writers.append(child)

reads, seen = 0, set()
while writers:
    try:
        loaded = ScoreBank.load(path, verify=True)
    except FileNotFoundError:
        if swaps:
            raise  # with the swap, the name is never empty
    else:
        value = loaded.tolerance
        assert loaded.shape == (value, 30, 30) and (loaded.scores == value).all()
        assert loaded.name == str(value) and (loaded.seconds == value).all()
        seen.add(value)
        reads += 1
    for writer in list(writers):
        done, status = os.waitpid(writer, os.WNOHANG)
        if done:
            assert status == 0, status
            writers.remove(writer)
assert ScoreBank.load(path, verify=True).tolerance in (2, 3)
bank(1).save(path)
assert os.listdir(path.parent) == [path.name], os.listdir(path.parent)
print("whole", reads > 0)
"""


@pytest.mark.parametrize("way", ["swap", "two renames"])
def test_28_two_writers_at_once_give_one_result_whole(tmp_path, way):
    done = run_python(TWO_WRITERS, tmp_path / "bank", way)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "whole True\n"


# ---- scores that are none ------------------------------------------------------------------


@pytest.fixture
def similarities(tmp_path) -> np.ndarray:
    """(40, 40): query q is most like place q; also in a file."""
    scores = np.random.default_rng(0).random((40, 40)) + np.eye(40)
    np.save(tmp_path / "a.npy", scores)
    return scores


def arrays_of(tmp_path, scores, **options):
    np.save(tmp_path / "a.npy", scores)
    return from_arrays({"A": tmp_path / "a.npy"}, {"A": 1}, **{"tolerance": 0, **options})


@pytest.mark.parametrize("fortran", [False, True])
@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int16])
def test_49_distances_are_refused_with_a_hint(tmp_path, similarities, fortran, kind):
    scores = np.array(100 * similarities, kind, order="F" if fortran else "C")
    bank = arrays_of(tmp_path, scores, out=tmp_path / "bank")
    np.testing.assert_array_equal(bank.scores[0], scores.astype(np.float32))
    with pytest.raises(ValueError, match="'A' look like distances: the lowest .* on 40 frames, "):
        arrays_of(tmp_path, -scores, out=tmp_path / "other")
    assert not (tmp_path / "other").exists()


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32))
def test_49_chance_is_not_taken_for_distances(seed):
    rng = np.random.default_rng(seed)
    truth = GroundTruth.from_places(np.arange(60), 2, 60)
    blocks = [rng.random((20, 60), np.float32) for _ in range(3)]
    assert len(list(importers._checked("A", blocks, truth))) == 3


def test_49_descriptors_are_refused_with_a_hint(tmp_path):
    descriptors = np.random.default_rng(0).random((40, 128))
    for truth in (None, np.eye(40, dtype=bool)):
        with pytest.raises(ValueError, match="scores have a column per place, unlike descriptors"):
            arrays_of(tmp_path, descriptors, ground_truth=truth)


def test_49_arrays_are_written_in_blocks(tmp_path):
    scores = np.random.default_rng(0).random((2, 1500, 1500), np.float32)
    for name, matrix in zip("AB", scores, strict=True):
        np.save(tmp_path / f"{name}.npy", matrix)
    files = {name: tmp_path / f"{name}.npy" for name in "AB"}
    tracemalloc.start()
    try:
        bank = from_arrays(files, {"A": 1, "B": 1}, tolerance=0, out=tmp_path / "bank")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1.2 * scores[0].nbytes
    np.testing.assert_array_equal(bank.scores, scores)


@pytest.mark.parametrize("on_disk", [False, True])
def test_49_recent_frames_are_no_candidates(tmp_path, on_disk):
    scores = np.random.default_rng(0).random((6, 6))
    truth = np.eye(6, dtype=bool) | np.eye(6, k=-3, dtype=bool)
    out = tmp_path / "bank" if on_disk else None
    bank = arrays_of(
        tmp_path, scores, ground_truth=truth, tolerance=None, exclude_recent=1, out=out
    )
    for frame in range(6):
        for place in range(6):
            expected = np.float32(scores[frame, place]) if place < frame - 1 else -np.inf
            assert bank.scores[0, frame, place] == expected
    np.testing.assert_array_equal(bank.truth.matrix(), np.eye(6, k=-3, dtype=bool))
    with pytest.raises(ValueError, match="exclude_recent is 3, and no frame has a true place"):
        arrays_of(tmp_path, scores, ground_truth=truth, tolerance=None, exclude_recent=3)
    with pytest.raises(ValueError, match="one sequence against itself, but there are 5 queries"):
        arrays_of(tmp_path, scores[1:], ground_truth=truth[1:], tolerance=None, exclude_recent=1)


# ---- the command --------------------------------------------------------------------------


def test_command_makes_and_shows_a_bank(tmp_path):
    np.save(tmp_path / "a.npy", np.eye(4))
    out = tmp_path / "made"
    made = run_script(
        "arrays", "--scores", f"A={tmp_path / 'a.npy'}", "--seconds", "A=0.5",
        "--tolerance", 0, "--out", out,
    )  # fmt: skip
    assert (made.returncode, made.stderr) == (0, "")
    shown = run_script("info", out)
    assert shown.returncode == 0
    assert "references  4" in shown.stdout
    assert shown.stdout.splitlines()[-1].split() == ["A", "0.500000", "1.0000"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["inof", "x"], "did you mean 'info'?"),
        (["info", "nowhere"], "nowhere does not exist; check the name"),
        (["arrays", "--scores", "A=a.npy", "--seconds", "A=x", "--out", "o"], "'x' is not a num"),
        (["vprbench", "--mathces", "x"], "required: --matches"),
    ],
)
def test_command_refuses_bad_input_in_one_line(arguments, sentence):
    done = run_script(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert sentence in done.stderr


INTERRUPTED = """
import sys
sys.path.insert(0, sys.argv[1])
import _cli

def main():
    raise KeyboardInterrupt

_cli.run(main)
"""


def test_34_command_ends_with_130_on_ctrl_c():
    done = run_python(INTERRUPTED, ROOT / "scripts")
    assert done.returncode == 130
    assert done.stderr.splitlines() == ["interrupted; what was finished is kept"]
