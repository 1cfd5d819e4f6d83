"""Render modes of both environments: pictures, the window, and what they never show."""

from __future__ import annotations

import copy
import importlib.util
import pickle
import subprocess
import sys
import types
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from env_cases import ENV_NAME, random_actions, random_bank
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecVideoRecorder

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.envs.pictures import layout
from amusic_gym.envs.pictures.viewer import MOST_SHOWN, PICTURE_MODES
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.envs.window import Window
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.techniques import Technique

pytestmark = pytest.mark.slow

SHAPE = (540, 960, 3)


@pytest.fixture
def pygame():
    module = pytest.importorskip("pygame")
    yield module
    module.display.quit()


def driven(env, steps: int = 6, seed: int = 0):
    """The environment after some steps."""
    env.reset(seed=seed)
    for action in random_actions(seed, steps, env.action_space.shape):
        env.step(action)
    return env


def on_screen(pygame) -> np.ndarray:
    return pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)


# ---- pictures ----------------------------------------------------------------------------


def test_the_modes_are_declared(bank):
    for env in (TechniqueSelectionEnv(bank), TechniqueSelectionVectorEnv(2, bank)):
        assert env.metadata["render_modes"] == ["ansi", "rgb_array", "rgb_array_list", "human"]
        assert env.metadata["render_fps"] == 10
        assert env.render() is None


def test_a_picture_follows_every_step(bank):
    env = gym.make(ENV_NAME, bank=bank, render_mode="rgb_array")
    env.reset(seed=0)
    pictures = [env.render()]
    for action in random_actions(0, 4, env.action_space.shape):
        env.step(action)
        pictures.append(env.render())
    assert {(p.shape, p.dtype) for p in pictures} == {(SHAPE, np.dtype(np.uint8))}
    assert len({p.tobytes() for p in pictures}) == 5
    np.testing.assert_array_equal(env.render(), pictures[-1])


def test_a_new_episode_begins_with_an_empty_trail(bank):
    env = TechniqueSelectionEnv(bank, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    driven(env)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), first)


def test_before_the_first_reset_the_picture_says_so(bank):
    env = TechniqueSelectionEnv(bank, render_mode="rgb_array")
    np.testing.assert_array_equal(env.render(), layout.notice("no route yet; call reset first"))


def test_frames_of_a_crop_show_the_rows_of_that_crop(bank):
    whole = driven(TechniqueSelectionEnv(bank, render_mode="rgb_array"))
    crop = TechniqueSelectionEnv(bank, render_mode="rgb_array")
    crop.reset(seed=0, options={"start": 20})
    crop.step([1, 1, 1])
    scene = crop._viewer._scene(0, crop.task.episodes.routes[0])
    assert sorted(scene.rows) == [0, 1, 2]
    np.testing.assert_array_equal(scene.rows[1], bank.row(1, 20))
    assert whole.render().shape == SHAPE


def test_a_picture_says_what_the_infos_say(bank):
    env = TechniqueSelectionEnv(bank, render_mode="rgb_array", reselection=4)
    env.reset(seed=3)
    seen = []
    for action in random_actions(3, 20, env.action_space.shape, reselect=0.2):
        *_, info = env.step(action)
        seen.append(info["prediction"])
        scene = env._viewer._scene(0, env.task.episodes.routes[0])
        assert scene.frame == info["frame"]
        assert scene.trail.predictions == seen
        assert scene.trusted == info["technique"]
        assert scene.ran == tuple(info["ran"])
        assert scene.confidence == info["confidence"]
        assert scene.p_correct == info["p_correct"]
        assert scene.compute == pytest.approx(info["seconds"] / info["run_seconds"].sum())
        assert scene.correct is None
    assert scene.frames == bank.queries


def test_empty_slots_are_not_shown(bank):
    wide = driven(TechniqueSelectionEnv(bank, slots=7, render_mode="rgb_array"))
    scene = wide._viewer._scene(0, wide.task.episodes.routes[0])
    assert scene.techniques == bank.techniques
    assert len(scene.ran) == 3


def test_no_picture_shows_the_ground_truth(bank):
    """The same scores with another truth give the same pictures, bit for bit."""
    shifted = ScoreBank(
        bank.scores,
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=(np.arange(bank.queries) + 17) % bank.references,
        name=bank.name,
    )
    both = [driven(TechniqueSelectionEnv(b, render_mode="rgb_array"), 30) for b in (bank, shifted)]
    np.testing.assert_array_equal(both[0].render(), both[1].render())


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_vector_environment_shows_what_single_ones_show(bank, mode):
    banks = [bank, random_bank(2, queries=5)]
    arguments = {"bank": banks, "render_mode": "rgb_array", "compute_weight": (0.1, 3.0)}
    native = TechniqueSelectionVectorEnv(3, autoreset_mode=mode, **arguments)
    singles = gym.vector.SyncVectorEnv(
        [lambda: TechniqueSelectionEnv(**arguments)] * 3, autoreset_mode=mode
    )
    native.reset(seed=5)
    singles.reset(seed=5)
    for action in random_actions(5, 14, native.action_space.shape):
        native.step(action)
        singles.step(action)
        ours, theirs = native.render(), singles.render()
        assert isinstance(ours, tuple)
        assert len(ours) == 3
        for mine, single in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(mine, single)


def test_a_partial_reset_clears_only_its_trails(bank):
    env = driven(TechniqueSelectionVectorEnv(2, bank, render_mode="rgb_array",
                                             autoreset_mode="Disabled"))  # fmt: skip
    env.reset(options={"reset_mask": np.array([True, False])})
    assert [len(trail) for trail in env._viewer.trails] == [0, 6]


def test_copies_and_pickles_draw_on_alone(bank):
    env = driven(TechniqueSelectionEnv(bank, render_mode="rgb_array"))
    expected = env.render()
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        np.testing.assert_array_equal(twin.render(), expected)
        env.step([1, 1, 1])
        np.testing.assert_array_equal(twin.render(), expected)
        twin.step([1, 0, 0])
        assert not np.array_equal(twin.render(), expected)


def test_pictures_do_not_change_the_episode(bank):
    plain, drawn = TechniqueSelectionEnv(bank), TechniqueSelectionEnv(bank, render_mode="rgb_array")
    first = [env.reset(seed=1)[0] for env in (plain, drawn)]
    np.testing.assert_array_equal(*first)
    for action in random_actions(1, 10, plain.action_space.shape):
        ours = [env.step(action) for env in (plain, drawn)]
        drawn.render()
        np.testing.assert_array_equal(ours[0][0], ours[1][0])
        assert ours[0][1] == ours[1][1]


def test_opencv_is_loaded_by_the_first_picture():
    code = (
        "import sys, gymnasium as gym\n"
        f"env = gym.make({ENV_NAME!r}, render_mode='rgb_array')\n"
        "env.reset(seed=0)\n"
        "assert 'cv2' not in sys.modules\n"
        "env.render()\n"
        "assert 'cv2' in sys.modules\n"
        "assert not {'matplotlib', 'pygame', 'torch'} & set(sys.modules)\n"
    )
    root = Path(__file__).resolve().parent.parent
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, cwd=root, timeout=120)


# ---- live routes -------------------------------------------------------------------------


class Mean(Technique):
    """The mean colour, so that every image of :func:`shades` is at its own place."""

    name = "Mean"

    def describe(self, image):
        angle = image.mean() / 255.0
        return np.array([np.cos(angle), np.sin(angle)], np.float32)


def mean_map(images) -> DescribedMap:
    block = np.stack([Mean().describe(image) for image in images])
    return DescribedMap(Mean(), [block], threads=1)


def shades(count: int) -> list[np.ndarray]:
    return [np.full((30, 40, 3), 20 * i, np.uint8) for i in range(count)]


def test_a_live_route_shows_its_camera():
    images = shades(9)
    route = LiveRoute([mean_map(images)], images, tolerance=0, seconds=[1.0], name="live")
    env = TechniqueSelectionEnv(route, render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    env.step([1])
    env.step([1])
    scene = env._viewer._scene(0, env.task.episodes.routes[0])
    np.testing.assert_array_equal(scene.query, images[1])
    assert scene.place is None
    assert scene.milliseconds[0] > 0.0
    panel = layout.LEFT_PANEL
    assert (env.render()[panel.top + 100, panel.left + 200] == 20).all()
    assert (before[panel.top + 100, panel.left + 200] == 255).all()


def test_a_live_route_with_images_of_its_map_shows_the_matched_one():
    images = shades(9)
    route = LiveRoute([mean_map(images)], images[3:], tolerance=0, seconds=[1.0], places=images)
    env = TechniqueSelectionEnv(route, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == SHAPE
    *_, info = env.step([1])
    assert info["prediction"] == 3
    scene = env._viewer._scene(0, env.task.episodes.routes[0])
    np.testing.assert_array_equal(scene.place, images[3])


class Endless:
    """A camera: it has no length, and ends."""

    name, length, random_access = "endless", None, False

    def read(self, frame: int):
        return shades(9)[frame] if frame < 3 else None

    def rewind(self) -> None:
        """Nothing to do."""


def test_a_route_of_unknown_length_is_drawn_without_one():
    route = LiveRoute([mean_map(shades(9))], Endless(), tolerance=0, seconds=[1.0])
    env = TechniqueSelectionEnv(route, render_mode="rgb_array")
    env.reset(seed=0)
    env.step([1])
    assert env._viewer._scene(0, env.task.episodes.routes[0]).frames is None
    assert env.render().shape == SHAPE
    for _ in range(2):
        env.step([1])
    assert env.step([1])[2]  # the end is a step without a frame
    assert len(env._viewer.trails[0]) == 3
    assert env.render().shape == SHAPE


# ---- the window --------------------------------------------------------------------------


def test_the_window_shows_every_step_by_itself(bank, pygame):
    silent = TechniqueSelectionEnv(bank, render_mode="rgb_array")
    env = gym.make(ENV_NAME, bank=bank, render_mode="human")
    assert pygame.display.get_surface() is None  # it opens with the first picture
    env.reset(seed=0)
    silent.reset(seed=0)
    np.testing.assert_array_equal(on_screen(pygame), silent.render())
    env.step([1, 0, 1])
    silent.step([1, 0, 1])
    np.testing.assert_array_equal(on_screen(pygame), silent.render())
    assert env.render() is None
    env.close()
    assert pygame.display.get_surface() is None
    env.close()


def test_the_window_keeps_to_its_pace(bank, pygame):
    env = TechniqueSelectionEnv(bank, render_mode="human")
    env.reset(seed=0)
    begin = pygame.time.get_ticks()
    for _ in range(4):
        env.step([1, 0, 0])
    assert pygame.time.get_ticks() - begin > 250  # four of a tenth of a second, less the first
    env.close()


def test_the_vector_environment_shows_its_routes_side_by_side(bank, pygame):
    env = TechniqueSelectionVectorEnv(MOST_SHOWN + 2, bank, render_mode="human")
    env.reset(seed=0)
    assert env.render() is None
    alike = TechniqueSelectionVectorEnv(MOST_SHOWN + 2, bank, render_mode="rgb_array")
    alike.reset(seed=0)
    expected = layout.tile(alike.render()[:MOST_SHOWN])
    np.testing.assert_array_equal(on_screen(pygame), expected)
    env.close()
    env.close()
    assert pygame.display.get_surface() is None


def test_who_closes_the_window_is_left_in_peace(bank, pygame):
    env = TechniqueSelectionEnv(bank, render_mode="human")
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    env.step([1, 0, 0])
    assert env._viewer.window.closed_by_user
    assert pygame.display.get_surface() is None
    env.step([1, 0, 0])
    assert pygame.display.get_surface() is None
    env.close()


def test_a_copy_with_a_window_opens_its_own(bank, pygame):
    env = driven(TechniqueSelectionEnv(bank, render_mode="human"), 1)
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert twin._viewer.window._surface is None
        twin.step([1, 1, 1])
        assert twin._viewer.window._surface is not None
        twin.close()


def test_a_second_window_leaves_the_first_one_usable(bank, pygame):
    first = driven(TechniqueSelectionEnv(bank, render_mode="human"), 1)
    second = driven(TechniqueSelectionEnv(bank, render_mode="human"), 1)
    second.close()
    first.step([1, 0, 0])
    assert pygame.display.get_surface() is not None
    first.close()


def test_32_a_window_without_pygame_names_the_command(bank, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "pygame" else find(name, *a)
    )
    words = r'needs pygame.*pip install "amusic-gym\[human\]"'
    with pytest.raises(ImportError, match=words):
        TechniqueSelectionEnv(bank, render_mode="human")
    with pytest.raises(ImportError, match=words):
        TechniqueSelectionVectorEnv(2, bank, render_mode="human")
    for mode in ("ansi", "rgb_array"):
        TechniqueSelectionEnv(bank, render_mode=mode)


def test_without_a_screen_the_refusal_says_what_to_do(bank, pygame, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no such driver")
    pygame.display.quit()
    env = TechniqueSelectionEnv(bank, render_mode="human")
    with pytest.raises(OSError, match="no window can be opened here .*SDL_VIDEODRIVER=dummy"):
        env.reset(seed=0)
    env.close()


def test_pygame_comes_without_a_greeting(pygame, capfd):
    code = (
        "import numpy as np; from amusic_gym.envs.window import Window\n"
        "w = Window('t'); w.show(np.zeros((9, 9, 3), np.uint8)); w.close()"
    )
    root = Path(__file__).resolve().parent.parent
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, cwd=root, timeout=60)
    assert capfd.readouterr().out == ""
    Window("never shown").close()


# ---- Gymnasium and Stable-Baselines3 -----------------------------------------------------


@pytest.mark.parametrize("mode", [*PICTURE_MODES, "ansi"])
def test_gymnasiums_checker_passes_with_every_mode(bank, pygame, mode):
    check_env(gym.make(ENV_NAME, bank=bank, render_mode=mode).unwrapped)  # a warning is an error


def test_gymnasiums_wrapper_collects_pictures(bank):
    env = driven(gym.make(ENV_NAME, bank=bank, render_mode="rgb_array_list"), 3)
    pictures = env.render()
    assert [p.shape for p in pictures] == [SHAPE] * 4


@pytest.fixture
def moviepy(monkeypatch):
    """Stands in for MoviePy, which need not be installed, and keeps what it is given."""
    clips = []

    class ImageSequenceClip:
        def __init__(self, frames, fps) -> None:
            self.frames, self.fps = list(frames), fps
            clips.append(self)

        def write_videofile(self, path, logger=None) -> None:
            Path(path).write_bytes(b"a video")

    for name in ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.x"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    inner = types.ModuleType("moviepy.video.io.ImageSequenceClip")
    inner.ImageSequenceClip = ImageSequenceClip
    monkeypatch.setitem(sys.modules, inner.__name__, inner)
    return clips


def test_gymnasium_records_a_video(bank, moviepy, tmp_path):
    env = gym.make(ENV_NAME, bank=random_bank(4, queries=5), render_mode="rgb_array")
    env = gym.wrappers.RecordVideo(
        env, str(tmp_path / "films"), episode_trigger=lambda episode: True
    )
    driven(env, 5)
    env.close()
    assert [clip.fps for clip in moviepy] == [10]
    assert [frame.shape for frame in moviepy[0].frames] == [SHAPE] * 6
    assert [path.suffix for path in (tmp_path / "films").iterdir()] == [".mp4"]


def test_stable_baselines_makes_it_and_records_a_video(bank, moviepy, tmp_path):
    routes = make_vec_env(ENV_NAME, n_envs=2, env_kwargs={"bank": bank})
    assert routes.render_mode == "rgb_array"
    routes = VecVideoRecorder(routes, str(tmp_path), lambda step: step == 0, video_length=3)
    routes.reset()
    for _ in range(4):
        routes.step(np.ones((2, 3)))
    routes.close()
    shapes = {frame.shape for clip in moviepy for frame in clip.frames}
    assert shapes == {(540, 1920, 3)} or shapes == {(1080, 960, 3)}
