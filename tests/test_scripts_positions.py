"""Positions and videos on the command line: `bank.py images`, as a user types it."""

from __future__ import annotations

import tempfile
from functools import partial

import cv2
import numpy as np
import pytest
from extraction_cases import make_images

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.routes.position_files import read_track
from amusic_gym.routes.video import VideoFile, VideoWriter
from amusic_gym.routes.video_frames import frames_of

pytestmark = pytest.mark.slow

COUNT = 8


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Folders ``map`` and ``run``, the run as a video, positions ten metres apart, a TMPDIR."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    for seed, name in enumerate(("map", "run")):
        make_images(tmp_path / name, COUNT, seed, size=(48, 64))
    for name in ("map", "run"):
        with VideoWriter(tmp_path / f"{name}.avi", 10) as writer:
            for path in sorted((tmp_path / name).iterdir()):
                writer.write(np.ascontiguousarray(cv2.imread(str(path))[..., ::-1]))
    rows = [f"{at},{500000 + 10 * at},6955000" for at in range(COUNT)]
    (tmp_path / "places.csv").write_text("\n".join(["frame,easting,northing", *rows]))
    return tmp_path


@pytest.fixture
def run(amusic, world):
    """`bank.py images` on that world: exit status, stdout and stderr."""

    def command(*given: object, reference: str = "map", query: str = "run") -> tuple[int, str, str]:
        return partial(amusic, "bank")(
            *("images", "--reference", world / reference, "--query", world / query),
            *("--techniques", "extraction_cases:Tiny", "--cache", world / "cache"),
            *("--seconds", "Tiny=1", "--out", world / "bank", *given),
        )

    return command


def test_positions_make_ground_truth_and_tell_the_tolerance(run, world):
    both = [
        "--reference-positions",
        world / "places.csv",
        "--query-positions",
        world / "places.csv",
    ]
    code, out, err = run(*both, "--within", 20, "--plot", world / "tracks.png")
    assert (code, err) == (0, "")
    assert f"right within 20 m: {COUNT} of {COUNT} frames have a place; tolerance 2 places" in out
    bank = ScoreBank.load(world / "bank")
    assert bank.truth.matrix()[3].tolist() == [0, 1, 1, 1, 1, 1, 0, 0]
    assert cv2.imread(str(world / "tracks.png")).shape[0] > 100


def test_a_video_is_a_map_or_a_run_like_the_folder_of_its_frames(run, world):
    frames = world / "frames"
    frames.mkdir()
    video = VideoFile(world / "run.avi")
    for at in range(COUNT):
        assert cv2.imwrite(str(frames / f"{at}.png"), video.read(at))
    found = []
    for query in ("run.avi", "frames"):
        code, _, err = run("--tolerance", 1, query=query)
        assert (code, err) == (0, "")
        found.append(ScoreBank.load(world / "bank"))
    np.testing.assert_array_equal(found[0].scores, found[1].scores)
    assert found[0].source == "images: run on map"
    assert not list((world / "tmp").iterdir())
    code, _, err = run("--tolerance", 1, "--every", 3, reference="map.avi", query="run.avi")
    assert (code, err) == (0, "")
    assert ScoreBank.load(world / "bank").shape == (1, 3, 3)


def test_a_video_by_metres_has_frames_so_far_apart(run, world):
    both = [
        "--reference-positions",
        world / "places.csv",
        "--query-positions",
        world / "places.csv",
    ]
    for reference, query in (("map.avi", "run"), ("map", "run.avi")):
        thinned = ["--every-metres", 20, "--within", 15]
        code, out, err = run(*both, *thinned, reference=reference, query=query)
        assert (code, err) == (0, "")
        bank = ScoreBank.load(world / "bank")
        assert bank.shape == (1, COUNT // 2, COUNT // 2)
        np.testing.assert_array_equal(bank.truth.matrix(), np.eye(COUNT // 2))
        assert "right within 15 m: 4 of 4 frames have a place; tolerance 0 places" in out


def test_descriptors_from_elsewhere_take_positions_too(amusic, world):
    for seed, name in enumerate(("map", "run")):
        np.save(world / f"{name}.npy", np.random.default_rng(seed).random((COUNT, 5), np.float32))
    given = ["--seconds", "Own=1", "--metric", "cosine", "--within", 10, "--out", world / "bank"]
    for side, name in (("reference", "map"), ("query", "run")):
        given += [f"--{side}", f"Own={world / name}.npy", f"--{side}-images", world / name]
        given += [f"--{side}-positions", world / "places.csv"]
    code, _, err = amusic("bank", "descriptors", *given)
    assert (code, err) == (0, "")
    bank = ScoreBank.load(world / "bank")
    assert (bank.tolerance, np.diff(bank.truth.indptr).tolist()) == (1, [2, *[3] * 6, 2])


def test_frames_of_a_video_lie_where_their_time_stamps_say(world, tmp_path):
    (tmp_path / "t.csv").write_text("time,x,y\n0,0,0\n0.7,70,0\n")
    track = read_track(tmp_path / "t.csv")
    with frames_of(world / "run.avi", fps=5, track=track) as (folder, positions):
        assert len(folder) == COUNT // 2
        assert positions is not None
        np.testing.assert_allclose(positions.metres[:, 0], [0, 20, 40, 60], atol=1e-3)
    assert not list((world / "tmp").iterdir())


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--within", 5, "--tolerance", 1], "--within only goes with --truth-by position"),
        (["--plot", "x.png", "--tolerance", 1], "--plot only goes with --truth-by position"),
        (["--every", 2, "--tolerance", 1], "--reference and --query are none"),
        (["--every-metres", 2, "--tolerance", 1], "--every-metres needs the positions of"),
        (["--reference-positions", "WORLD/places.csv"], "does not say where it is"),
        (["--reference-positions", "WORLD/none.csv"], "none.csv does not exist"),
        (["--reference-positions", "exif"], "EXIF data has no position of 8 images"),
        (["--query-positions", "WORLD/times.csv"], "that are no time; add a column 'name'"),
        (
            ["--query", "WORLD/run.avi", "--every", 2, "--fps", 1, "--tolerance", 1],
            "one of the two",
        ),
        (["--query", "WORLD/run.avi", "--skip-damaged", "--tolerance", 1], "are of image files"),
        (
            ["--query", "WORLD/run.avi", "--query-positions", "WORLD/names.csv"],
            "neither frame numb",
        ),
        (["--query", "WORLD/empty.mp4", "--tolerance", 1], "empty.mp4 is empty; give a video"),
    ],
)
def test_bad_input_is_refused_in_one_line(run, world, given, words):
    (world / "times.csv").write_text("time,x,y\n0,0,0\n")
    (world / "names.csv").write_text("name,x,y\na,0,0\n")
    (world / "empty.mp4").touch()
    for path in (world / "run").iterdir():
        path.rename(path.with_name(f"img{path.name}"))
    code, _, err = run(*[str(word).replace("WORLD", str(world)) for word in given])
    assert code == 2
    assert err.count("\n") == 1
    assert words in err
    assert not (world / "bank").exists()
    assert not list((world / "tmp").iterdir())
