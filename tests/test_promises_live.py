"""Promises of the environment and of images, kept where the images are live."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from env_cases import assert_same, digest, play, random_actions
from gymnasium.vector import AsyncVectorEnv
from live_cases import Broken, Columns, live_of, map_of, maps_of, policy_on, traverse

from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.extraction.blocks import BLOCK
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.live.navigation import navigate

pytestmark = pytest.mark.slow

CHILD = """
import pickle, sys
from env_cases import digest
env, actions = pickle.load(open(sys.argv[1], "rb"))
print(digest([env.step(action) for action in actions]))
"""


def folder_of(path: Path, frames: int) -> Path:
    path.mkdir()
    for i, image in enumerate(traverse(frames, 2)):
        cv2.imwrite(str(path / f"{i}.png"), image)
    return path


def spoilt(where: int, spoil) -> TechniqueSelectionEnv:
    """An environment on a route of which one frame is dark, and HOG gives rubbish for it."""
    images = traverse(8, 2)
    images[where] = np.zeros_like(images[where])
    maps = [map_of(traverse(9, 1), Broken(spoil)), map_of(traverse(9, 1), Columns("CALC", 1, 1))]
    return TechniqueSelectionEnv(live_of(maps, images))


def test_01_same_actions_same_trajectory_single_and_vector():
    live = live_of(maps_of(9), traverse(20, 2))
    actions = random_actions(1, 20, (4,))
    single = TechniqueSelectionEnv(live, reselection=3)
    first = play(single, actions, 5)
    assert_same(play(single, actions, 5), first)
    vector = TechniqueSelectionVectorEnv(1, live, reselection=3)
    rewards = [step[1][0] for step in play(vector, actions[:, None], 5)[1:]]
    assert rewards == [step[1] for step in first[1:21]]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_11_a_forked_worker_matches_on_threads_of_its_own():
    """The map has several blocks, and its threads have begun in the parent."""
    one = map_of(traverse(BLOCK + 10, 1), Columns("HOG", 1, 0))
    several = DescribedMap(one.technique, list(one), threads=2)
    live = live_of([several], traverse(8, 2))
    actions = np.ones((6, 2, 1), np.int8)
    expected = play(TechniqueSelectionVectorEnv(2, live), actions, 5)
    assert several._pool is not None
    workers = AsyncVectorEnv([lambda: TechniqueSelectionEnv(live)] * 2, context="fork")
    try:
        steps = [workers.reset(seed=5)]
        for action in actions:
            workers.step_async(action)
            steps.append(workers.step_wait(timeout=30))
        for got, wanted in zip(steps, expected, strict=False):
            assert_same(got[0], wanted[0])
    finally:
        workers.close(terminate=True)
    several.close()


@pytest.mark.parametrize("way", ["deepcopy", "pickle", "another process"])
def test_02_a_copy_of_an_environment_on_a_folder_continues_identically(way, tmp_path):
    live = live_of(maps_of(9), folder_of(tmp_path / "query", 24))
    env = TechniqueSelectionEnv(live, reselection=4, history=5)
    actions = random_actions(2, 24, (4,), reselect=0.2)
    env.reset(seed=0)
    for action in actions[:12]:
        env.step(action)
    if way == "another process":
        (tmp_path / "env").write_bytes(pickle.dumps((env, actions[12:])))
        command = [sys.executable, "-W", "error", "-c", CHILD, str(tmp_path / "env")]
        root = Path(__file__).resolve().parent.parent
        path = {"PYTHONPATH": f"{root / 'tests/support'}:{root}"}
        done = subprocess.run(
            command, env=path, capture_output=True, text=True, check=True, timeout=120
        )
        assert done.stdout.strip() == digest([env.step(action) for action in actions[12:]])
        return
    twin = copy.deepcopy(env) if way == "deepcopy" else pickle.loads(pickle.dumps(env))
    wanted = [env.step(action) for action in actions[12:]]
    assert_same([twin.step(action) for action in actions[12:]], wanted)


def test_05_overwriting_what_is_returned_changes_nothing():
    live = live_of(maps_of(9), traverse(20, 2))
    env, twin = (TechniqueSelectionEnv(live, reselection=3) for _ in range(2))
    env.reset(seed=0)
    twin.reset(seed=0)
    for action in random_actions(3, 20, (4,), reselect=0.3):
        given, wanted = env.step(action), twin.step(action)
        assert_same(given, wanted)
        given[0].fill(-7.0)
        for value in given[4].values():
            if isinstance(value, np.ndarray):
                value.fill(1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_13_a_score_that_is_not_finite_is_refused_naming_technique_and_frame(bad):
    def spoil(scores):
        return np.where(np.arange(scores.size) == 2, bad, scores)

    env = spoilt(3, spoil)
    env.reset(seed=0)
    for _ in range(3):
        env.step([1, 1])
    with pytest.raises(ValueError, match=r"technique 'HOG' at frame 3 of 'pair'.*NaN or infinity"):
        env.step([1, 1])
    env.reset(seed=0)
    for _ in range(8):  # the frame is no trouble for the other one
        env.step([0, 1])


def test_13_a_constant_row_gives_zeros():
    env = spoilt(3, lambda scores: np.full_like(scores, 2.0))
    env.reset(seed=0)
    for _ in range(8):
        observation, _, _, _, info = env.step([1, 0])
        assert np.isfinite(observation).all()
        assert np.isfinite(info["statistic"]).all()


@pytest.mark.parametrize("spoil", [lambda s: s[:-1], lambda s: s[:, None], lambda s: s[0]])
def test_13_scores_of_another_shape_are_refused(spoil):
    env = spoilt(0, spoil)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"technique 'HOG' at frame 0 of 'pair'.*one number for"):
        env.step([1, 0])


@pytest.mark.parametrize("spoil", [b"", b"garbage", None])
def test_15_16_an_image_that_cannot_be_read_is_refused_with_its_path(spoil, tmp_path):
    query = folder_of(tmp_path / "query", 6)
    live = live_of(maps_of(9), query)
    image = query / "4.png"
    whole = image.read_bytes()
    image.write_bytes(whole[: len(whole) * 2 // 3] if spoil is None else spoil)
    seen = []
    with pytest.raises(ValueError, match=r"query/4\.png"):
        seen.extend(s.frame for s in navigate(policy_on("music", live), live))
    image.unlink()
    with pytest.raises(FileNotFoundError, match=r"query/4\.png"):
        list(navigate(policy_on("raw:HOG", live), live))
    image.write_bytes(whole)
    assert len(list(navigate(policy_on("music", live), live))) == 6
