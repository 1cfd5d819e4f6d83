"""scripts/bank.py images and render."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from extraction_cases import make_images

from amusic_gym.banks.bank import GroundTruth, ScoreBank
from amusic_gym.extraction import BLOCK
from amusic_gym.routes.images import read_image

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
COUNT = BLOCK + 2


def bank(*arguments: object, cwd: Path | None = None):
    """`bank.py` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-W", "error", str(ROOT / "scripts" / "bank.py"), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT / "tests/support")},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=cwd,
    )


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("images")
    return make_images(root / "map", COUNT), make_images(root / "run", COUNT, seed=1)


@pytest.fixture
def run(amusic):
    """`bank.py images` in this process: exit status, stdout and stderr."""
    return partial(amusic, "bank")


@pytest.fixture
def arguments(folders, tmp_path):
    """The least that the command needs; the cache is the test's own."""
    return [
        *("images", "--reference", folders[0], "--query", folders[1]),
        *("--techniques", "extraction_cases:Tiny", "--cache", tmp_path / "cache"),
        *("--out", tmp_path / "bank"),
    ]


def test_executors_write_the_same_bytes_and_a_line_per_technique(arguments, tmp_path):
    both = ["--techniques", "extraction_cases:Tiny,extraction_cases:TwoSided", "--name", "same"]
    seconds = ["--tolerance", 1, "--seconds", "Tiny=0.5", "twosided=0.25"]
    found = []
    for executor in ("serial", "process:2"):
        place = tmp_path / executor.replace(":", "")
        own = ["--cache", place / "cache", "--out", place / "bank", "--executor", executor]
        done = bank(*arguments, *both, *seconds, *own)
        assert (done.returncode, done.stderr) == (0, "")
        lines = done.stdout.splitlines()
        assert [line.split(":")[0] for line in lines[:2]] == ["Tiny", "TwoSided"]
        assert lines[2] == f"{place / 'bank'}: 2 techniques, {COUNT} queries, {COUNT} references"
        found.append([file.read_bytes() for file in sorted((place / "bank").iterdir())])
    assert found[0] == found[1]
    assert ScoreBank.load(place / "bank").seconds.tolist() == [0.5, 0.25]


def test_the_same_command_twice_writes_the_same_bank(run, arguments, tmp_path):
    written = []
    for _ in range(2):
        status, out, err = run(*arguments, "--tolerance", 1)
        assert (status, err) == (0, "")
        written.append((tmp_path / "bank" / "bank.json").read_bytes())
    assert written[0] == written[1]
    assert "all from the cache" in out


def truth_of(place: Path):
    return ScoreBank.load(place / "bank").truth


def test_ground_truth_by_name_position_and_file(run, arguments, folders, tmp_path):
    assert run(*arguments, "--truth-by", "name", "--tolerance", 0)[0] == 0
    assert truth_of(tmp_path).places.tolist() == list(range(COUNT))
    assert ScoreBank.load(tmp_path / "bank").tolerance == 0

    places = np.arange(COUNT)[::-1]
    np.savetxt(tmp_path / "truth.txt", places, fmt="%d")
    given = ["--ground-truth", tmp_path / "truth.txt", "--tolerance", 0]
    assert run(*arguments, *given)[0] == 0
    assert truth_of(tmp_path).places.tolist() == places.tolist()

    for folder in folders:
        named = tmp_path / folder.name
        named.mkdir()
        for at, image in enumerate(sorted(folder.iterdir())[:4]):
            (named / f"@{500000 + 10 * at}@4000000@@@@@{at}@@@@@@@@.png").write_bytes(
                image.read_bytes()
            )
    ours = ["--reference", tmp_path / "map", "--query", tmp_path / "run"]
    ours += ["--truth-by", "position", "--metres", 10]
    assert run(*arguments, *ours)[0] == 0
    assert np.diff(truth_of(tmp_path).indptr).tolist() == [2, 3, 3, 2]
    status, _, err = run(*arguments, *ours, "--tolerance", 3)
    assert status == 2
    assert "tolerance is 3, but the ground truth lists neighbouring places itself" in err


def test_an_order_can_be_given_for_both_folders_or_for_each(run, arguments, folders, tmp_path):
    names = sorted(path.name for path in folders[0].iterdir())
    for name, listed in (("forth", names[:5]), ("back", names[4::-1])):
        (tmp_path / name).write_text("\n".join(listed))
    given = [*arguments, "--truth-by", "name", "--tolerance", 0, "--order", tmp_path / "back"]
    assert run(*given)[0] == 0
    assert truth_of(tmp_path).places.tolist() == [0, 1, 2, 3, 4]
    assert run(*given, tmp_path / "forth")[0] == 0
    assert truth_of(tmp_path).places.tolist() == [4, 3, 2, 1, 0]
    status, _, err = run(*given, tmp_path / "forth", tmp_path / "forth")
    assert (status, err) == (2, "bank.py: --order has 3 files; give one, or one for each folder\n")


def test_damaged_images_are_named_together_or_left_out(run, arguments, folders, tmp_path):
    spoiled = tmp_path / "spoiled"
    spoiled.mkdir()
    for at, image in enumerate(sorted(folders[1].iterdir())[:6]):
        (spoiled / image.name).write_bytes(image.read_bytes()[: 40 if at in (1, 3) else None])
    given = [*arguments, "--query", spoiled, "--tolerance", 0, "--truth-by", "index"]
    status, _, err = run(*given)
    assert status == 2
    assert err.startswith("bank.py: 2 images cannot be used: ")
    with pytest.warns(UserWarning, match=r"2 damaged images are left out"):
        assert run(*given, "--skip-damaged")[0] == 0
    assert truth_of(tmp_path).places.tolist() == [0, 2, 4, 5]


def test_copies_of_a_true_place_may_count(run, arguments, folders, tmp_path):
    stopped = tmp_path / "stopped"
    stopped.mkdir()
    for at, image in enumerate(sorted(folders[0].iterdir())[:4]):
        (stopped / f"{at}.png").write_bytes(image.read_bytes())
    (stopped / "2.png").write_bytes((stopped / "1.png").read_bytes())
    ours = ["--reference", stopped, "--query", stopped, "--tolerance", 0]
    with (
        pytest.warns(UserWarning, match="repeated in frames 1 to 2"),
        pytest.warns(UserWarning, match="on the map too, byte for byte: 4 of 4; "),
    ):
        assert run(*arguments, *ours, "--copies")[0] == 0
    assert truth_of(tmp_path).places.tolist() == [0, 1, 2, 1, 2, 3]


def test_43_folders_of_different_length_need_to_be_told_what_is_true(run, arguments, folders):
    for reference, query in (folders, folders[::-1]):
        short = query.parent / f"{query.name}-short"
        short.mkdir()
        for image in sorted(query.iterdir())[:-1]:
            (short / image.name).write_bytes(image.read_bytes())
        for pair in ((reference, short), (short, reference)):
            ours = [*arguments, "--reference", pair[0], "--query", pair[1], "--tolerance", 1]
            status, _, err = run(*ours)
            assert status == 2
            assert f"has {COUNT - 1} images" in err or f"has {COUNT} images" in err
            for way in ("--truth-by name", "--truth-by position", "--ground-truth FILE"):
                assert way in err
        ours = [*arguments, "--reference", reference, "--query", short, "--tolerance", 1]
        assert run(*ours, "--truth-by", "index")[0] == 0  # who insists


def test_42_pairs_of_file_names_and_a_tolerance(run, arguments, folders, tmp_path):
    names = [sorted(path.name for path in folder.iterdir()) for folder in folders]
    pairs = [f"{query},{place}\n" for query, place in zip(names[1], names[0][::-1], strict=True)]
    (tmp_path / "pairs.csv").write_text("query,reference\n" + "".join(pairs))
    given = [*arguments, "--ground-truth", tmp_path / "pairs.csv"]
    for tolerance in (0, 2):
        assert run(*given, "--tolerance", tolerance)[0] == 0
        loaded = ScoreBank.load(tmp_path / "bank")
        expected = GroundTruth.from_places(np.arange(COUNT)[::-1], tolerance, COUNT)
        np.testing.assert_array_equal(loaded.truth.places, expected.places)
        assert loaded.tolerance == tolerance


def test_a_data_set_by_name(run, arguments, folders, tmp_path):
    (tmp_path / "nordland").mkdir()
    for folder, name in zip(folders, ("summer", "winter"), strict=True):
        (tmp_path / "nordland" / name).symlink_to(folder)
    found = ["images", "--dataset", "nordland_winter", "--root", tmp_path, *arguments[5:]]
    status, _, err = run(*found)
    assert status == 2
    assert f"{COUNT} images, but the paper used 1000" in err
    assert run(*found, "--images", 10, "--first", 3, "--step", 2)[0] == 0
    loaded = ScoreBank.load(tmp_path / "bank")
    assert (loaded.shape, loaded.tolerance) == ((1, 10, 10), 1)
    assert loaded.name == "nordland_winter"
    assert run(*found, "--images", COUNT, "--tolerance", 3)[0] == 0
    assert ScoreBank.load(tmp_path / "bank").tolerance == 3
    for option in ("--reference", "--query", "--ground-truth"):
        status, _, err = run(*found, option, tmp_path)
        assert (status, err.count("\n")) == (2, 1)
        assert f"{option} does not go with --dataset" in err
    status, _, err = run(*found[:3], *found[5:])
    assert status == 2
    assert "needs --root DIR" in err


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([], "give --tolerance N"),
        (["--tolerance", -1], "tolerance is -1"),
        (["--techniques", "hogg"], "unknown technique 'hogg': did you mean 'hog'?"),
        (["--techniques", "nowhere:Mine"], "technique 'nowhere:Mine' cannot be imported"),
        (["--reference", "nowhere", "--tolerance", 1], "nowhere does not exist"),
        (["--techniques", "extraction_cases:Signalling"], "cannot be made: TypeError"),
        (["--executor", "process:0", "--tolerance", 1], "give at least 1"),
        (["--dataset", "berlin", "--root", ".", "--step", 0], "does not go with --dataset"),
        (["--weights", "hog=x"], "--weights: unknown technique 'hog'"),
        (["--weights", "tiny=no.file"], "takes no weights; leave out no.file"),
        (["--seconds", "Tiny=fast", "--tolerance", 1], "Tiny=fast: 'fast' is not a number"),
        (["--seconds", "Tiny=nan", "--tolerance", 1], "seconds of technique 'Tiny' are nan"),
        (["--seconds", "HOG=1"], "--seconds: unknown technique 'HOG'"),
        (["--executor", "rya", "--tolerance", 1], "unknown executor 'rya': did you mean 'ray'"),
        (["--ground-truth", "no.txt"], "no.txt does not exist"),
        (["--images", 3], "--images only goes with --dataset"),
        (["--out", ROOT, "--tolerance", 1], "holds other files"),
        (["--truth-by", "names"], "invalid choice: 'names'"),
        (["--metres", 3, "--tolerance", 1], "--within only goes with --truth-by position"),
        (["--truth-by", "name", "--ground-truth", "f", "--tolerance", 1], "give one of the two"),
        (["--tolernce", 3], "did you mean '--tolerance'"),
    ],
)
def test_bad_arguments_are_refused_in_one_line_before_any_work(
    run, arguments, tmp_path, given, message
):
    status, out, err = run(*arguments, *given)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert not list(tmp_path.iterdir())


def test_a_module_of_the_current_directory_is_found_by_workers_too(folders, tmp_path):
    """And what it raises is the same line, in this process and in others."""
    (tmp_path / "module_of_mine.py").write_text(
        "import extraction_cases\n"
        "from helper_of_mine import name\n"
        "class Mine(extraction_cases.Tiny):\n"
        "    name = name\n"
        "class Boom(Mine):\n"
        "    def match(self, query, references):\n"
        "        raise NotImplementedError\n"
    )
    (tmp_path / "helper_of_mine.py").write_text("name = 'Mine'\n")
    given = ["images", "--reference", folders[0], "--query", folders[1], "--tolerance", 1]
    given += ["--cache", tmp_path / "cache", "--executor", "process:2", "--out", tmp_path / "bank"]
    done = bank(*given, "--techniques", "module_of_mine:Mine", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert ScoreBank.load(tmp_path / "bank").techniques == ("Mine",)
    done = bank(*given, "--techniques", "module_of_mine:Boom", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "technique 'Mine', matching a query of" in done.stderr
    assert "NotImplementedError (module_of_mine.py:7)" in done.stderr


def test_counts_of_a_data_set_are_refused_by_their_options(run, tmp_path):
    given = ["images", "--dataset", "berlin", "--root", tmp_path, "--techniques", "hog"]
    for option, least in (("--images", 1), ("--first", 0), ("--step", 1)):
        status, _, err = run(*given, option, least - 1, "--out", tmp_path / "bank")
        assert (status, err.count("\n")) == (2, 1)
        assert f"{option} is {least - 1}; give a whole number >= {least}" in err


# ---- render ------------------------------------------------------------------------------------


def test_a_rendered_route_becomes_a_bank(run, tmp_path):
    route = ["--places", 3, "--seed", 2, "--size", "48x32", "--kind", "rail"]
    given = ["render", "--condition", "winter, night,winter", *route, "--out", tmp_path / "route"]
    status, out, err = run(*given)
    assert (status, err) == (0, "")
    folders = [tmp_path / "route" / name for name in ("reference", "winter", "night")]
    assert out.splitlines() == [f"{folder}: 3 images" for folder in folders]
    image = read_image(folders[1] / "0002.jpg")
    assert image.shape == (32, 48, 3)
    status, out, err = run(
        *("images", "--reference", folders[0], "--query", folders[2], "--tolerance", 0),
        *("--techniques", "extraction_cases:Tiny", "--cache", tmp_path / "cache"),
        *("--out", tmp_path / "bank"),
    )
    assert (status, err) == (0, "")
    assert ScoreBank.load(tmp_path / "bank").shape == (1, 3, 3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--condition", "wintre"], "did you mean 'winter'"),
        (["--condition", "day", "--size", "big"], "--size 'big' is not of the form WIDTHxHEIGHT"),
        (["--condition", "day", "--size", "99x1"], "--size 99x1: give at least 16x16 pixels"),
        (["--condition", "day", "--places", 0], "places is 0"),
        (["--condition", "day", "--seed", -1], "-1"),
        (["--condition", "day", "--kind", "rial"], "did you mean 'rail'"),
        ([], "--condition"),
    ],
)
def test_what_cannot_be_rendered_is_refused_in_one_line(run, tmp_path, given, message):
    status, out, err = run("render", *given, "--out", tmp_path / "route")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert not (tmp_path / "route").exists()
