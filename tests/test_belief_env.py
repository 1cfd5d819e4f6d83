"""The belief in the environments: re-selection, batches, live routes, copies, memory, errors."""

from __future__ import annotations

import copy
import pickle
from functools import cache

import numpy as np
import oracle_belief
import pytest
from belief_cases import CLOSE, assert_frame, belief_of, settings_of, summary_of
from env_cases import arrays, assert_same, noisy_bank, play, random_actions, random_bank
from hypothesis import given, settings
from hypothesis import strategies as st
from live_cases import NAMES, Stream, bank_of, live_of, maps_of, pair, traverse

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

pytestmark = pytest.mark.slow

cached_pair = cache(pair)
BELIEF = {"statistic": "belief", "allow_idle": True}


def selecting(seed: int, steps: int, techniques: int, activity=0.5, reselect=0.15):
    """(steps, T + 1) bits, the last one to re-select."""
    rng = np.random.default_rng(seed)
    actions = rng.random((steps, techniques + 1)) < activity
    actions[:, -1] = rng.random(steps) < reselect
    return actions


# ---- the re-select bit -------------------------------------------------------------------


def assert_selection(found: dict, expected: oracle_belief.Selection | None) -> None:
    assert found["happened"] == (expected is not None)
    if expected is None:
        assert not found["late_runs"].any()
        return
    size = len(expected.corrections)
    assert found["tally"].tolist() == expected.tally
    assert np.flatnonzero(found["selected"]).tolist() == expected.chosen
    assert found["late_runs"].tolist() == expected.late_runs
    corrections = np.transpose(found["corrections"])
    np.testing.assert_allclose(corrections[:size], expected.corrections, rtol=0, atol=10 * CLOSE)
    assert not corrections[size:].any()


def compare(bank: ScoreBank, actions, block: int, coverage: float) -> int:
    """Play and compare every frame and selection with the loops; how many selections."""
    arguments = {**BELIEF, "reselection": block, "coverage": coverage}
    env = TechniqueSelectionEnv(bank, **arguments)
    chosen = settings_of(bank, block=block, coverage=coverage, allow_idle=True)
    steps = oracle_belief.drive(bank.scores, actions, chosen)
    env.reset(seed=0)
    for action, step in zip(actions, steps, strict=True):
        info = env.step(action)[4]
        assert_frame(env, info, step)
        assert_selection(info["selection"], step.selection)
        late = np.zeros(len(bank.techniques))
        if step.selection:
            late += step.selection.late_runs
        assert info["seconds"] == pytest.approx((late + step.ran) @ bank.seconds)
    return sum(step.selection is not None for step in steps)


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 2**32),
    st.integers(1, 8),
    st.sampled_from([0.1, 0.5, 0.7, 1.0]),
    st.sampled_from([0.1, 0.5]),
)
def test_selections_are_the_loops(seed, block, coverage, reselect):
    rng = np.random.default_rng(seed)
    techniques, queries = int(rng.integers(1, 4)), int(rng.integers(2, 20))
    bank = noisy_bank(rng, techniques, queries, int(rng.integers(1, 16)), levels=200)
    actions = selecting(seed, queries, techniques, reselect=reselect)
    compare(bank, actions, block, coverage)


@pytest.mark.parametrize("block", [1, 4, 10])
def test_selections_on_a_smooth_route_are_the_loops(block):
    bank = random_bank(4, techniques=4, queries=50, references=50, levels=1000)
    assert compare(bank, selecting(1, 50, 4, 0.4), block, 0.7) >= 3


@pytest.mark.parametrize("when", [1, 4, 7, 23])
def test_after_a_selection_all_is_as_if_those_techniques_had_run(when):
    """Bit for bit, but for what the past steps showed: the mean of what their rows said."""
    bank = random_bank(6, queries=40)
    block = 6
    actions = selecting(2, 40, 3, 0.4, reselect=0.0)
    looked = TechniqueSelectionEnv(bank, **BELIEF, reselection=block)
    direct = TechniqueSelectionEnv(bank, **BELIEF, reselection=block)
    for env in (looked, direct):
        env.reset(seed=0)
    for q, action in enumerate(actions):
        late, bits = action.copy(), action.copy()
        late[:3] |= when - block <= q < when
        bits[-1] = q == when
        info = looked.step(bits)[4]
        if q == when:
            late[:3] = info["selection"]["selected"]
            assert info["selection"]["happened"]
        other = direct.step(late)[4]
        if q < when:
            continue
        assert_same(belief_of(looked), belief_of(direct))
        assert summary_of(looked) == summary_of(direct)
        for key in ("prediction", "technique", "margin", "ran", "place", "statistic", "correction"):
            assert_same(info[key], other[key], key)


def test_a_selection_on_the_first_frame_is_none():
    env = TechniqueSelectionEnv(random_bank(1), **BELIEF, reselection=5)
    env.reset(seed=0)
    info = env.step([1, 0, 0, 1])[4]
    assert not info["selection"]["happened"]
    assert info["ran"].tolist() == [True, False, False]


# ---- batches and episodes ----------------------------------------------------------------


SIZES = [(2, 33, 40), (4, 25, 90), (1, 40, 7), (3, 18, 21)]


def sized_banks() -> list[ScoreBank]:
    return [
        random_bank(i, t, q, r, ground_truth=np.arange(q) % r) for i, (t, q, r) in enumerate(SIZES)
    ]


@pytest.mark.parametrize("block", [None, 4])
@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 0, 2, 1]])
def test_routes_of_several_sizes_side_by_side_are_the_single_ones(block, order):
    """Room grows as larger maps come in, and a batch keeps what its other routes remember."""
    banks = [sized_banks()[i] for i in order]
    arguments = {**BELIEF, "slots": 4, "reselection": block}
    width = 4 + (block is not None)
    actions = np.random.default_rng(3).random((18, 4, width)) < 0.4
    batch = TechniqueSelectionVectorEnv(4, banks, **arguments)
    first, _ = batch.reset(seed=0, options={"bank": np.arange(4)})
    together = [first, *(batch.step(action)[0] for action in actions)]
    beliefs = batch.task.episodes.estimator.state.beliefs
    for i in range(4):
        env = TechniqueSelectionEnv(banks, **arguments)
        alone = [env.reset(seed=0, options={"bank": i})[0]]
        alone += [env.step(action)[0] for action in actions[:, i]]
        for one, many in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one, many[i])
        assert beliefs[0, i] == summary_of(env)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_batch_whose_routes_end_at_different_times(mode):
    """Restarted routes begin anew, the others go on: each as in an environment of its own."""
    banks = sized_banks()
    arguments = {**BELIEF, "slots": 4, "reselection": 4}
    actions = np.random.default_rng(4).random((60, 4, 5)) < 0.4
    batch = TechniqueSelectionVectorEnv(4, banks, autoreset_mode=mode, **arguments)
    batch.reset(seed=0, options={"bank": np.arange(4)})
    singles, waiting = [], np.zeros(4, bool)
    for i in range(4):
        singles.append(TechniqueSelectionEnv(banks, **arguments))
        singles[i].reset(seed=0, options={"bank": i})
    for action in actions:
        shown, rewards, ended, _, _ = batch.step(action)
        indices = batch.task.episodes.state.routes["bank"]
        for i, env in enumerate(singles):
            if waiting[i]:
                own = env.reset(options={"bank": int(indices[i])})[0]
                waiting[i] = False
            else:
                own, reward, end, _, _ = env.step(action[i])
                assert (rewards[i], ended[i]) == (reward, end)
                waiting[i] = end
                if end and mode == "SameStep":
                    own = env.reset(options={"bank": int(indices[i])})[0]
                    waiting[i] = False
            np.testing.assert_array_equal(shown[i], own)


@pytest.mark.parametrize("block", [None, 5])
def test_a_second_episode_is_the_first_again(block):
    banks = sized_banks()[:2]
    env = TechniqueSelectionEnv(banks, **BELIEF, slots=4, reselection=block)
    rng = np.random.default_rng(0)
    actions = rng.random((24, *env.action_space.shape)) < 0.4
    seen = []
    for number in (0, 0, 1, 0):
        played = [env.reset(seed=0, options={"bank": number})]
        seen.append([played, *(env.step(action) for action in actions)])
    assert_same(seen[0], seen[1])
    assert_same(seen[0], seen[3])


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("block", [None, 4])
@pytest.mark.parametrize("vector", [False, True])
def test_a_copy_in_mid_episode_continues_identically(twin, block, vector):
    arguments = {**BELIEF, "slots": 4, "reselection": block}
    banks = sized_banks()
    if vector:
        env = TechniqueSelectionVectorEnv(3, banks, **arguments)
    else:
        env = TechniqueSelectionEnv(banks[0], **arguments)
    actions = np.random.default_rng(5).random((30, *env.action_space.shape)) < 0.4
    env.reset(seed=1)
    for action in actions[:13]:
        env.step(action)
    other = twin(env)
    wanted = [env.step(action) for action in actions[13:]]  # what the copy does not see
    assert_same([other.step(action) for action in actions[13:]], wanted)
    assert_same(play(other, actions, 7), play(env, actions, 7))


# ---- live routes -------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_a_live_route_is_its_bank(data):
    block = data.draw(st.sampled_from([None, 1, 3, 7]))
    arguments = {
        "statistic": "belief",
        "history": data.draw(st.sampled_from([0, 8, 1000])),
        "candidates": data.draw(st.sampled_from([1, 50])),
        "reselection": block,
        "allow_idle": data.draw(st.booleans()),
        "random_start": data.draw(st.booleans()),
        "episode_length": data.draw(st.sampled_from([None, 25])),
    }
    density = data.draw(st.sampled_from([0.03, 0.2, 0.7]))
    reselect = data.draw(st.sampled_from([0.02, 0.2, 0.6]))
    seed = data.draw(st.integers(0, 2**32 - 1))
    bank, live = cached_pair(*data.draw(st.sampled_from([(90, 9), (70, 40)])))
    actions = np.random.default_rng(seed).random((100, len(NAMES) + 1)) < density
    actions[:, -1] = np.random.default_rng(seed + 1).random(100) < reselect
    if block is None:
        actions = actions[:, :-1]
    wanted = play(TechniqueSelectionEnv(bank, **arguments), actions, seed)
    assert_same(play(TechniqueSelectionEnv(live, **arguments), actions, seed), wanted)


@pytest.mark.parametrize("block", [None, 1, 8])
@pytest.mark.parametrize("rare", [False, True])
def test_rows_are_kept_as_long_as_the_belief_needs_them(block, rare):
    """Those of a block that may be selected over, however seldom a technique runs."""
    bank, live = cached_pair(400, 9)
    actions = selecting(3, 399, 3, reselect=0.05)[:, : 3 + (block is not None)]
    if rare:
        actions[:, 1] = False
        actions[::90, 1] = True
    arguments = {"statistic": "belief", "history": 0, "reselection": block}
    first, second = (TechniqueSelectionEnv(source, **arguments) for source in (bank, live))
    assert_same(play(second, actions), play(first, actions))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_live_routes_and_banks_in_one_batch(mode):
    bank, live = cached_pair(70, 40)
    other, _ = cached_pair(90, 9)
    arguments = {**BELIEF, "autoreset_mode": mode, "reselection": 4, "episode_length": 18}
    actions = random_actions(5, 60, (3, 5))

    def played(first):
        env = TechniqueSelectionVectorEnv(3, [first, other], slots=4, **arguments)
        return play(env, actions)

    assert_same(played(live), played(bank))


def test_a_long_stream_is_its_bank():
    """Longer than the room that a route of unknown length has at first."""
    maps, images = maps_of(12), traverse(1100, 2)
    actions = selecting(2, 1099, 3, reselect=0.01)
    first = TechniqueSelectionEnv(bank_of(maps, images), statistic="belief", reselection=5)
    second = TechniqueSelectionEnv(live_of(maps, Stream(images)), statistic="belief", reselection=5)
    assert_same(play(second, actions), play(first, actions))


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_of_a_live_drive_continues_identically(twin):
    _, live = cached_pair(90, 9)
    env = TechniqueSelectionEnv(live, **BELIEF, reselection=5)
    actions = selecting(4, 80, 3)
    env.reset(seed=0)
    for action in actions[:40]:
        env.step(action)
    other = twin(env)
    wanted = [env.step(action) for action in actions[40:]]
    assert_same([other.step(action) for action in actions[40:]], wanted)


# ---- errors ------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[np.nan, np.inf])
def spoiled(request, tmp_path_factory) -> ScoreBank:
    """A bank on disk with a wrong score of T2 at frame 3."""
    folder = tmp_path_factory.mktemp("spoiled") / "hall"
    random_bank(1, name="hall").save(folder)
    scores = np.load(folder / "scores.npy")
    scores[2, 3, 5] = request.param
    np.save(folder / "scores.npy", scores)
    return ScoreBank.load(folder)


WORDS = "'hall': NaN or infinite score of technique 'T2' at frame 3; mend"


def test_a_wrong_score_is_named(spoiled):
    env = TechniqueSelectionEnv(spoiled, statistic="belief")
    env.reset(seed=0)
    for _ in range(3):
        env.step([1, 1, 1])
    with pytest.raises(ValueError, match=WORDS):
        env.step([0, 0, 1])


@pytest.mark.parametrize("start", [0, 2])
def test_a_wrong_score_in_a_row_after_the_fact_is_named(spoiled, start):
    env = TechniqueSelectionEnv(spoiled, statistic="belief", reselection=5)
    env.reset(seed=0, options={"start": start})
    for _ in range(5):
        env.step([1, 0, 0, 0])
    with pytest.raises(ValueError, match=WORDS):
        env.step([0, 0, 0, 1])


def test_wrong_scores_of_what_never_runs_do_no_harm_and_a_reset_forgets_an_error(spoiled):
    actions = np.array([[1, 1, 0, 0]] * 10 + [[1, 0, 1, 1], [1, 0, 1, 0]])
    whole = TechniqueSelectionEnv(random_bank(1, name="hall"), **BELIEF, reselection=3)
    env = TechniqueSelectionEnv(spoiled, **BELIEF, reselection=3)
    wanted = play(whole, actions)
    assert_same(play(env, actions), wanted)
    env.reset(seed=0)
    for _ in range(3):
        env.step([1, 1, 1, 0])
    with pytest.raises(ValueError, match=WORDS):
        env.step([1, 1, 1, 0])
    assert_same(play(env, actions), wanted)


# ---- memory ------------------------------------------------------------------------------


def bytes_of(queries: int, references: int, block: int | None) -> int:
    """Of all arrays that a single environment's episodes hold, the bank's apart, once driven."""
    rng = np.random.default_rng(0)
    bank = noisy_bank(rng, 3, queries, references)
    env = TechniqueSelectionEnv(bank, statistic="belief", reselection=block)
    play(env, selecting(0, queries, 3)[:, : env.action_space.n])
    episodes = env.task.episodes
    tables = (episodes.state, episodes.estimator.state, episodes.estimator)
    held = [list(vars(table).values()) for table in tables]
    prepared = vars(bank.prepared(50))
    owners = {}
    for array in arrays([held, prepared]):
        while isinstance(array.base, np.ndarray):
            array = array.base
        owners[id(array)] = array.nbytes
    assert sum(owners.values()) > 8 * 12 * references
    return sum(owners.values())


@pytest.mark.parametrize("block", [None, 6])
def test_no_memory_grows_with_frames_times_places(block):
    """Doubling both costs no more than doubling each."""
    size = {(q, r): bytes_of(q, r, block) for q in (60, 120) for r in (70, 140)}
    both, frames, places = (size[k] - size[60, 70] for k in [(120, 140), (120, 70), (60, 140)])
    assert both == frames + places
    assert frames < 60 * 3 * 300  # some numbers and the best places of each row that ran
