"""scripts/navigate.py: a drive along images, a video or a camera, as a user types it."""

from __future__ import annotations

import csv
import importlib
import re
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from amusic_baselines import make_policy

from amusic_gym.cli import drive
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.extraction import extract
from amusic_gym.routes.video import VideoFile, VideoWriter
from amusic_gym.techniques import Technique

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"
PLACES, FRAMES = 12, 8
COUNTING = f"{__name__}:Counting"


class Counting(Technique):
    """A technique that counts its queries, and stops the drive at one if asked."""

    name = "Counting"
    queries = 0
    stop_at: int | None = None

    def describe(self, image):
        small = cv2.resize(image, (16, 16), interpolation=cv2.INTER_AREA).ravel()
        centred = small.astype(np.float32) - small.mean()
        return centred / np.linalg.norm(centred)

    def describe_query(self, image):
        Counting.queries += 1
        if Counting.queries == Counting.stop_at:
            raise KeyboardInterrupt
        return self.describe(image)


def views(count: int) -> list[np.ndarray]:
    """Views (60, 80, 3) along a wall of blobs."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.integers(0, 255, (60, 80 + 40 * PLACES, 3), np.uint8), (0, 0), 4)
    wall = cv2.normalize(wall, None, 0, 255, cv2.NORM_MINMAX)
    return [np.ascontiguousarray(wall[:, 40 * i : 40 * i + 80]) for i in range(count)]


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Path:
    """Folders ``map`` and ``run``, the run as ``run.avi`` too, and descriptors in ``cache``."""
    folder = tmp_path_factory.mktemp("world")
    rng = np.random.default_rng(1)
    for name, count in (("map", PLACES), ("run", FRAMES)):
        (folder / name).mkdir()
        for i, view in enumerate(views(count)):
            noise = rng.normal(0, 12, view.shape) if name == "run" else 0
            image = np.clip(view + noise, 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / name / f"img{i}.png"), image)
    with VideoWriter(folder / "run.avi", 10) as writer:
        for view in views(FRAMES):
            writer.write(view[..., ::-1].copy())
    np.save(folder / "truth.npy", np.arange(FRAMES))
    (folder / "garbage.mp4").write_bytes(b"garbage" * 99)
    return folder


@pytest.fixture
def navigate(world, monkeypatch, amusic):
    """Runs the script in this process; gives its exit status, stdout and stderr."""
    monkeypatch.setattr(Counting, "queries", 0)
    monkeypatch.setattr(Counting, "stop_at", None)

    def run(*extra: str, **changes: str | None) -> tuple[int, str, str]:
        given = {
            "reference": f"{world}/map",
            "query": f"{world}/run",
            "policy": "subset:HOG",
            "techniques": "hog",
            "seconds": "HOG=0.01",
            "cache": f"{world}/cache",
        } | changes
        words = [w for name, v in given.items() if v is not None for w in (f"--{name}", *v.split())]
        return amusic("navigate", *words, *extra)

    return run


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def lines_of(out: str) -> list[str]:
    """The lines of frames."""
    return [line for line in out.splitlines() if re.match(r" *\d+ +(\d+|-)[ !]", line)]


# ---- what it prints and writes -----------------------------------------------------------


def test_every_frame_is_an_aligned_line_and_the_end_a_summary(navigate):
    code, out, err = navigate(tolerance="0")  # exact places: else any within the tolerance is right
    assert (code, err) == (0, "")
    lines = lines_of(out)
    assert [line.split()[:2] for line in lines] == [[str(i), str(i)] for i in range(FRAMES)]
    assert {line.index("HOG") for line in lines} == {lines[0].index("HOG")}
    header = next(line for line in out.splitlines() if line.endswith("techniques"))
    assert header.index("techniques") == lines[0].index("HOG")
    assert header.split() == ["frame", "place", "confidence", "p", "ms", "techniques"]
    summary = out[out.index(f"{FRAMES} frames, ") :]
    rate, per_frame, reading = (
        float(n) for n in re.findall(r"([\d.]+)(?: frames/s| ms per| ms to)", summary)
    )
    assert rate == pytest.approx(1000 / (per_frame + reading), rel=0.05)
    name, share, each = summary.splitlines()[-1].split()
    assert (name, float(share)) == ("HOG", 1.0)
    assert 0 < float(each) < per_frame


def test_quiet_prints_the_summary_only(navigate):
    code, out, _ = navigate("--quiet")
    assert code == 0
    assert not lines_of(out)
    assert out.strip().startswith(f"{FRAMES} frames, ")


@pytest.mark.parametrize("policy", ["amusic", "music", "random:0.5", "raw:HOG", "cascade"])
def test_the_trace_is_that_of_a_bank_of_the_same_images(navigate, world, tmp_path, policy):
    trace = tmp_path / "new" / "trace.csv"
    seconds = {"HOG": 0.01, "Counting": 0.02}
    code, *_ = navigate(
        "--quiet",
        techniques=f"hog,{COUNTING}",
        seconds="HOG=0.01 Counting=0.02",
        policy=policy,
        trace=str(trace),
        seed="3",
    )
    assert code == 0
    bank = extract(
        world / "map", world / "run", ["hog", COUNTING], tolerance=2, seconds=seconds,
        ground_truth=np.arange(8), cache=world / "cache",
    )  # fmt: skip
    from amusic_gym.policies.protocol import Context

    made = make_policy(policy, Context.of(bank, statistic="evidence", seed=3))
    expected = rollout(made, bank, name=policy)
    rows = table(trace)
    assert [int(row["prediction"]) for row in rows] == expected.predictions.tolist()
    assert [float(row["confidence"]) for row in rows] == expected.confidence.tolist()
    ran = [[name in row["techniques"].split("+") for name in bank.techniques] for row in rows]
    assert ran == expected.ran.tolist()
    assert {row["correct"] for row in rows} == {""}  # nobody gave the truth
    assert all((float(row["HOG_milliseconds"]) > 0) == on[0] for row, on in zip(rows, ran))  # noqa: B905


def test_what_is_turned_off_reaches_the_policy(navigate, monkeypatch):
    seen = []
    script = importlib.import_module("amusic_gym.cli.navigate")
    live = script.navigate

    def watched(policy, route, **options):
        seen.append({name: options[name] for name in ("statistic", "carry", "discount")})
        return live(policy, route, **options)

    monkeypatch.setattr(script, "navigate", watched)
    for extra in ((), ("--no-carry",), ("--no-discount", "--no-carry")):
        assert navigate("--quiet", *extra, frames="2")[0] == 0
    told = [(each["carry"], each["discount"]) for each in seen[1::2]]  # after the warm-up
    assert told == [(None, None), (False, None), (False, False)]
    assert seen[0::2] == seen[1::2]


def test_what_the_policy_does_not_activate_is_not_computed(navigate):
    """One run warms the technique up; it may be done twice, to bring its libraries in line."""
    code, out, _ = navigate(techniques=f"hog,{COUNTING}", seconds="HOG=1 Counting=2")
    assert code == 0
    assert out.splitlines()[-1].split() == ["Counting", "0.00", "-"]
    assert 1 <= Counting.queries <= 2


def test_everything_is_warm_before_the_first_frame(navigate):
    code, *_ = navigate(
        techniques=COUNTING, policy="music", seconds="Counting=1", **{"frames": "1"}
    )
    assert code == 0
    assert Counting.queries >= 1 + 2 + 1  # alone, on two frames of the map, and the drive


def test_costs_that_are_not_given_are_measured(navigate):
    code, out, _ = navigate(techniques=f"hog,{COUNTING}", policy="single:Counting", seconds="HOG=1")
    assert code == 0
    assert Counting.queries > FRAMES + 5
    assert out.splitlines()[-1].split()[:2] == ["Counting", "1.00"]


def test_right_and_wrong_are_told_where_the_truth_is_given(navigate, world, tmp_path):
    wrong = np.arange(FRAMES)
    wrong[5] = 0
    np.save(tmp_path / "truth.npy", wrong)
    trace = tmp_path / "trace.csv"
    code, out, _ = navigate(
        **{"ground-truth": str(tmp_path / "truth.npy"), "trace": str(trace), "tolerance": "0"}
    )
    assert code == 0
    assert [("!" in line) for line in lines_of(out)] == [i == 5 for i in range(FRAMES)]
    assert "right places: 87.5%" in out
    assert [row["correct"] for row in table(trace)] == list("11111011")


# ---- where frames come from --------------------------------------------------------------


def test_a_video_is_driven_like_a_folder(navigate, world):
    code, out, err = navigate(query=f"{world}/run.avi", tolerance="0")
    assert (code, err) == (0, "")
    assert [line.split()[1] for line in lines_of(out)] == [str(i) for i in range(FRAMES)]


def test_frames_stop_the_drive(navigate, world):
    for query in ("run", "run.avi"):
        _, out, _ = navigate("--frames", "3", query=f"{world}/{query}")
        assert len(lines_of(out)) == 3
        assert "\n3 frames, " in out


def test_a_number_is_a_camera(navigate, monkeypatch):
    class FakeCamera:
        length, random_access = None, False

        def __init__(self, number: int) -> None:
            self.name, self.closed = f"camera {number}", False
            cameras.append(self)

        def read(self, frame: int):
            return views(FRAMES)[frame] if frame < 4 else None

        def rewind(self) -> None:
            """Nothing to do."""

        def close(self) -> None:
            self.closed = True

    cameras: list[FakeCamera] = []
    monkeypatch.setattr(importlib.import_module("amusic_gym.cli.navigate"), "Camera", FakeCamera)
    code, out, _ = navigate(query="3")
    assert code == 0
    assert len(lines_of(out)) == 4
    assert [(camera.name, camera.closed) for camera in cameras] == [("camera 3", True)]


def test_42_ground_truth_of_vprbench_is_read_with_trust(navigate, world, tmp_path):
    rows = np.empty((FRAMES, 2), object)
    for frame in range(FRAMES):
        rows[frame] = frame, [frame, frame + 1]
    np.save(tmp_path / "truth.npy", rows, allow_pickle=True)
    given = {"ground-truth": str(tmp_path / "truth.npy")}
    code, _, err = navigate(**given)
    assert code == 2
    assert "pass trust=True (--trust)" in err
    code, out, err = navigate("--trust", **given)
    assert (code, err) == (0, "")
    code, _, err = navigate("--trust", **given, tolerance="5")
    assert code == 2
    assert "tolerance is 5, but the ground truth lists neighbouring places" in err


# ---- pictures ----------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_the_video_holds_a_picture_of_every_frame(navigate, world, tmp_path, suffix):
    film = tmp_path / f"film{suffix}"
    truth = {"ground-truth": f"{world}/truth.npy", "tolerance": "0"}
    code, *_ = navigate("--quiet", video=str(film), **truth)
    assert code == 0
    source = VideoFile(film)
    pictures = [source.read(i) for i in range(FRAMES)]
    assert source.length == FRAMES
    for i, picture in enumerate(pictures):
        for left in (71, 545):  # camera and matched place show the same view
            shown = cv2.resize(picture[58:316, left : left + 344], (80, 60)).astype(float)
            assert np.abs(shown - views(FRAMES)[i]).mean() < 25
    assert list(tmp_path.iterdir()) == [film]


def test_the_window_shows_the_drive_and_closing_it_ends_it(navigate, monkeypatch):
    pygame = pytest.importorskip("pygame")
    shown = []
    window = importlib.import_module("amusic_gym.envs.window")
    show = window.Window.show

    def close_at_third(self, picture) -> None:
        shown.append(picture.shape)
        if len(shown) == 3:
            pygame.event.post(pygame.event.Event(pygame.QUIT))
        show(self, picture)

    monkeypatch.setattr(window.Window, "show", close_at_third)
    code, out, _ = navigate("--show")
    assert code == 0
    assert shown == [(540, 960, 3)] * 3
    assert "\n3 frames, " in out
    assert pygame.display.get_surface() is None


def test_32_without_pygame_the_refusal_names_the_command(navigate, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "pygame" else find(name, *a)
    )
    code, out, err = navigate("--show")
    assert (code, out) == (2, "")
    assert re.fullmatch(r'navigate\.py: .*pip install "amusic-gym\[human\]"\n', err)


# ---- refusals ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reference": "no/such"}, "no/such does not exist"),
        ({"query": "no/such"}, "no/such does not exist"),
        ({"query": "WORLD/garbage.mp4"}, r"garbage\.mp4 holds no frame that OpenCV can read"),
        ({"query": "63"}, "camera 63 gives no picture"),
        ({"policy": "amusik"}, "unknown policy 'amusik': did you mean 'amusic'"),
        ({"policy": "subset:HGO"}, "unknown technique 'HGO': did you mean 'HOG'"),
        ({"policy": "ppo:no/run"}, "no/run"),
        ({"policy": "oracle"}, "live route 'run'.*runs on a score bank only"),
        ({"techniques": "hgo"}, "unknown technique 'hgo': did you mean 'hog'"),
        ({"techniques": ","}, "--techniques names none"),
        ({"techniques": "hog,HOG"}, "HOG"),
        ({"weights": "CALC=x"}, "--weights: unknown technique 'CALC'"),
        ({"weights": "HOG=no/file"}, "takes no weights; leave out no/file"),
        ({"seconds": "HGO=1"}, "--seconds: unknown technique 'HGO': did you mean 'HOG'"),
        ({"seconds": "HOG=soon"}, "--seconds HOG=soon: 'soon' is not a number"),
        ({"seconds": "HOG"}, "--seconds 'HOG' is not of the form NAME=VALUE"),
        ({"seconds": "HOG=-1"}, "-1"),
        ({"frames": "0"}, "--frames is 0; give a whole number >= 1"),
        ({"tolerance": "-1"}, "tolerance"),
        ({"compute-weight": "-1"}, "-1"),
        ({"statistic": "evidnce"}, "did you mean 'evidence'"),
        ({"policy": "ppo", "statistic": "belief"}, "name ppo@belief"),
        ({"video": "film.mp3"}, r"unknown kind of video '\.mp3': did you mean '\.mp4'"),
        ({"query": "WORLD/run.avi", "ground-truth": "WORLD/truth.npy"}, "length is known: a fold"),
        ({"ground-truth": "no/truth.npy"}, r"no/truth\.npy does not exist"),
        ({"cache": "WORLD/truth.npy"}, r"truth\.npy is a file; give a folder"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(navigate, world, changes, words):
    changes = {name: value.replace("WORLD", str(world)) for name, value in changes.items()}
    code, _, err = navigate(**changes)
    assert code == 2
    assert len(err.splitlines()) == 1
    assert err.startswith("navigate.py: ")
    assert re.search(words, err), err


def test_a_wrong_policy_is_refused_before_the_map_is_described(navigate, tmp_path):
    cache = tmp_path / "cache"
    assert navigate(policy="subset:HGO", cache=str(cache))[0] == 2
    assert not cache.exists()
    assert navigate(cache=str(cache))[0] == 0
    assert cache.exists()


def test_a_bad_image_on_the_way_keeps_what_was_written(navigate, world, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    for i, view in enumerate(views(5)):
        cv2.imwrite(str(run / f"img{i}.png"), view // 2)
    (run / "img3.png").write_bytes(b"garbage")
    trace = tmp_path / "trace.csv"
    code, out, err = navigate(query=str(run), trace=str(trace))
    assert code == 2
    assert re.fullmatch(r"navigate\.py: .*img3\.png.*\n", err)
    assert len(table(trace)) == len(lines_of(out)) == 3
    assert "\n3 frames, " in out


# ---- Ctrl-C ------------------------------------------------------------------------------


def test_ctrl_c_keeps_trace_and_video_valid(navigate, tmp_path):
    trace, film = tmp_path / "trace.csv", tmp_path / "film.avi"
    arguments = {"techniques": COUNTING, "policy": "music", "seconds": "Counting=1"}
    navigate("--frames", "1", **arguments)
    before = Counting.queries  # warm-up, and the first frame
    Counting.queries, Counting.stop_at = 0, before + 4
    code, out, err = navigate(trace=str(trace), video=str(film), **arguments)
    assert code == 130
    assert err == "interrupted; what was finished is kept\n"
    assert len(table(trace)) == len(lines_of(out)) == 4
    assert "\n4 frames, " in out
    source = VideoFile(film)
    assert [source.read(i) is None for i in range(5)] == [False] * 4 + [True]


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_34_52_a_process_that_is_stopped_ends_well(world, tmp_path, number, status):
    long = tmp_path / "long.avi"
    with VideoWriter(long, 10) as writer:
        for view in views(PLACES) * 200:
            writer.write(view)
    trace = tmp_path / "trace.csv"
    arguments = (
        f"--reference {world}/map --query {long} --policy subset:HOG --techniques hog"
        f" --seconds HOG=0.01 --cache {world}/cache --trace {trace} --video {tmp_path}/film.mp4"
    )
    process = subprocess.Popen(
        [sys.executable, "-W", "error", str(SCRIPTS / "navigate.py"), *arguments.split()],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    seen = []
    assert process.stdout is not None
    for line in process.stdout:
        seen += lines_of(line)
        if len(seen) == 5:
            process.send_signal(number)
            break
    out, err = process.communicate(timeout=60)
    assert process.returncode == status
    assert err == "interrupted; what was finished is kept\n"
    frames = len(seen) + len(lines_of(out))
    assert f"\n{frames} frames, " in out
    assert len(table(trace)) in (frames, frames - 1)  # it may come between line and trace
    source = VideoFile(tmp_path / "film.mp4")
    while source.length is None:
        assert source.read(source._next) is not None
    assert source.length in (frames, frames - 1)
    assert not list(tmp_path.glob(".*"))


def test_a_video_is_thinned_and_nothing_else(navigate, world):
    for option, frames in (("--every", "3"), ("--fps", "3.4")):
        code, out, err = navigate(option, frames, query=f"{world}/run.avi")
        assert (code, err) == (0, "")
        assert len(lines_of(out)) == 3
    for query in (f"{world}/run", "0"):
        code, _, err = navigate("--every", "2", query=query)
        assert (code, err) == (
            2,
            f"navigate.py: --every and --fps thin a video, but --query {query} is none\n",
        )
    assert "give one of the two" in navigate("--every", "2", "--fps", "1")[2]


def test_names_reach_no_terminal_raw(navigate, tmp_path):
    code, _, err = navigate(query=f"{tmp_path}/\x1b[2J")
    assert code == 2
    assert r"\x1b[2J does not exist" in err
    assert "\x1b" not in err


def test_50_a_drive_whose_places_are_doubtful_says_so_in_its_summary(
    navigate, world, tmp_path, monkeypatch
):
    monkeypatch.setattr(drive, "SETTLED", 5)
    strange = tmp_path / "strange"
    strange.mkdir()
    rng = np.random.default_rng(0)
    for frame in range(24):
        image = rng.integers(0, 255, (48, 64, 3), np.uint8)
        assert cv2.imwrite(str(strange / f"{frame:03}.png"), image)
    for query, told in ((str(strange), True), (f"{world}/run", False)):
        code, out, _ = navigate(query=query)
        assert code == 0
        assert ("p is below 0.5 on" in out) == told
