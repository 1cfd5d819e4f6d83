"""Descriptors that were computed elsewhere: every layout gives the same bank, or one sentence."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import descriptor_cases as cases
import numpy as np
import pytest
from descriptor_cases import NAMES, PLACES
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.spatial.distance import cdist

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.descriptors import DescriptorPair, from_npy, similarity
from amusic_gym.cli import start

HERE, THERE = cases.runs()


def bank(out: Path, *words: object) -> ScoreBank:
    """The bank that ``bank descriptors`` makes."""
    given_words = [*words, "--seconds", "SALAD=0.03", "--tolerance", 1, "--out", out / "bank"]
    start("bank", ["descriptors", *map(str, given_words)])
    return ScoreBank.load(out / "bank", verify=True)


def refusal(out: Path, *words: object) -> str:
    """The sentence that refuses; nothing is left behind."""
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        bank(out, *words)
    assert not (out / "bank").exists()
    assert not list(out.glob(".amusic-*"))
    message = str(caught.value)
    assert "\n" not in message
    return message


def check(made: ScoreBank, atol: float = 1e-6) -> None:
    """Scores in the order of the route."""
    assert made.techniques == ("SALAD",)
    assert made.seconds.tolist() == [0.03]
    np.testing.assert_allclose(made.scores[0], THERE @ HERE.T, atol=atol)


def pair_of_files(folder: Path, *names: str) -> list[object]:
    """--reference and --query of .npy files."""
    here, there = names or ("db.npy", "run.npy")
    cases.write_npy(folder / here, HERE)
    cases.write_npy(folder / there, THERE)
    return ["--reference", f"SALAD={folder / here}", "--query", f"SALAD={folder / there}"]


def images(folder: Path) -> list[object]:
    """--reference-images and --query-images of folders."""
    map_, run = (cases.write_images(folder / "images" / name) for name in ("db", "run"))
    return ["--reference-images", map_, "--query-images", run]


# ---- layouts ------------------------------------------------------------------------------


def test_matrices_in_the_order_of_the_route(tmp_path):
    made = bank(tmp_path, *pair_of_files(tmp_path))
    check(made)
    assert made.source == "descriptors: db.npy, run.npy"
    assert made.tolerance == 1
    assert made.truth.correct(np.arange(PLACES)).all()


@pytest.mark.parametrize("kind", ["float16", "float64", ">f4", "fortran"])
def test_any_floats(tmp_path, kind):
    words = pair_of_files(tmp_path)
    for name in ("db.npy", "run.npy"):
        stored = np.load(tmp_path / name)
        stored = np.asfortranarray(stored) if kind == "fortran" else stored.astype(kind)
        np.save(tmp_path / name, stored)
    check(bank(tmp_path, *words), atol=2e-3 if kind == "float16" else 1e-6)


def test_hloc_two_files_by_name(tmp_path):
    for name, vectors in (("db.h5", HERE), ("run.h5", THERE)):
        cases.write_h5(tmp_path / name, vectors.astype(np.float16))
    words = ["--reference", f"SALAD={tmp_path}/db.h5", "--query", f"SALAD={tmp_path}/run.h5"]
    check(bank(tmp_path, *words), atol=2e-3)
    check(bank(tmp_path, *words, *images(tmp_path)), atol=2e-3)
    lists = []
    for side in ("reference", "query"):
        shuffled = cases.write_list(tmp_path / f"{side}.txt", NAMES[::-1])
        lists += [f"--{side}-images", shuffled]
    reverse = bank(tmp_path, *words, *lists)
    np.testing.assert_allclose(reverse.scores[0], (THERE @ HERE.T)[::-1, ::-1], atol=2e-3)


def test_hloc_one_file_by_prefix(tmp_path):
    file = cases.write_h5(tmp_path / "feats.h5", HERE, below="db/")
    cases.write_h5(file, THERE, below="run/")
    both = ["--reference", f"SALAD={file}", "--query", f"SALAD={file}"]
    check(bank(tmp_path, "--reference", f"SALAD={file}/db", "--query", f"SALAD={file}/run"))
    check(bank(tmp_path, *both, *images(tmp_path)))
    lists = []
    for side, below in (("reference", "db"), ("query", "run")):
        names = [f"{below}/{name}" for name in NAMES]
        lists += [f"--{side}-images", cases.write_list(tmp_path / f"{side}.txt", names)]
    check(bank(tmp_path, *both, *lists))
    assert "is given for the map and for the run" in refusal(tmp_path / "other", *both)


def test_a_name_that_fits_two_prefixes_is_refused(tmp_path):
    file = cases.write_h5(tmp_path / "feats.h5", HERE, below="db/")
    cases.write_h5(file, THERE, below="run/")
    names = cases.write_list(tmp_path / "names.txt", NAMES)
    words = ["--reference", f"SALAD={file}", "--query", f"SALAD={file}"]
    message = refusal(tmp_path, *words, "--reference-images", names, "--query-images", names)
    assert "'img1.jpg' may be 'db/img1.jpg' or 'run/img1.jpg'; give the group" in message


@pytest.mark.parametrize("suffix", ["", ".jpg"])
@pytest.mark.parametrize("with_images", [False, True])
def test_a_file_per_image_in_natural_order(tmp_path, suffix, with_images):
    for folder, vectors in (("db", HERE), ("run", THERE)):
        for name, vector in zip(NAMES, vectors, strict=True):
            cases.write_npy(tmp_path / folder / f"{name[:-4]}{suffix}.npy", vector[None])
    words = ["--reference", f"SALAD={tmp_path / 'db'}", "--query", f"SALAD={tmp_path / 'run'}"]
    check(bank(tmp_path, *words, *(images(tmp_path) if with_images else [])))


def test_vpr_methods_evaluation_is_brought_into_natural_order(tmp_path):
    log = tmp_path / "log"
    cases.write_npy(log / "database_descriptors.npy", cases.by_letters(HERE))
    cases.write_npy(log / "queries_descriptors.npy", cases.by_letters(THERE))
    words = ["--reference", f"SALAD={log}", "--query", f"SALAD={log}"]
    check(bank(tmp_path, *words, *images(tmp_path)))
    by_file = ["--reference", f"SALAD={log / 'database_descriptors.npy'}", *words[2:]]
    check(bank(tmp_path, *by_file, *images(tmp_path)))
    message = refusal(tmp_path / "other", *words)
    assert "string order of the images' paths" in message
    assert "--reference-images DIR" in message


def test_vpr_methods_evaluation_with_its_lists_of_paths(tmp_path):
    words = images(tmp_path)
    order = np.random.default_rng(3).permutation(PLACES)
    for folder in ("db", "run"):
        names = [NAMES[at] for at in order]
        cases.write_list(tmp_path / "images" / f"{folder}_images_paths.txt", names)
    cases.write_npy(tmp_path / "log/database_descriptors.npy", HERE[order])
    cases.write_npy(tmp_path / "log/queries_descriptors.npy", THERE[order])
    log = tmp_path / "log"
    check(bank(tmp_path, "--reference", f"SALAD={log}", "--query", f"SALAD={log}", *words))


def test_patch_netvlad_in_the_order_of_its_lists_with_its_ground_truth(tmp_path):
    words = []
    for side, folder, vectors in (("reference", "db", HERE), ("query", "run", THERE)):
        cases.write_npy(tmp_path / folder / "globalfeats.npy", vectors)
        names = [f"route/{folder}/{name}" for name in NAMES]
        words += [f"--{side}", f"SALAD={tmp_path / folder}"]
        words += [f"--{side}-images", cases.write_list(tmp_path / f"{folder}.txt", names)]
    along = np.stack([2.0 * np.arange(PLACES), np.zeros(PLACES)], axis=1)
    truth = tmp_path / "route_gt.npz"
    np.savez(truth, utmQ=along + [0.0, 1.0], utmDb=along, posDistThr=np.float32(2.5))
    command = [*words, "--ground-truth", truth, "--seconds", "SALAD=1", "--out", tmp_path / "bank"]
    start("bank", ["descriptors", *map(str, command)])
    made = ScoreBank.load(tmp_path / "bank")
    np.testing.assert_allclose(made.scores[0], THERE @ HERE.T, atol=1e-6)
    band = abs(np.subtract.outer(np.arange(PLACES), np.arange(PLACES))) <= 1
    np.testing.assert_array_equal(made.truth.matrix(), band)


def test_gsv_cities_lists_and_ground_truth(tmp_path):
    words = pair_of_files(tmp_path)
    for side, file in (("reference", "x_dbImages.npy"), ("query", "x_qImages.npy")):
        names = np.array([f"{side}/{name}" for name in NAMES])
        words += [f"--{side}-images", cases.write_npy(tmp_path / file, names)]
    truth = np.empty(PLACES, object)
    truth[:] = [np.array([0, q]) if q else np.array([0]) for q in range(PLACES)]
    np.save(tmp_path / "x_gt.npy", truth, allow_pickle=True)
    words += ["--ground-truth", tmp_path / "x_gt.npy", "--seconds", "SALAD=1"]
    command = ["descriptors", *map(str, words), "--out", str(tmp_path / "bank")]
    with pytest.raises(ValueError, match=r"pickled Python objects, .*\(--trust\)"):
        start("bank", command)
    start("bank", [*command, "--trust"])
    made = ScoreBank.load(tmp_path / "bank")
    np.testing.assert_allclose(made.scores[0], THERE @ HERE.T, atol=1e-6)
    for query in range(PLACES):
        assert set(np.flatnonzero(made.truth.matrix()[query])) == {0, query}


def test_ground_truth_by_names_of_lists(tmp_path):
    words = pair_of_files(tmp_path)
    names = [f"@{550000 + 10 * at}@{4180000}@{at}@.jpg" for at in range(PLACES)]
    for side in ("reference", "query"):
        words += [f"--{side}-images", cases.write_list(tmp_path / f"{side}.txt", names)]
    words += ["--truth-by", "position", "--metres", "10", "--seconds", "SALAD=1"]
    start("bank", ["descriptors", *map(str, words), "--out", str(tmp_path / "bank")])
    made = ScoreBank.load(tmp_path / "bank")
    band = abs(np.subtract.outer(np.arange(PLACES), np.arange(PLACES))) <= 1
    np.testing.assert_array_equal(made.truth.matrix(), band)


# ---- several techniques, masks, beside images ------------------------------------------------


def test_two_techniques_each_with_its_metric(tmp_path):
    words = pair_of_files(tmp_path)
    other = [5 * cases.made(seed, size=8) * np.arange(1, PLACES + 1)[:, None] for seed in (3, 4)]
    cases.write_h5(tmp_path / "a.h5", other[0])
    cases.write_h5(tmp_path / "b.h5", other[1])
    words[2:2] = [f"MegaLoc={tmp_path / 'a.h5'}"]
    words += [f"MegaLoc={tmp_path / 'b.h5'}", "--seconds", "MegaLoc=0.5"]
    message = refusal(tmp_path, *words)
    assert "'MegaLoc': its descriptors have lengths from 5 to 60" in message
    made = bank(tmp_path, *words, "--metric", "MegaLoc=l2")
    assert made.techniques == ("SALAD", "MegaLoc")
    np.testing.assert_allclose(made.scores[0], THERE @ HERE.T, atol=1e-6)
    np.testing.assert_allclose(made.scores[1], -cdist(other[1], other[0]), atol=1e-5)
    for metric in ("dot", "cosine"):
        both = bank(tmp_path, *words, "--metric", metric)
        scale = (
            1 if metric == "dot" else np.outer(*[np.linalg.norm(o, axis=1) for o in other[::-1]])
        )
        np.testing.assert_allclose(
            both.scores[1], other[1] @ other[0].T / scale, rtol=1e-5, atol=1e-5
        )


def test_beside_techniques_that_run_here(tmp_path):
    words = pair_of_files(tmp_path)
    folders = images(tmp_path)
    command = ["--reference", folders[1], "--query", folders[3], "--techniques", "hog"]
    command += ["--reference-descriptors", words[1], "--query-descriptors", words[3]]
    command += ["--seconds", "SALAD=0.03", "HOG=0.01", "--tolerance", "1"]
    command += ["--cache", tmp_path / "cache", "--out", tmp_path / "bank"]
    with pytest.raises(ValueError, match="another order by number than by letters"):
        start("bank", ["images", *map(str, command)])
    for side in ("reference", "query"):  # by name
        vectors = HERE if side == "reference" else THERE
        file = cases.write_h5(tmp_path / f"{side}.h5", vectors[::-1], NAMES[::-1])
        command[command.index(f"--{side}-descriptors") + 1] = f"SALAD={file}"
    start("bank", ["images", *map(str, command)])
    made = ScoreBank.load(tmp_path / "bank")
    assert made.techniques == ("HOG", "SALAD")
    assert made.seconds.tolist() == [0.01, 0.03]
    np.testing.assert_allclose(made.scores[1], THERE @ HERE.T, atol=1e-6)


def test_loop_closure_masks_recent_frames(tmp_path):
    vectors = np.concatenate([HERE[: PLACES // 2], HERE[: PLACES // 2]])
    file = cases.write_npy(tmp_path / "drive.npy", vectors)
    pairs = [f"{q},{q - PLACES // 2}" for q in range(PLACES // 2, PLACES)]
    truth = cases.write_list(tmp_path / "loops.csv", ["query,place", *pairs])
    words = ["--reference", f"SALAD={file}", "--query", f"SALAD={file}", "--ground-truth", truth]
    assert "--exclude-recent N" in refusal(tmp_path, *words)
    made = bank(tmp_path, *words, "--exclude-recent", 2)
    past = np.tri(PLACES, k=-3, dtype=bool)
    np.testing.assert_array_equal(np.isneginf(made.scores[0]), ~past)
    np.testing.assert_allclose(made.scores[0][past], (vectors @ vectors.T)[past], atol=1e-6)
    loops = np.arange(PLACES // 2, PLACES)
    np.testing.assert_array_equal(made.scores[0][loops].argmax(axis=1), loops - PLACES // 2)


# ---- refusals ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "told"), [(np.nan, "NaN or infinity"), (np.inf, "NaN or infinity"), (0, "all zeros")]
)
@pytest.mark.parametrize("side", [0, 1])
def test_a_descriptor_that_is_none_is_named(tmp_path, value, told, side):
    words = pair_of_files(tmp_path)
    name = ("db.npy", "run.npy")[side]
    broken = np.load(tmp_path / name)
    broken[7] = value
    np.save(tmp_path / name, broken)
    assert re.search(rf"{name}: descriptor 7 .*{told}", refusal(tmp_path, *words))
    file = cases.write_h5(tmp_path / f"{name}.h5", broken)
    words[2 * side + 1] = f"SALAD={file}"
    at = sorted(NAMES).index("img8.jpg")
    assert re.search(rf"descriptor {at} \(img8.jpg\) .*{told}", refusal(tmp_path, *words))


def test_counts_are_checked_against_the_images(tmp_path):
    words = pair_of_files(tmp_path)
    short = cases.write_list(tmp_path / "short.txt", NAMES[:-1])
    message = refusal(tmp_path, *words, "--reference-images", short)
    assert "db.npy has 12 descriptors for the 11 images" in message
    cases.write_h5(tmp_path / "db.h5", HERE[:-2], NAMES[:-2])
    words[1] = f"SALAD={tmp_path / 'db.h5'}"
    message = refusal(tmp_path, *words, *images(tmp_path))
    assert "has no descriptor of 2 of the 12 images, such as 'img11.jpg'" in message


def wrong_files(folder: Path) -> dict[str, tuple[Path, str]]:
    """Files that hold no descriptors, and what is said of each."""
    cases.write_h5(folder / "mixed.h5", HERE[:3], NAMES[:3])
    cases.write_h5(folder / "mixed.h5", HERE[3:, :-1], NAMES[3:])
    for at, vector in enumerate(HERE):
        cases.write_npy(folder / "mixed" / f"{at}.npy", vector[: 16 - (at == 5)])
    (folder / "text.h5").write_text("version https://git-lfs.github.com/spec/v1\n")
    (folder / "torch.pt").write_bytes(b"PK")
    (folder / "empty").mkdir()
    objects = np.array([[1], [2, 3]], object)
    np.save(folder / "objects.npy", objects, allow_pickle=True)
    import h5py

    with h5py.File(folder / "local.h5", "w") as file:
        file["img1.jpg/keypoints"] = np.zeros((3, 2))
    made = {
        "other size": (cases.write_npy(folder / "wide.npy", cases.made(size=20)), "20"),
        "one vector": (cases.write_npy(folder / "one.npy", HERE[0]), r"shape \(16,\)"),
        "complex": (cases.write_npy(folder / "complex.npy", HERE + 0j), "dtype complex64"),
        "names": (cases.write_npy(folder / "names.npy", np.array(NAMES)), "lists names"),
        "objects": (folder / "objects.npy", "dtype object"),
        "mixed h5": (folder / "mixed.h5", "img4.jpg has 15 numbers, and the others have 16"),
        "mixed npy": (folder / "mixed", r"5\.npy has 15 numbers, and the others have 16"),
        "no h5": (folder / "text.h5", "is no HDF5 file, or damaged"),
        "local features": (folder / "local.h5", "holds no global_descriptor"),
        "no group": (folder / "mixed.h5/db", "holds no global_descriptor below 'db'"),
        "other kind": (folder / "torch.pt", "give .npy, .h5, .hdf5 or a folder"),
        "empty folder": (folder / "empty", "holds no descriptors of the reference"),
        "missing": (folder / "missing.npy", "missing.npy does not exist"),
    }
    return made


WRONG = (
    *("other size", "one vector", "complex", "names", "objects", "mixed h5", "mixed npy", "no h5"),
    *("local features", "no group", "other kind", "empty folder", "missing"),
)


@pytest.mark.parametrize("what", WRONG)
def test_what_holds_no_descriptors_is_refused_in_a_sentence(tmp_path, what):
    files = wrong_files(tmp_path)
    assert set(files) == set(WRONG)
    path, told = files[what]
    words = pair_of_files(tmp_path)
    words[1] = f"SALAD={path}"
    assert re.search(told, refusal(tmp_path, *words))


def test_options_that_do_not_fit_are_refused(tmp_path):
    words = pair_of_files(tmp_path)
    for more, told in (
        (["--metric", "l3"], "unknown metric 'l3': did you mean 'l2'"),
        (["--metric", "SALD=l2"], "did you mean 'SALAD'"),
        (["--reference", f"HOG={tmp_path / 'db.npy'}"], "'HOG' has no descriptors of the run"),
        (["--truth-by", "name"], "names no images; --truth-by name needs --reference-images"),
        (["--order", "x.txt"], "--order goes with --reference-images"),
        (["--seconds", "HOG=1"], "--seconds: unknown technique 'HOG'"),
        (["--reference-images", tmp_path / "missing"], "missing does not exist"),
    ):
        assert told in refusal(tmp_path, *words, *more)


def test_32_h5py_that_is_not_installed_is_named_with_the_command(tmp_path, monkeypatch):
    file = cases.write_h5(tmp_path / "db.h5", HERE)
    words = pair_of_files(tmp_path)
    words[1] = f"SALAD={file}"
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert 'install it: pip install "amusic-gym[hdf5]"' in refusal(tmp_path, *words)


# ---- arithmetic and memory ----------------------------------------------------------------------

VECTORS = arrays.arrays(
    np.float32,
    (5, 3),
    elements=st.floats(-100, 100, width=32).map(lambda x: np.float32(round(x, 2))),
)


@settings(deadline=None)
@given(VECTORS, VECTORS)
def test_metrics_are_scipys(queries, places):
    np.testing.assert_allclose(
        similarity(queries, places, "l2"), -cdist(queries, places), atol=1e-5, rtol=1e-6
    )
    wide, here = queries.astype(float), places.astype(float)
    np.testing.assert_allclose(similarity(queries, places, "dot"), wide @ here.T, atol=0.02)
    if queries.any(axis=1).all() and places.any(axis=1).all():
        expected = 1 - cdist(wide, here, "cosine")
        np.testing.assert_allclose(similarity(queries, places, "cosine"), expected, atol=1e-5)


def test_lengths_are_looked_at_to_the_end(tmp_path):
    words = pair_of_files(tmp_path)
    many = cases.made(5, count=200)
    many[150] *= 3
    np.save(tmp_path / "db.npy", many)
    np.save(tmp_path / "run.npy", cases.made(6, count=200))
    assert "lengths from 1 to 3, so metrics rank differently" in refusal(tmp_path, *words)
    assert bank(tmp_path, *words, "--metric", "dot").shape == (1, 200, 200)


def test_blocks_do_not_change_the_scores(tmp_path, monkeypatch):
    from amusic_gym.banks import descriptors

    words = pair_of_files(tmp_path)
    whole = bank(tmp_path, *words).scores.copy()
    monkeypatch.setattr(descriptors, "_NUMBERS", 5 * cases.SIZE)
    monkeypatch.setattr(descriptors, "_PLACES", 5 * cases.SIZE)
    sides = [from_npy(tmp_path / name) for name in ("db.npy", "run.npy")]
    blocks = list(DescriptorPair("SALAD", *sides).score_rows())
    assert [len(block) for block in blocks] == [5, 5, 2]
    np.testing.assert_allclose(np.concatenate(blocks), whole[0], atol=1e-6)


def test_memory_does_not_grow_with_the_map(tmp_path, monkeypatch):
    import tracemalloc

    from amusic_gym.banks import descriptors

    monkeypatch.setattr(descriptors, "_NUMBERS", 2**14)
    monkeypatch.setattr(descriptors, "_PLACES", 2**14)
    peaks = []
    for count in (500, 4000):
        path = cases.write_npy(tmp_path / f"{count}.npy", cases.made(1, count, 64))
        pair = DescriptorPair("A", from_npy(path), from_npy(path))
        tracemalloc.start()
        try:
            rows = next(pair.score_rows())
            assert rows.shape == (2**14 // max(count, 64), count)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert max(peaks) < 2**20  # the map of 4000 is as large
    assert peaks[1] < 1.5 * peaks[0]
