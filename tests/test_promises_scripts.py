"""What every script promises of its arguments, its outputs and how it ends."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from amusic_agents.config import MOST_ROUTES, TrainingConfig
from amusic_baselines import make_policy
from live_cases import TOLERANCE, Columns, live_of, map_of, maps_of, traverse

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import LARGEST_TOLERANCE
from amusic_gym.cli import COMMANDS, status
from amusic_gym.cli.parser import Parser, by_technique, numbers
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.envs.window import Window
from amusic_gym.live.navigation import navigate
from amusic_gym.routes.video import Camera, VideoWriter

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"
SCRIPT_NAMES = sorted(path.name for path in SCRIPTS.glob("[!_]*.py"))


@pytest.fixture
def world(tmp_path) -> Path:
    """Folder ``map`` of 3 images, and the video ``run.avi``."""
    rng = np.random.default_rng(0)
    (tmp_path / "map").mkdir()
    views = rng.integers(0, 255, (3, 48, 64, 3), np.uint8)
    with VideoWriter(tmp_path / "run.avi", 10) as writer:
        for i, view in enumerate(views):
            cv2.imwrite(str(tmp_path / f"map/img{i}.png"), view)
            writer.write(view)
    return tmp_path


@pytest.fixture
def drive(world, monkeypatch, amusic):
    """Runs navigate.py in the world's folder; gives its exit status, stdout and stderr."""
    monkeypatch.chdir(world)

    def run(*more: str) -> tuple[int, str, str]:
        words = "--reference map --query run.avi --policy subset:HOG --techniques hog --cache cache"
        return amusic("navigate", *words.split(), "--seconds", "HOG=0.01", *more)

    return run


def refused(outcome: tuple[int, str, str], words: str) -> None:
    code, out, err = outcome
    assert (code, out) == (2, "")
    assert words in err, err
    assert len(err.splitlines()) == 1
    assert not Path("cache").exists()  # before any work


# ---- outputs -----------------------------------------------------------------------------


@pytest.mark.parametrize("option", ["--video", "--trace"])
@pytest.mark.parametrize("name", ["run.avi", "map/../run.avi", "link.avi", "hard.avi"])
def test_an_output_that_is_the_query_is_refused_and_the_query_kept(drive, world, option, name):
    (world / "link.avi").symlink_to(world / "run.avi")
    (world / "hard.avi").hardlink_to(world / "run.avi")
    before = (world / "run.avi").read_bytes()
    refused(drive(option, name), f"{option} {name} is the file of --query too")
    assert (world / "run.avi").read_bytes() == before


def test_two_outputs_in_one_file_are_refused(drive):
    outcome = drive("--trace", "new.avi", "--video", "map/../new.avi")
    refused(outcome, "--video map/../new.avi is the file of --trace too")


def test_a_trace_in_place_of_the_ground_truth_is_refused(drive, world):
    np.save(world / "truth.npy", np.arange(3))
    outcome = drive("--ground-truth", "truth.npy", "--trace", "truth.npy")
    refused(outcome, "--trace truth.npy is the file of --ground-truth too")


@pytest.mark.parametrize("option", ["--video", "--trace"])
def test_an_output_that_cannot_be_written_is_refused_before_any_work(drive, world, option):
    (world / "folder.avi").mkdir()
    (world / "file").touch()
    refused(drive(option, "folder.avi"), f"{option} folder.avi is a folder; give a file in it")
    refused(drive(option, "file/x.avi"), f"{option} file/x.avi cannot be written")


def test_outputs_in_new_folders_and_over_older_files_are_fine(drive, world):
    (world / "film.avi").write_bytes(b"older")
    code, _, err = drive("--trace", "new/folder/t.csv", "--video", "film.avi", "--quiet")
    assert (code, err) == (0, "")
    assert len((world / "new/folder/t.csv").read_text().splitlines()) == 4
    assert (world / "film.avi").stat().st_size > 1000


# ---- arguments ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--trace", ""], "--trace is empty; give a value"),
        (["--video="], "--video is empty; give a value"),
        (["--cache", ""], "--cache is empty; give a value"),
        (["--query", ""], "--query is empty; give a value"),
        (["--reference", ""], "--reference is empty; give a value"),
        (["--tolerance", "99999999999999999999"], "tolerance is 99999999999999999999; give at"),
        (["--query", "99999999999999"], "camera is 99999999999999; camera numbers are 0, 1, …"),
        (["--query", "-1"], "--query -1: camera numbers are 0, 1, …"),
        (["--seed", "-1"], "--seed is -1; give a whole number >= 0"),
    ],
)
def test_an_empty_or_absurd_argument_is_one_line(drive, words, sentence):
    refused(drive(*words), sentence)


def test_more_frames_than_can_be_counted_are_all_of_them(drive):
    code, out, err = drive("--frames", "99999999999999999999999", "--quiet")
    assert (code, err) == (0, "")
    assert out.strip().startswith("3 frames, ")


def test_an_empty_word_is_refused_behind_a_command_too(capsys):
    parser = Parser(prog="x")
    command = parser.add_subparsers(dest="command").add_parser("go")
    command.add_argument("--out", type=Path)
    command.add_argument("--seconds", nargs="+")
    for words in (["go", "--out", ""], ["go", "--out="]):
        with pytest.raises(SystemExit):
            parser.parse_args(words)
        assert capsys.readouterr().err.startswith("x go: --out is empty; give a value")
    given = parser.parse_args(["go", "--out", "a=", "--seconds", "HOG="])
    assert (given.out, given.seconds) == (Path("a="), ["HOG="])  # not empty


def test_values_by_technique_are_found_in_any_case_and_without_a_class_s_module():
    names = ["HOG", "own.module:Mine", "hog2"]
    given = ["hog=1", "MINE=2", "Hog2=3"]
    assert by_technique(given, names, "--x") == {"HOG": "1", "own.module:Mine": "2", "hog2": "3"}
    assert by_technique(["OWN.module:mine=6"], names, "--x") == {"own.module:Mine": "6"}
    assert by_technique([], names, "--x") == {}
    for wrong, near in (("hgo=4", "did you mean 'HOG'"), ("module=5", "valid: HOG, own.module")):
        with pytest.raises(ValueError, match=rf"^--x: unknown technique '.*{near}"):
            by_technique([wrong], names, "--x")


def test_a_number_is_refused_by_the_name_it_was_given_for():
    assert numbers({"HOG": "2.5e-1"}, "--seconds") == {"HOG": 0.25}
    with pytest.raises(ValueError, match="^--seconds HOG=soon: 'soon' is not a number$"):
        numbers({"HOG": "soon"}, "--seconds")


def test_a_tolerance_that_cannot_be_counted_is_refused_by_banks_and_live_routes():
    with pytest.raises(ValueError, match=f"give at most {LARGEST_TOLERANCE} places"):
        ScoreBank(np.zeros((1, 2, 2), np.float32), ["HOG"], [1.0], tolerance=LARGEST_TOLERANCE + 1)
    with pytest.raises(ValueError, match=f"give at most {LARGEST_TOLERANCE} places"):
        live_of(maps_of(3), traverse(3, seed=2), tolerance=LARGEST_TOLERANCE + 1)
    live_of(maps_of(3), traverse(3, seed=2), tolerance=LARGEST_TOLERANCE)


def test_more_routes_than_memory_holds_are_refused():
    with pytest.raises(ValueError, match=f"n_envs is 99999999999; give at most {MOST_ROUTES}"):
        replace(TrainingConfig(), n_envs=99999999999)
    assert replace(TrainingConfig(), n_envs=MOST_ROUTES).n_envs == MOST_ROUTES


def test_a_camera_with_an_absurd_number_is_refused():
    with pytest.raises(ValueError, match="camera is 2147483648; camera numbers are 0, 1"):
        Camera(2**31)


# ---- live routes -------------------------------------------------------------------------


class Scribbler(Columns):
    """Draws on what it is given, after it has looked at it."""

    def describe(self, image):
        described = super().describe(image)
        image[:] = 0
        return described


def test_a_technique_that_draws_on_its_image_spoils_nothing():
    places, images = traverse(12, seed=1), traverse(6, seed=2)
    kept = [image.copy() for image in images]
    other = Columns("CALC", 2, 1)
    scribbler = Scribbler("HOG", 1, 0)
    maps = [map_of([p.copy() for p in places], one) for one in (scribbler, other)]
    route = live_of(maps, images, seconds=(1.0, 2.0))
    alone = live_of([maps[1]], kept, seconds=(2.0,))
    for frame, result in enumerate(navigate(make_policy("music", _context(route)), route)):
        assert result.ran.all()
        np.testing.assert_array_equal(result.image, kept[frame])
        scores, _ = route.run(1, result.image, frame)
        np.testing.assert_array_equal(scores, alone.run(0, kept[frame], frame)[0])


def _context(route: LiveRoute):
    from amusic_gym.policies.protocol import Context

    return Context.of(route, statistic="evidence")


def test_images_of_another_map_are_refused():
    with pytest.raises(ValueError, match="5 images of a map of 12 places; give places="):
        live_of(maps_of(12), traverse(3, seed=2), places=traverse(5, seed=1))


def test_a_live_route_without_a_map_is_refused_plainly():
    with pytest.raises(ValueError, match="^no map; give at least one$"):
        LiveRoute([], traverse(3, seed=2), tolerance=TOLERANCE)


# ---- the window --------------------------------------------------------------------------


@pytest.fixture
def headless(monkeypatch):
    """A machine without a display, where SDL falls back to a driver that shows nothing."""
    pygame = pytest.importorskip("pygame")
    pygame.display.quit()
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    monkeypatch.setattr(pygame.display, "init", lambda: None)
    monkeypatch.setattr(pygame.display, "get_driver", lambda: "offscreen")


def test_a_window_that_nobody_would_see_is_refused(headless, monkeypatch):
    for ask in (Window("x").check, lambda: Window("x").show(np.zeros((4, 4, 3), np.uint8))):
        with pytest.raises(OSError, match=r"no window.*\(no display\).*amusic navigate --video"):
            ask()
    monkeypatch.setenv("SDL_VIDEODRIVER", "offscreen")
    Window("x").check()  # asked for


def test_show_without_a_display_is_refused_before_any_work(drive, headless):
    refused(drive("--show"), "no display")


# ---- how scripts end ---------------------------------------------------------------------


def process(code: str, unbuffered: str = "", **options) -> subprocess.Popen[str]:
    """A script that imports what all import, then runs ``code``."""
    options["env"] = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    begin = f"import sys; sys.path.insert(0, {str(SCRIPTS)!r}); sys.argv = ['x.py']; import _cli\n"
    return subprocess.Popen(
        [sys.executable, "-c", begin + code],
        stderr=subprocess.PIPE,
        text=True,
        **{"stdout": subprocess.PIPE, **options},
    )


@pytest.mark.parametrize(
    "code",
    [
        "_cli.run(lambda: [print(i, flush=True) for i in range(10**6)] and None)",
        "_cli.run(lambda: print('x'))",  # written at the end, where stdout is buffered
        "parser = _cli.Parser(); _cli.run(lambda: parser.parse_args(['--help']))",
    ],
)
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_goes_away_ends_a_script_quietly(code, unbuffered):
    read, write = os.pipe()
    os.close(read)
    ended = process(code, unbuffered, stdout=write)
    os.close(write)
    assert ended.communicate(timeout=60)[1] == ""
    swallowed = unbuffered and "--help" in code  # by argparse
    assert ended.returncode == (0 if swallowed else 141)


def test_another_broken_pipe_is_told():
    ended = process("def main(): raise BrokenPipeError(32, 'Broken pipe')\n_cli.run(main)")
    assert ended.communicate(timeout=60) == ("", "x.py: Broken pipe\n")
    assert ended.returncode == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_one_line():
    with Path("/dev/full").open("w") as full:
        ended = process("_cli.run(lambda: print('x'))", stdout=full)
    assert ended.communicate(timeout=60)[1] == "x.py: No space left on device\n"
    assert ended.returncode == 2


def test_too_little_memory_is_one_line(monkeypatch, capsys):
    def main() -> None:
        np.zeros(2**50)

    monkeypatch.setattr(sys, "argv", ["script.py"])
    with pytest.raises(SystemExit) as ended:
        status.run(main)
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert told.startswith("script.py: not enough memory; ask for less. Unable to allocate")
    assert len(told.splitlines()) == 1


def test_ctrl_c_while_modules_are_imported_ends_well():
    ended = process("print('importing', flush=True)\nimport time\ntime.sleep(30)")
    assert ended.stdout is not None
    assert ended.stdout.readline() == "importing\n"
    ended.send_signal(signal.SIGINT)
    assert ended.communicate(timeout=60)[1] == "interrupted; what was finished is kept\n"
    assert ended.returncode == 130


@pytest.mark.parametrize("name", COMMANDS)
def test_scripts_import_first_what_makes_ctrl_c_end_well(name):
    text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
    assert re.findall(r"^(?:from|import) (\w+)", text, re.MULTILINE) == ["_cli"]


# ---- 52 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCRIPT_NAMES)
def test_52_every_script_takes_its_signals_in_one_place(name):
    end = (SCRIPTS / name).read_text(encoding="utf-8").splitlines()[-1]
    stem = name.removesuffix(".py")
    assert end in ("    run(main)", f'    door("{stem}")')
    assert (stem in COMMANDS) == (end != "    run(main)")


STOPPING = """
import os, signal, time
def main():
    try:
        print('running', flush=True)
        time.sleep(30)
    finally:
        for number in (signal.SIGTERM, signal.SIGHUP):  # as a closing terminal sends them
            os.kill(os.getpid(), number)
        print('saved', flush=True)
"""


@pytest.mark.parametrize("ignored", [[], [signal.SIGINT]], ids=["", "in the background"])
@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_52_sigterm_and_sighup_are_as_ctrl_c_and_count_once(number, status, ignored):
    ignoring = "".join(f"signal.signal({n:d}, signal.SIG_IGN)\n" for n in ignored)
    ended = process(f"{STOPPING}{ignoring}_cli.run(main)", stdout=subprocess.PIPE)
    assert ended.stdout is not None
    assert ended.stdout.readline() == "running\n"
    ended.send_signal(number)
    out, err = ended.communicate(timeout=60)
    assert (out, err) == ("saved\n", "interrupted; what was finished is kept\n")
    assert ended.returncode == status


def test_52_under_nohup_a_terminal_may_go():
    ended = process(
        "import os, signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "_cli.run(lambda: (os.kill(os.getpid(), signal.SIGHUP), print('goes on'))[0])"
    )
    assert ended.communicate(timeout=60) == ("goes on\n", "")
    assert ended.returncode == 0


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_52_a_terminal_that_hangs_up_costs_nothing_that_was_finished(tmp_path):
    """Nothing can be printed any more, neither results nor the notice."""
    kept = tmp_path / "kept"
    code = (
        "import pathlib, sys, time\nsys.path.insert(0, sys.argv.pop(1))\nimport _cli\n"
        "def main():\n"
        "    try:\n        print('running', flush=True)\n        time.sleep(30)\n"
        f"    finally:\n        pathlib.Path({str(kept)!r}).touch()\n        print('saved')\n"
        "_cli.run(main)"
    )
    child, terminal = pty.fork()
    if not child:
        os.execv(sys.executable, [sys.executable, "-c", code, str(SCRIPTS)])
    assert b"running" in os.read(terminal, 100)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 129
    assert kept.exists()


def test_52_handlers_are_as_before_when_a_script_has_ended():
    before = [signal.getsignal(number) for number in status.STOPS]
    with pytest.raises(SystemExit):
        status.run(lambda: 0)
    assert [signal.getsignal(number) for number in status.STOPS] == before
