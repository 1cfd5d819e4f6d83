"""What a drive tells other programs: lines of JSON, HTTP, Rerun and ROS messages."""

from __future__ import annotations

import importlib.util
import json
import math
import runpy
import socket
import threading
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from live_cases import NAMES, live_of, maps_of, pair, policy_on, traverse

from amusic_gym.live.answers import Answers, line
from amusic_gym.live.navigation import navigate
from amusic_gym.live.rerun import Recording
from amusic_gym.live.server import AnswerServer
from amusic_gym.routes.positions import GEOGRAPHIC, Positions, from_degrees

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "ros2_node.py"


def seen_of(spec: str = "music", frames: int = 6):
    _, live = pair(frames, 20)
    return list(navigate(policy_on(spec, live), live))


def places() -> Positions:
    degrees = from_degrees(59 + 1e-5 * np.arange(20), np.full(20, 10.0))
    return Positions(degrees, GEOGRAPHIC, np.arange(20) * 1.0, {}, "t")


# ---- an answer ---------------------------------------------------------------------------------


def test_an_answer_says_all_that_a_frame_told():
    names = [f"img{place}.png" for place in range(20)]
    seen = seen_of()[-1]
    answer = json.loads(line(Answers(names, places(), 0.01).of(seen, right=True)))
    assert (answer["frame"], answer["place"], answer["name"]) == (5, 5, "img5.png")
    assert answer["position"] == pytest.approx([59 + 5e-5, 10.0])
    assert (answer["heading"], answer["known"], answer["right"]) == (5.0, True, True)
    assert answer["p_correct"] == pytest.approx(seen.p_correct, abs=1e-6)
    assert answer["active"] == list(NAMES)
    assert set(answer["run_milliseconds"]) == set(NAMES)
    assert answer["milliseconds"] == pytest.approx(seen.milliseconds, abs=1e-6)


def test_what_is_not_known_is_null_and_json_is_strict():
    seen = replace(seen_of("raw:HOG")[0], prediction=-1, confidence=-math.inf)
    answer = Answers(min_p=0.5).of(seen)
    empty = {name for name, value in answer.items() if value is None}
    assert empty == {
        *("place", "name", "position", "heading", "p_correct", "known", "right"),
        *("confidence", "compute_weight"),
    }
    json.loads(line(answer), parse_constant=pytest.fail)


def test_a_place_below_min_p_is_unknown():
    seen = seen_of()[-1]
    for least, known in ((0.0, True), (seen.p_correct, True), (1.0, False), (None, None)):
        assert Answers(min_p=least).known(seen) is known
    assert Answers(min_p=0.0).known(replace(seen, prediction=-1)) is False


# ---- HTTP --------------------------------------------------------------------------------------


def get(url: str) -> tuple[int, str, bytes]:
    with urllib.request.urlopen(url, timeout=5) as response:
        return response.status, response.headers["Content-Type"], response.read()


def test_the_last_answer_the_events_and_a_page_are_served():
    with AnswerServer(0) as server:
        assert server.url.startswith("http://127.0.0.1:")
        assert get(server.url + "last")[::2] == (204, b"")
        status, kind, page = get(server.url)
        assert (status, kind) == (200, "text/html; charset=utf-8")
        assert b"EventSource" in page
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(server.url + "other")
        events = urllib.request.urlopen(server.url + "events", timeout=5)
        for number in range(3):
            server.put({"frame": number})
            assert json.loads(events.readline().removeprefix(b"data: ")) == {"frame": number}
            assert events.readline() == b"\n"
        status, kind, last = get(server.url + "last")
        assert (kind, json.loads(last)) == ("application/json", {"frame": 2})
    assert events.read() == b""  # the end of the drive ends the events
    with pytest.raises(urllib.error.URLError):
        get(server.url + "last")


def test_a_reader_that_stops_reading_or_goes_does_not_stop_the_drive():
    with AnswerServer(0) as server:
        port = int(server.url.rstrip("/").rpartition(":")[2])
        stuck, gone = (socket.create_connection(("127.0.0.1", port)) for _ in range(2))
        for each in (stuck, gone):
            each.sendall(b"GET /events HTTP/1.0\r\n\r\n")
            each.recv(1)
        gone.close()
        for number in range(200):
            server.put({"frame": number, "name": "x" * 100_000})
        assert json.loads(get(server.url + "last")[2])["frame"] == 199
    stuck.close()
    assert threading.active_count() < 20


# ---- navigate ----------------------------------------------------------------------------------


@pytest.fixture
def drive(tmp_path, amusic):
    import cv2

    rng = np.random.default_rng(0)
    for name, count in (("map", 6), ("run", 4)):
        (tmp_path / name).mkdir()
        for number in range(count):
            image = np.random.default_rng(number).integers(0, 255, (64, 64, 3), np.uint8)
            noise = rng.integers(0, 9, image.shape, np.uint8)
            cv2.imwrite(str(tmp_path / name / f"img{number}.png"), image // 2 + noise)
    given = {
        "--reference": tmp_path / "map",
        "--query": tmp_path / "run",
        "--policy": "music",
        "--techniques": "hog",
        "--cache": tmp_path / "cache",
    }

    def run(*extra):
        return amusic("navigate", *(word for pair in given.items() for word in pair), *extra)

    return run


def test_jsonl_is_all_that_is_on_stdout(drive):
    code, out, err = drive("--output", "jsonl", "--min-p", "1", "--seconds", "HOG=0.01")
    answers = [json.loads(each) for each in out.splitlines()]
    assert code == 0
    assert [each["frame"] for each in answers] == [0, 1, 2, 3]
    assert [each["place"] for each in answers] == [0, 1, 2, 3]
    assert {each["known"] for each in answers} == {False}
    assert answers[2]["name"] == "img2.png"
    assert "4 frames, " in err


def test_an_unknown_place_is_no_number_in_the_table(drive):
    code, out, _ = drive("--min-p", "1", "--seconds", "HOG=0.01")
    assert code == 0
    assert out.count(" unknown ") == 4


def test_http_serves_while_it_drives_and_a_busy_port_is_refused(drive):
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        code, _, err = drive("--http", str(port))
        assert code == 2
        assert f"--http {port} on --host 127.0.0.1: " in err
    code, _, err = drive("--http", "0", "--seconds", "HOG=0.01")
    assert code == 0
    assert err.startswith("answers at http://127.0.0.1:")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--http", "99999999"], "--http 99999999 on --host 127.0.0.1: "),
        (["--min-p", "2"], r"--min-p is 2.0; give a number in [0, 1]"),
        (["--budget-ms", "5"], "policy music has no λ to hold a budget with; take ppo or voi"),
        (
            ["--cap-ms", "0.001"],
            "no frame fits within 0.001 ms: the cheapest technique, HOG, ",
        ),
        (["--joules", "HOG=1"], "budget_joules goes with joules"),
        (["--joules", "SIFT=1", "--budget-joules", "1"], "--joules: unknown technique 'SIFT'"),
    ],
)
def test_what_cannot_be_kept_or_served_is_refused_in_one_line(drive, words, said):
    code, out, err = drive("--seconds", "HOG=0.01", *words)
    assert (code, out) == (2, "")
    assert said in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    "words",
    [
        ["--budget-ms", "40"],
        ["--budget-fps", "25", "--cap-ms", "80"],
        ["--budget-joules", "2", "--joules", "hog=1"],
    ],
)
def test_a_drive_keeps_to_a_budget(drive, words):
    code, out, err = drive("--policy", "ppo", "--seconds", "HOG=0.01", *words, "--output", "jsonl")
    assert code == 0, err
    weights = [json.loads(each)["compute_weight"] for each in out.splitlines()]
    assert weights[0] == 0.3
    assert len(set(weights)) == 3  # what a frame cost counts from the one after the next on


# ---- Rerun -------------------------------------------------------------------------------------


def test_a_recording_of_rerun_holds_the_frames(tmp_path):
    pytest.importorskip("rerun", reason='pip install "amusic-gym[rerun]"')
    path, live = tmp_path / "drive.rrd", live_of(maps_of(20), traverse(5, 2))
    sizes = []
    for frames in (1, 5):
        with Recording(str(path)) as recording:
            for seen in list(navigate(policy_on("music", live), live))[:frames]:
                recording.write(seen, Answers().of(seen))
        content = path.read_bytes()
        assert content[:3] == b"RRF"
        assert all(word in content for word in (b"camera", b"p_correct", b"CoHOG"))
        sizes.append(len(content))
    assert sizes[1] > sizes[0] > 1000


def test_without_rerun_the_refusal_names_the_command(drive, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    code, _, err = drive("--rerun", "drive.rrd")
    assert code == 2
    assert 'install it: pip install "amusic-gym[rerun]"' in err
    assert importlib.util.find_spec("amusic_gym.live.rerun")
    assert not Path("drive.rrd").exists()


# ---- ROS ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def node() -> SimpleNamespace:
    return SimpleNamespace(**runpy.run_path(str(EXAMPLE)))


def test_images_of_ros_are_read_as_opencv_has_them(node):
    image = np.random.default_rng(0).integers(0, 255, (3, 4, 3), np.uint8)
    padded = np.zeros((3, 20), np.uint8)  # rows may be longer than the image
    padded[:, :12] = image.reshape(3, 12)
    message = SimpleNamespace(height=3, width=4, step=20, encoding="bgr8", data=padded.tobytes())
    np.testing.assert_array_equal(node.image_of(message), image)
    message.encoding = "rgb8"
    np.testing.assert_array_equal(node.image_of(message), image[..., ::-1])
    grey = SimpleNamespace(height=3, width=4, step=20, encoding="mono8", data=padded.tobytes())
    np.testing.assert_array_equal(node.image_of(grey), padded[:, :4])
    message.encoding = "bayer_rggb8"
    with pytest.raises(ValueError, match="bayer_rggb8; give bgr8, rgb8 or mono8"):
        node.image_of(message)


def test_a_result_becomes_messages_of_ros(node):
    result = SimpleNamespace(
        place=7, name="img7.png", position=(12.0, -3.5), heading=90.0, p_correct=0.8, known=True,
        active=("HOG",), milliseconds=12.5, frame=3,
    )  # fmt: skip
    header = {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "map"}
    answer, pose = node.messages_of(result, header)
    assert json.loads(answer["data"]) == {
        "frame": 3, "place": 7, "name": "img7.png", "p_correct": 0.8, "known": True,
        "active": ["HOG"], "milliseconds": 12.5,
    }  # fmt: skip
    assert pose["header"] == header
    assert pose["pose"]["pose"]["position"] == {"x": 12.0, "y": -3.5, "z": 0.0}
    # East is x: a heading of 90 degrees, clockwise from north, is a yaw of 0.
    turn = pose["pose"]["pose"]["orientation"]
    assert (turn["z"], turn["w"]) == pytest.approx((0.0, 1.0))
    assert len(pose["pose"]["covariance"]) == 36
    north = node.messages_of(SimpleNamespace(**{**vars(result), "heading": 0.0}), header)[1]
    turn = north["pose"]["pose"]["orientation"]
    assert (turn["z"], turn["w"]) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))


@pytest.mark.parametrize("changes", [{"known": False}, {"position": None}])
def test_an_unknown_place_has_no_pose(node, changes):
    result = {
        "place": 7, "name": "", "position": (1.0, 2.0), "heading": None, "p_correct": 0.1,
        "known": True, "active": (), "milliseconds": 1.0, "frame": 0,
    }  # fmt: skip
    assert node.messages_of(SimpleNamespace(**{**result, **changes}), {})[1] is None
