"""Live routes: the same as a bank of the same images, bit for bit, and only what is asked for."""

from __future__ import annotations

import copy
import pickle
import re
import warnings
import zlib
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import oracle
import pytest
from env_cases import assert_same, infos_of, play, random_actions
from hypothesis import given, settings
from hypothesis import strategies as st
from live_cases import (
    NAMES,
    SECONDS,
    Columns,
    CountingMap,
    Stream,
    bank_of,
    live_of,
    map_of,
    maps_of,
    pair,
    techniques,
    traverse,
)

from amusic_gym.banks.costs import PAPER_SECONDS
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.frames import ImageSequence, as_frames
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

cached_pair = cache(pair)


def drive_of(env):
    return env.task.episodes.drives[0]


# ---- the same as a bank ------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_actions_give_what_the_bank_gives(data):
    arguments = {
        "history": data.draw(st.sampled_from([0, 1, 3, 8, 1000])),
        "gamma": data.draw(st.sampled_from([1.0, 0.9])),
        "statistic": data.draw(st.sampled_from(["evidence", "mean"])),
        "reselection": data.draw(st.sampled_from([None, 1, 3, 7])),
        "allow_idle": data.draw(st.booleans()),
        "candidates": data.draw(st.sampled_from([1, 5, 50])),
        "random_start": data.draw(st.booleans()),
        "episode_length": data.draw(st.sampled_from([None, 25])),
    }
    density = data.draw(st.sampled_from([0.03, 0.2, 0.7]))
    reselect = data.draw(st.sampled_from([0.02, 0.2]))
    seed = data.draw(st.integers(0, 2**32 - 1))
    pairs = [(90, 9), (70, 40)]
    bank, live = cached_pair(*data.draw(st.sampled_from(pairs)))
    width = len(NAMES) + (arguments["reselection"] is not None)
    rng = np.random.default_rng(seed)
    actions = rng.random((110, width)) < density
    if arguments["reselection"]:
        actions[:, -1] = rng.random(110) < reselect
    wanted = play(TechniqueSelectionEnv(bank, **arguments), actions, seed)
    assert_same(play(TechniqueSelectionEnv(live, **arguments), actions, seed), wanted)


class Masking:
    """A map on which some places are no candidates, and all of them of some rows."""

    def __init__(self, described) -> None:
        self.described = described
        self.technique, self.references = described.technique, described.references
        self.describe_query = described.describe_query

    def scores(self, query):
        row = self.described.scores(query).copy()
        rng = np.random.default_rng(zlib.crc32(row.tobytes()))
        row[rng.random(row.size) < rng.uniform(0.0, 1.2)] = -np.inf
        return row


@pytest.mark.parametrize("statistic", ["evidence", "mean", "belief"])
@pytest.mark.parametrize("block", [None, 4])
def test_49_masked_rows_give_what_the_bank_gives(statistic, block):
    maps, images = [Masking(one) for one in maps_of(20)], traverse(40, seed=2)
    bank = bank_of(maps, images)
    assert 0.2 < np.isneginf(bank.scores).mean() < 0.9
    assert np.isneginf(bank.scores).all(axis=2).any()
    arguments = {"statistic": statistic, "reselection": block, "history": 8}
    actions = random_actions(7, 39, (len(NAMES) + (block is not None),), reselect=0.1)
    wanted = play(TechniqueSelectionEnv(bank, **arguments), actions)
    live = live_of(maps, images, ground_truth=bank.truth)
    assert_same(play(TechniqueSelectionEnv(live, **arguments), actions), wanted)


@pytest.mark.parametrize(
    ("queries", "references", "history", "block"),
    [(400, 150, 90, 6), (90, 9, 8, None), (90, 9, 8, 3), (90, 9, 30, 3), (90, 40, 20, None)],
)
def test_rows_outlive_the_rings_doublings_and_its_end(queries, references, history, block):
    bank, live = cached_pair(queries, references)
    arguments = {"history": history, "reselection": block}
    actions = random_actions(3, queries - 1, (3 + (block is not None),), reselect=0.05)
    actions[:, 0] = 1
    actions[queries // 2 : queries // 2 + history, 1] = 0
    env = TechniqueSelectionEnv(live, **arguments)
    assert_same(play(env, actions), play(TechniqueSelectionEnv(bank, **arguments), actions))
    most = min(history, references) + 2 * (block or 0) + 4
    assert len(drive_of(env).buffers[0].rows) == min(most, 64 if queries == 90 else most)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_banks_and_live_routes_in_one_batch(mode):
    bank, live = cached_pair(70, 40)
    other, _ = cached_pair(90, 9)
    arguments = {"autoreset_mode": mode, "reselection": 4, "episode_length": 18, "slots": 4}
    actions = random_actions(5, 60, (3, 5))

    def played(first):
        env = TechniqueSelectionVectorEnv(3, [first, other], **arguments)
        return play(env, actions)

    assert_same(played(live), played(bank))


def test_the_bits_of_an_extracted_bank(tmp_path):
    from amusic_gym.extraction.extract import extract
    from amusic_gym.extraction.map import describe_map
    from amusic_gym.routes.folders import ImageFolder

    folders = []
    for name, frames, seed in (("reference", 70, 1), ("query", 12, 2)):
        (tmp_path / name).mkdir()
        for i, image in enumerate(traverse(frames, seed)):
            cv2.imwrite(str(tmp_path / name / f"{i:03}.png"), image)
        folders.append(ImageFolder(tmp_path / name))
    reference, query = folders
    seconds = dict(zip(NAMES, SECONDS, strict=True))
    options = {"seconds": seconds, "ground_truth": np.arange(12), "cache": tmp_path / "c"}
    bank = extract(reference, query, techniques(), tolerance=1, **options)
    maps = [describe_map(reference, t, cache=tmp_path / "c") for t in techniques()]
    live = LiveRoute(
        maps, tmp_path / "query", ground_truth=bank.truth, tolerance=1, seconds=SECONDS
    )
    assert (live.name, live.queries, live.references) == ("query", 12, 70)
    actions = random_actions(1, 12, (4,), reselect=0.3)
    first, second = (TechniqueSelectionEnv(b, reselection=3) for b in (bank, live))
    assert_same(play(second, actions), play(first, actions))


# ---- only what is asked for --------------------------------------------------------------------


def test_only_what_the_policy_activates_is_computed():
    maps = [CountingMap(one) for one in maps_of(20)]
    live = live_of(maps, traverse(30, 2))
    assert [one.calls for one in maps] == [0, 0, 0]
    env = TechniqueSelectionEnv(live, reselection=4)
    env.reset(seed=0)
    runs, timed = np.zeros(3, np.int64), np.zeros(3, np.bool_)
    for action in random_actions(8, 30, (4,), reselect=0.2):
        _, _, _, _, info = env.step(action)
        runs += info["ran"] + info["selection"]["late_runs"]
        drive = drive_of(env)
        np.testing.assert_array_equal(drive.milliseconds > 0, info["ran"])
        np.testing.assert_array_equal(
            drive.late_milliseconds > 0, info["selection"]["late_runs"] > 0
        )
        timed |= drive.late_milliseconds > 0
        assert drive.read_milliseconds > 0
    assert [one.calls for one in maps] == runs.tolist()
    assert timed.any()


def test_nothing_runs_on_an_idle_frame():
    maps = [CountingMap(one) for one in maps_of(20)]
    env = TechniqueSelectionEnv(live_of(maps, traverse(5, 2)), allow_idle=True)
    env.reset(seed=0)
    assert env.step([0, 0, 0])[4]["idle"]
    assert sum(one.calls for one in maps) == 0


# ---- costs -------------------------------------------------------------------------------------


def test_costs_are_given_measured_or_of_a_model():
    maps, images = maps_of(20), traverse(5, 2)
    assert live_of(maps, images).seconds.tolist() == list(SECONDS)
    measured = LiveRoute(maps, images, tolerance=1)
    assert (measured.seconds > 0).all()
    assert measured.costs == "measured"
    assert LiveRoute(maps, images, tolerance=1, costs="runs").seconds.tolist() == [1, 1, 1]
    paper = measured.with_costs("paper")
    assert paper.seconds.tolist() == [PAPER_SECONDS[name] for name in NAMES]
    assert paper.with_costs("measured").seconds is measured.seconds
    env = TechniqueSelectionEnv(measured, costs="paper")
    env.reset(seed=0)
    assert env.step([1, 0, 1])[4]["seconds"] == PAPER_SECONDS["HOG"] + PAPER_SECONDS["CoHOG"]


def test_the_wall_time_is_charged_if_asked_for():
    live = live_of(maps_of(20), traverse(30, 2), charge_wall_time=True)
    env = TechniqueSelectionEnv(live, reselection=3, compute_weight=2.0)
    env.reset(seed=0)
    for action in ([1, 0, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1], [0, 1, 0, 0]):
        _, _, _, _, info = env.step(action)
        drive = drive_of(env)
        wall = (drive.milliseconds.sum() + drive.late_milliseconds.sum()) / 1000
        assert info["seconds"] == wall > 0
        assert info["reward_terms"]["compute"] == pytest.approx(-2.0 * wall / sum(SECONDS))
    assert env.task.episodes.state.routes["compute_mean"][0] < 1e-2


# ---- sources of unknown length -----------------------------------------------------------------


@pytest.mark.parametrize("knows", [True, False])
def test_a_stream_ends_with_its_last_frame(knows):
    maps, images = maps_of(20), traverse(30, 2)
    live = live_of(maps, Stream(images, knows))
    assert live.queries is None
    env = TechniqueSelectionEnv(live, reselection=4)
    actions = random_actions(2, 31, (4,))
    wanted = play(TechniqueSelectionEnv(bank_of(maps, images), reselection=4), actions[:30])
    for _ in range(2):  # a second episode, too
        first, *steps = [env.reset(seed=0), *(env.step(action) for action in actions[:29])]
        steps.append(env.step(actions[29]))
        assert steps[-1][2] == knows
        if not knows:
            observation, reward, terminated, truncated, info = env.step(actions[30])
            assert (reward, terminated, truncated, info["frame"]) == (0.0, True, False, 29)
            assert not info["ran"].any()
            assert set(info["reward_terms"].values()) == {0.0}
            np.testing.assert_array_equal(observation, steps[-1][0])
            steps[-1] = (*steps[-1][:2], True, *steps[-1][3:])
        assert_same([first, *steps], wanted[:31])


@pytest.mark.parametrize(
    ("statistic", "longest", "shape"),
    [("evidence", "sums", (2, 1, 3, 20 + 512)), ("belief", "hubs", (2, 1, 3, 20))],
)
def test_the_memory_of_an_endless_route_is_bounded(statistic, longest, shape):
    images = traverse(40, 2)

    class Endless(Stream):
        def read(self, frame):
            return images[frame % 40]

    live = live_of(maps_of(20), Endless(images))
    env = TechniqueSelectionEnv(live, statistic=statistic, history=30, reselection=5)
    env.reset(seed=0)
    sizes = {}
    for frame, action in enumerate(random_actions(2, 2200, (4,))):
        env.step(action)
        if frame in (1000, 2199):
            drive, episodes = drive_of(env), env.task.episodes
            sizes[frame] = (
                [buffer.rows.shape for buffer in drive.buffers],
                len(drive._images),
                getattr(episodes.estimator.state, longest).shape,
                episodes.state.ran.shape,
            )
    assert sizes[1000] == ([(20 + 10 + 4, 20)] * 3, 6, shape, (1, 3, 1024))
    assert sizes[2199] == sizes[1000]
    assert drive_of(env).entries.shape == (3, 64)
    assert env.task.describe(0).startswith("pair frame 2200: place")


@pytest.mark.parametrize(
    ("places", "options", "idle"),
    [
        (12, {"reselection": 5, "statistic": "belief"}, 0.3),
        (12, {"history": 7, "gamma": 0.9, "statistic": "mean", "allow_idle": True}, 0.8),
        (12, {"history": 3, "reselection": 2, "allow_idle": True}, 0.97),
        pytest.param(600, {"reselection": 5}, 0.0, marks=pytest.mark.slow),
        # Rows are taken out of the sums, and looked for, as long after as they are on the map.
        pytest.param(700, {"history": 5, "allow_idle": True}, 0.995, marks=pytest.mark.slow),
    ],
)
def test_a_long_stream_gives_what_the_bank_gives(places, options, idle):
    """Memory of 1,024 frames is used again twice or, of a long map, doubled first."""
    frames = 2200
    maps, images = maps_of(places), traverse(40, 2) * (frames // 40)
    size = len(maps) + ("reselection" in options)
    actions = random_actions(2, frames - 1, (size,), reselect=0.01)
    actions[:, : len(maps)] &= np.random.default_rng(0).random((frames - 1, len(maps))) >= idle
    actions[501:1100, 1] = actions[1102:2000, 1] = 0
    actions[[500, 1101], 1] = 1  # a row that leaves the sums, or the map, long after it came
    first = TechniqueSelectionEnv(bank_of(maps, images), **options)
    second = TechniqueSelectionEnv(live_of(maps, Stream(images)), **options)
    wanted = play(first, actions)
    assert_same(play(second, actions), wanted)
    if "reselection" not in options and places == 12:  # a drive begins anew after a long one
        begun = second.reset(seed=0)
        assert_same(begun, first.reset(seed=0))
        assert_same(second.step(actions[0]), first.step(actions[0]))


def test_a_long_stream_gives_what_explicit_loops_give():
    settings = {"candidates": 9, "history": 8, "statistic": "mean"}
    maps, images = maps_of(20), traverse(50, 2) * 44
    actions = random_actions(3, len(images) - 1, (3,))
    actions[1100:1500, 0] = 0
    env = TechniqueSelectionEnv(
        live_of(maps, Stream(images)), carry=False, discount=False, **settings
    )
    infos = infos_of(env, actions)
    scores = bank_of(maps, images).scores
    ran = np.array([info["ran"] for info in infos])
    for frame in (5, 1020, 1023, 1024, 1025, 1030, 1300, 1535, 1536, 1537, 1600, 2047, 2048, 2195):
        begin = max(0, frame - 60)  # further back is off the map
        part = [scores[:, begin : frame + 1], ran[begin : frame + 1], frame - begin]
        found = oracle.music(*part, settings["candidates"], settings["history"], statistic="mean")
        assert infos[frame]["prediction"] == found.place
        assert infos[frame]["technique"] == found.technique
        assert infos[frame]["confidence"] == pytest.approx(found.confidence, abs=1e-9)


def test_a_route_of_unknown_length_starts_at_its_beginning():
    env = TechniqueSelectionEnv(live_of(maps_of(9), Stream(traverse(5, 2))), random_start=True)
    assert env.reset(seed=0, options={"start": 0})[1]["frame"] == -1
    with pytest.raises(ValueError, match=r"start is 2; 'pair' does not know its length"):
        env.reset(options={"start": 2})


def test_a_source_that_ends_too_soon_is_refused():
    class Short(ImageSequence):
        def read(self, frame):
            return None if frame == 3 else super().read(frame)

    env = TechniqueSelectionEnv(live_of(maps_of(9), Short(traverse(5, 2))))
    env.reset(seed=0)
    for _ in range(3):
        env.step([1, 0, 0])
    with pytest.raises(ValueError, match=r"'pair' ended after 3 frames; its source must give 5"):
        env.step([1, 0, 0])
    env = TechniqueSelectionEnv(live_of(maps_of(9), Stream([])))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="ended after 0 frames; its source must give at least one"):
        env.step([1, 0, 0])


# ---- copies and drivers ------------------------------------------------------------------------


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_continues_identically(twin):
    _, live = cached_pair(90, 9)
    env = TechniqueSelectionEnv(live, reselection=5, history=7)
    actions = random_actions(4, 80, (4,), reselect=0.2)
    env.reset(seed=0)
    for action in actions[:40]:
        env.step(action)
    other = twin(env)
    wanted = [env.step(action) for action in actions[40:]]
    assert_same([other.step(action) for action in actions[40:]], wanted)
    assert_same(play(other, actions, 7), play(env, actions, 7))


def test_a_stream_is_not_copied():
    live = live_of(maps_of(9), Stream(traverse(5, 2)))
    env = TechniqueSelectionEnv(live)
    copy.deepcopy(env)  # nothing of it is driven yet
    env.reset(seed=0)
    with pytest.raises(TypeError, match="'pair' cannot be copied while it is driven: its Stream"):
        copy.deepcopy(env)
    with pytest.raises(TypeError, match="'pair' cannot be pickled: its Stream"):
        pickle.dumps(live)


def test_only_one_drives_a_stream():
    live = live_of(maps_of(9), Stream(traverse(9, 2)))
    first, second = TechniqueSelectionEnv(live), TechniqueSelectionEnv(live.with_costs("measured"))
    first.reset(seed=0)
    first.step([1, 0, 0])
    second.reset(seed=0)
    with pytest.raises(ValueError, match="'pair' is driven by another environment or route now"):
        first.step([1, 0, 0])
    assert second.step([1, 0, 0])[4]["frame"] == 0
    first.reset(seed=0)
    assert first.step([1, 0, 0])[4]["frame"] == 0


def test_many_drive_a_folder():
    bank, live = cached_pair(90, 9)
    actions = random_actions(4, 30, (3, 3))
    first, second = (TechniqueSelectionVectorEnv(3, b, random_start=True) for b in (bank, live))
    assert_same(play(second, actions), play(first, actions))


# ---- refusals ----------------------------------------------------------------------------------


def test_an_error_ends_the_episode_but_not_the_environment(tmp_path):
    images = traverse(8, 2)
    for i, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{i}.png"), image)
    live = live_of(maps_of(9), tmp_path)
    env = TechniqueSelectionEnv(live)
    wanted = play(env, [[1, 0, 1]] * 7)
    broken, whole = tmp_path / "4.png", (tmp_path / "4.png").read_bytes()
    broken.write_bytes(whole[: len(whole) // 2])
    env.reset(seed=0)
    for _ in range(4):
        env.step([1, 0, 1])
    for _ in range(2):  # nothing was taken of the frame: it may be tried again
        with pytest.raises(ValueError, match=re.escape(str(broken))):
            env.step([1, 0, 1])
    broken.write_bytes(whole)
    assert_same(env.step([1, 0, 1]), wanted[5])
    assert_same(play(env, [[1, 0, 1]] * 7), wanted)


def test_after_a_techniques_error_comes_a_reset():
    images = traverse(6, 2)
    maps = maps_of(9)
    dark = [*images[:3], np.zeros_like(images[0]), *images[4:]]

    class Afraid(Columns):
        def describe_query(self, image):
            if not image.any():
                raise ValueError("too dark")
            return self.describe(image)

    maps[1] = map_of(traverse(9, 1), Afraid("CALC", 2, 1))
    env = TechniqueSelectionEnv(live_of(maps, dark), reselection=2)
    env.reset(seed=0)
    for _ in range(3):
        env.step([1, 1, 0, 0])
    with pytest.raises(ValueError, match=r"^technique 'CALC' at frame 3 of 'pair': .*too dark"):
        env.step([1, 1, 0, 0])
    with pytest.raises(ValueError, match="an error cut the last step short; call reset"):
        env.step([1, 0, 0, 0])
    bank = TechniqueSelectionEnv(bank_of(maps_of(9), dark), reselection=2)
    actions = [[1, 0, 1, 0]] * 6
    assert_same(play(env, actions), play(bank, actions))


def test_what_is_no_live_route_is_refused():
    maps, images = maps_of(9), traverse(5, 2)
    cases = [
        (lambda: LiveRoute([], images, tolerance=1), "no map; give at least one"),
        (lambda: LiveRoute([maps[0], maps_of(8)[1]], images, tolerance=1), "HOG 9, CALC 8 places"),
        (lambda: LiveRoute([maps[0]] * 2, images, tolerance=1), "'HOG' is named twice"),
        (lambda: LiveRoute(maps, [], tolerance=1), "no image; a route has at least one frame"),
        (lambda: LiveRoute(maps, 3, tolerance=1), "frames are 3; give a folder"),
        (lambda: LiveRoute(maps, images), "tolerance is None"),
        (lambda: LiveRoute(maps, Stream([]), tolerance=1), "'stream' has no frame"),
        (lambda: live_of(maps, images, costs="free"), "unknown cost model 'free'"),
        (lambda: live_of(maps, images).with_costs("free"), "unknown cost model 'free'"),
        (lambda: live_of(maps, images, costs="runs").with_costs("measured"), "cost model 'runs'"),
        (lambda: live_of(maps, images, seconds=[1, 2]), "one number for each of the 3"),
        (lambda: live_of(maps, images, charge_wall_time=1), "charge_wall_time is 1"),
        (lambda: live_of(maps, images, charge_wall_time=True).with_costs("runs"), "wall time"),
        (
            lambda: live_of(maps, Stream(images), ground_truth=np.arange(5)),
            "ground truth for a source of unknown length",
        ),
        (lambda: live_of(maps, images, ground_truth=np.arange(4)), "5 queries"),
    ]
    for make, sentence in cases:
        with pytest.raises(ValueError, match=re.escape(sentence)):
            make()
    with pytest.raises(FileNotFoundError, match="nowhere"):
        as_frames(Path("nowhere"))


def test_a_reward_from_ground_truth_needs_some():
    bank, live = cached_pair(70, 40)
    first, second = (TechniqueSelectionEnv(b, reward="ground_truth") for b in (bank, live))
    assert_same(play(second, [[1, 1, 0]] * 20), play(first, [[1, 1, 0]] * 20))
    env = TechniqueSelectionEnv(live_of(maps_of(9), traverse(5, 2)), reward="ground_truth")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="'pair' has no ground truth, which the reward asks for"):
        env.step([1, 0, 0])


# ---- training ----------------------------------------------------------------------------------


def test_stable_baselines3_trains_on_images():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from stable_baselines3 import PPO

    bank, live = cached_pair(70, 40)
    weights = []
    for source in (bank, live):
        model = PPO("MlpPolicy", TechniqueSelectionEnv(source), n_steps=16, batch_size=16, seed=1)
        model.learn(16)
        weights.append([p.detach().numpy() for p in model.policy.parameters()])
    assert_same(weights[0], weights[1])
