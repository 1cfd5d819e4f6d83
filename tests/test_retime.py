"""Re-timed recordings: the motion, the rows and truth that follow it, and `bank.py retime`."""

from __future__ import annotations

import math
import tracemalloc
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from env_cases import random_bank
from hypothesis import given
from hypothesis import strategies as st

from amusic_gym.banks import bank_files
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.routes import motion as motions
from amusic_gym.routes import retime as module
from amusic_gym.routes.motion import JUMP, KIDNAPPED, MOTIONS, PACED, SPEED_CHANGE, SPEEDS, walk
from amusic_gym.routes.retime import retime, retimed_frames, retimed_truth, save_retimed
from amusic_gym.routes.simulate import Simulation

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"
LONG = 400_000
EITHER = pytest.mark.parametrize("motion", [PACED, KIDNAPPED])
either = st.sampled_from([PACED, KIDNAPPED])


class Script:
    """Chance that does as it is told; takes the place of NumPy's generator.

    Attributes:
        draws: what `random` gives: speed changes, then jumps, as 0 (it happens) or 1, then targets.
    """

    def __init__(self, changes, speeds, jumps, targets) -> None:
        self.speeds = speeds
        self.draws = [np.where(changes, 0.0, 1.0), np.where(jumps, 0.0, 1.0), np.array(targets)]

    def random(self, size):
        return self.draws.pop(0)[:size]

    def choice(self, values, size):
        return np.asarray(values)[self.speeds][:size]


@st.composite
def scripts(draw):
    """Number of frames, and the four lists of a `Script`."""
    count = draw(st.integers(1, 40))

    def each(of):
        return draw(st.lists(of, min_size=count, max_size=count))

    flags, speeds = st.sampled_from([False, False, True]), st.integers(0, len(SPEEDS) - 1)
    targets = st.integers(0, 63).map(lambda number: number / 64)
    return count, (each(flags), each(speeds), each(flags), each(targets))


def by_the_book(motion, count, changes, speeds, jumps, targets):
    """The definition, word for word, in exact numbers."""
    p, v, rows = Fraction(0), Fraction(1), []
    for q in range(count):
        rows.append(math.floor(p))
        v = Fraction(SPEEDS[speeds[q]]) if changes[q] else v
        p += v
        if math.floor(p) > count - 1:  # beyond the end
            p = Fraction(0)
        if motion == KIDNAPPED and jumps[q]:
            p = Fraction(math.floor(Fraction(targets[q]) * count))
    return rows


def frames_of(count: int, seed: int, motion: str = KIDNAPPED) -> np.ndarray:
    return retimed_frames(count, np.random.default_rng(seed), motion)


# ---- the motion --------------------------------------------------------------------------


def test_speeds_and_chances_are_the_published_ones_and_the_simulators():
    assert sorted(SPEEDS) == [0, 0.5, 1, 1, 1, 1, 1.5, 2]
    assert (JUMP, SPEED_CHANGE) == (0.02, 0.03)
    assert (Simulation().jump, Simulation().speed_change) == (JUMP, SPEED_CHANGE)
    assert MOTIONS == ("recorded", "paced", "kidnapped")


@given(scripts(), either)
def test_any_chance_leads_where_the_definition_says(script, motion):
    count, lists = script
    found = retimed_frames(count, Script(*lists), motion)
    assert found.tolist() == by_the_book(motion, count, *lists)


@given(st.integers(1, 200), st.integers(0, 2**32), either)
def test_real_chance_leads_there_too(count, seed, motion):
    rng = np.random.default_rng(seed)
    changes = rng.random(count) < SPEED_CHANGE
    speeds = [SPEEDS.index(speed) for speed in rng.choice(SPEEDS, count)]
    jumps, targets = rng.random(count) < JUMP, rng.random(count).tolist()
    expected = by_the_book(motion, count, changes, speeds, jumps, targets)
    assert frames_of(count, seed, motion).tolist() == expected


def test_a_drive_worked_out_by_hand():
    never, at = [False] * 12, lambda *qs: [q in qs for q in range(12)]
    slow, still, fast = SPEEDS.index(0.5), SPEEDS.index(0.0), SPEEDS.index(2.0)
    speeds = [0, slow, 0, 0, still, 0, 0, 0, fast, 0, 0, 0]
    steady = Script(never, [0] * 12, never, [0.0] * 12)
    assert retimed_frames(12, steady).tolist() == list(range(12))
    lists = at(1, 4, 8), speeds, at(6), [7 / 12 + 0.01] * 12
    # p      0  1  1.5 2  2.5 2.5 2.5 7  7  9  11  0 (13 is beyond the end)
    assert retimed_frames(12, Script(*lists)).tolist() == [0, 1, 1, 2, 2, 2, 2, 7, 7, 9, 11, 0]
    # p      0  1  1.5 2  2.5 2.5 2.5 2.5 2.5 4.5 6.5 8.5
    expected = [0, 1, 1, 2, 2, 2, 2, 2, 2, 4, 6, 8]
    assert retimed_frames(12, Script(*lists), PACED).tolist() == expected


@given(st.integers(1, 300), st.integers(0, 2**64), either)
def test_frames_are_of_the_recording_begin_at_its_first_and_depend_on_the_seed_alone(
    count, seed, motion
):
    frames = frames_of(count, seed, motion)
    assert (frames.dtype, frames.shape, frames[0]) == (np.int64, (count,), 0)
    assert frames.min() >= 0
    assert frames.max() < count
    assert np.array_equal(frames, frames_of(count, seed, motion))


@given(st.integers(2, 300), st.integers(0, 2**64))
def test_without_jumps_steps_are_small_or_back_to_the_first_frame(count, seed):
    frames = frames_of(count, seed, PACED)
    steps = np.diff(frames)
    assert np.isin(steps[frames[1:] != 0], (0, 1, 2)).all()
    first = int(np.argmax(frames != frames_of(count, seed)))  # 0 where no jump tells them apart
    assert np.array_equal(frames[:first], frames_of(count, seed)[:first])


def test_the_drive_of_a_seed_stays_what_it_is():
    assert frames_of(300, 3)[:26].tolist() == [*range(23), 222, 223, 224]
    expected = [*range(9), 8, 8, 8, 8, 9, 11, 12, 14, 15, 17, 18]
    assert frames_of(300, 9, PACED)[:20].tolist() == expected
    assert not np.array_equal(frames_of(300, 3), frames_of(300, 4))


@pytest.mark.parametrize("between", [False, True])
def test_a_long_drive_jumps_and_changes_speed_as_often_as_it_says(between):
    rng = np.random.default_rng(1)
    steps = np.diff(np.floor(walk(rng, LONG, LONG, jump=JUMP, between=between)))
    near = steps[(steps >= 0) & (steps <= 2)]
    assert 1 - len(near) / len(steps) == pytest.approx(0.02, abs=0.001)
    # Half speed: a step every other frame; 1.5: one place and two places in turns.
    expected = [1 / 8 + 1 / 16, 4 / 8 + 2 / 16, 1 / 8 + 1 / 16]
    assert np.bincount(near.astype(int)) / len(near) == pytest.approx(expected, abs=0.012)
    # Two frames in a row without a step: standing. It ends by drawing another speed.
    standing = (steps[:-2] == 0) & (steps[1:-1] == 0)
    moved = np.isin(steps[2:][standing], (1, 2)).mean()
    assert moved == pytest.approx(0.98 * 0.03 * (13 / 16), rel=0.12)


def test_a_jump_goes_to_every_frame_alike(monkeypatch):
    monkeypatch.setattr(module, "JUMP", 1.0)
    counts = sum(np.bincount(frames_of(20, seed)[1:], minlength=20) for seed in range(2000))
    assert counts.sum() == 2000 * 19
    assert counts == pytest.approx(1900, abs=5 * math.sqrt(1900))


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_beyond_the_end_the_drive_begins_again(monkeypatch, count):
    monkeypatch.setattr(motions, "SPEEDS", (2.0,))
    rng = np.random.default_rng(0)
    taken = walk(rng, 3 * count, count, jump=0.0, speed_change=1.0)
    assert taken.tolist() == (list(range(0, count, 2)) * 6)[: 3 * count]
    half = walk(rng, count + 1, count, jump=0.0, speed_change=0.0, start=0.5)
    assert half.tolist() == [*(q + 0.5 for q in range(count)), 0.0]  # R - 0.5 is at the last place


@pytest.mark.parametrize("queries", [0, -1, 2.0, True, "3", None])
def test_a_number_of_frames_that_is_none_is_refused(queries):
    with pytest.raises(ValueError, match="queries is .*; give a whole number >= 1"):
        retimed_frames(queries, np.random.default_rng(0))


@pytest.mark.parametrize("motion", ["recorded", "kidnaped", "", None])
def test_a_motion_that_is_none_is_refused(bank, tmp_path, motion):
    for act in (
        lambda: retimed_frames(3, np.random.default_rng(0), motion),
        lambda: retime(bank, 0, motion),
        lambda: save_retimed(bank, 0, tmp_path / "out", motion),
    ):
        with pytest.raises(ValueError, match="unknown motion .* valid: paced, kidnapped"):
            act()
    assert not list(tmp_path.iterdir())


# ---- the bank ----------------------------------------------------------------------------


@given(st.data())
def test_truth_follows_the_frames_whatever_they_are(data):
    queries, references = data.draw(st.integers(1, 8)), data.draw(st.integers(1, 8))
    row = st.lists(st.booleans(), min_size=references, max_size=references)
    matrix = np.array(data.draw(st.lists(row, min_size=queries, max_size=queries)), bool)
    frames = data.draw(st.lists(st.integers(0, queries - 1), min_size=1, max_size=20))
    truth = retimed_truth(GroundTruth.from_matrix(matrix), np.array(frames, np.int64))
    assert np.array_equal(truth.matrix(), matrix[frames])


def noise_of(retimed: np.ndarray, scores: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """(T, Q, R) what was added to the rows, in the rows' standard deviations."""
    rows = scores[:, frames].astype(np.float64)
    return (retimed - rows) / rows.std(axis=2, keepdims=True)


@EITHER
def test_rows_and_truth_are_those_of_the_frames_and_all_else_stays(bank, motion):
    before = bank.scores.copy()
    frames = frames_of(bank.queries, 5, motion)
    retimed = retime(bank, 5, motion)
    assert abs(noise_of(retimed.scores, before, frames)).max() < 0.7
    assert np.array_equal(retimed.truth.matrix(), bank.truth.matrix()[frames])
    assert (retimed.techniques, retimed.tolerance) == (bank.techniques, bank.tolerance)
    assert np.array_equal(retimed.seconds, bank.seconds)
    assert (retimed.costs, retimed.path) == (bank.costs, None)
    assert np.array_equal(bank.scores, before)
    best = before[0].argmax(axis=1)
    assert np.array_equal(retimed.truth.correct(best[frames]), bank.truth.correct(best)[frames])


def test_noise_is_gaussian_fresh_and_a_tenth_of_the_row():
    rng = np.random.default_rng(0)
    scale = np.array([0.01, 1.0, 100.0])[:, None, None]
    scores = (scale * (5 + rng.random((3, 200, 400)))).astype(np.float32)
    bank = ScoreBank(scores, ["A", "B", "C"], [1, 1, 1], tolerance=0, ground_truth=[0] * 200)
    noise = noise_of(retime(bank, 2).scores, scores, frames_of(200, 2))
    assert noise.std(axis=2) == pytest.approx(0.1, rel=0.2)
    assert noise.std() == pytest.approx(0.1, rel=0.01)
    assert abs(noise.mean()) < 0.001
    assert (abs(noise) < 0.1).mean() == pytest.approx(0.683, abs=0.005)
    for one, other in ((noise[0], noise[1]), (noise[0, :-1], noise[0, 1:])):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02
    assert abs(noise - noise_of(retime(bank, 3).scores, scores, frames_of(200, 3))).max() > 0.1


@EITHER
def test_a_robot_that_stands_never_sees_the_same_row_twice(bank, motion):
    seeds = [seed for seed in range(30) if 0 in np.diff(frames_of(bank.queries, seed, motion))]
    assert len(seeds) > 3
    for seed in seeds:
        for rows in retime(bank, seed, motion).scores:
            assert len(np.unique(rows, axis=0)) == bank.queries


def test_rows_without_spread_stay_as_they_are():
    bank = ScoreBank(np.full((1, 50, 3), 0.25), ["A"], [1], tolerance=0, ground_truth=[0] * 50)
    assert (retime(bank, 1).scores == 0.25).all()


def test_a_copy_of_a_technique_stays_a_copy(bank):
    scores = bank.scores[[0, 1, 0]]
    double = ScoreBank(scores, ["A", "B", "C"], [1, 1, 1], tolerance=1, ground_truth=bank.truth)
    retimed = retime(double, 1).scores
    assert np.array_equal(retimed[0], retimed[2])
    assert np.array_equal(retimed[:2], retime(bank, 1).scores[:2])


def test_name_and_source_say_motion_seed_and_origin():
    simulated = ScoreBank(np.ones((1, 2, 2)), ["A"], [1], tolerance=0, name="hall", source="me")
    retimed = retime(simulated, 3)
    assert retimed.name == "hall kidnapped 3"
    assert retimed.source == "re-timed (kidnapped) with seed 3 from hall: me"
    nameless = retime(ScoreBank(np.ones((1, 2, 2)), ["A"], [1], tolerance=0), 3, PACED)
    assert (nameless.name, nameless.source) == ("paced 3", "re-timed (paced) with seed 3")


def test_the_same_seed_gives_the_same_bank_and_the_same_frames_of_another(bank):
    assert np.array_equal(retime(bank, 7).scores, retime(bank, np.int64(7)).scores)
    assert not np.array_equal(retime(bank, 7).scores, retime(bank, 8).scores)
    other = ScoreBank(
        np.broadcast_to(np.arange(bank.queries)[None, :, None], (1, bank.queries, 50)),
        ["A"],
        [1],
        tolerance=0,
        ground_truth=np.arange(bank.queries),
    )
    assert retime(other, 7).scores[0, :, 0].tolist() == frames_of(bank.queries, 7).tolist()


@EITHER
def test_a_view_of_a_bank_keeps_its_techniques_and_its_cost_models(motion):
    bank = random_bank(2, names=["HOG", "CALC", "CoHOG"])
    view = bank.subset(["CoHOG", "HOG"]).with_costs("paper")
    retimed = retime(view, 1, motion)
    assert (retimed.techniques, retimed.costs) == (("CoHOG", "HOG"), "paper")
    assert np.array_equal(retimed.seconds, view.seconds)
    assert np.array_equal(retimed.scores, retime(bank, 1, motion).scores[[2, 0]])
    measured = view.with_costs("measured").seconds
    assert np.array_equal(retimed.with_costs("measured").seconds, measured)


@pytest.mark.parametrize("seed", [-1, 1.0, True, "1", None])
def test_a_seed_that_is_none_is_refused(bank, tmp_path, seed):
    for act in (lambda: retime(bank, seed), lambda: save_retimed(bank, seed, tmp_path / "out")):
        with pytest.raises(ValueError, match="seed is .*; give a whole number >= 0"):
            act()
    assert not list(tmp_path.iterdir())


def test_a_bank_of_one_frame_stays_as_it_is_but_for_the_noise():
    scores = np.arange(6).reshape(2, 1, 3)
    bank = ScoreBank(scores, ["A", "B"], [1, 2], tolerance=0, ground_truth=[0])
    noise = retime(bank, 0).scores - bank.scores
    assert (0 < abs(noise)).all()
    assert abs(noise).max() < 0.5


# ---- on disk -----------------------------------------------------------------------------


@EITHER
@pytest.mark.parametrize("block", [1, 7, 40, 1000])
def test_written_in_blocks_it_is_the_same_to_the_last_byte(
    bank, tmp_path, monkeypatch, block, motion
):
    view = bank.subset(bank.techniques[::-1]).with_costs("runs")
    assert frames_of(40, 5, motion).tolist() != list(range(40))
    retime(view, 5, motion).save(tmp_path / "whole")
    monkeypatch.setattr(module, "_BLOCK", block)
    written = save_retimed(view, 5, tmp_path / "blocks", motion)
    assert written == (tmp_path / "blocks").resolve()
    for file in (tmp_path / "whole").iterdir():
        assert file.read_bytes() == (tmp_path / "blocks" / file.name).read_bytes()


def test_a_mapped_bank_is_never_in_memory_whole(tmp_path):
    scores = np.random.default_rng(0).random((2, 1500, 1500), np.float32)
    ScoreBank(scores, ["A", "B"], [1, 1], tolerance=1).save(tmp_path / "bank")
    size = scores.nbytes
    del scores
    bank = ScoreBank.load(tmp_path / "bank")
    tracemalloc.start()
    try:
        save_retimed(bank, 0, tmp_path / "out")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.3 * size


def test_the_bank_that_is_read_is_not_replaced(bank, tmp_path):
    path = bank.save(tmp_path / "bank")
    (tmp_path / "link").symlink_to(path)
    before = {file.name: file.read_bytes() for file in path.iterdir()}
    for out in (path, tmp_path / "link"):
        with pytest.raises(ValueError, match="is the bank to re-time, .* give another folder"):
            save_retimed(ScoreBank.load(path), 0, out)
    assert {file.name: file.read_bytes() for file in path.iterdir()} == before


def test_scores_that_nothing_can_use_are_not_written_again(tmp_path):
    bank = random_bank(4, techniques=1)
    scores = bank.scores[0].copy()
    scores[39, 2] = np.nan  # no program of ours writes such a bank
    bank_files.write(
        tmp_path / "bank",
        scores=[scores],
        truth=bank.truth,
        techniques=[("A", 1.0)],
        tolerance=1,
        name="bad",
        source="",
        costs="measured",
    )
    damaged = ScoreBank.load(tmp_path / "bank", verify=True)
    with pytest.raises(ValueError, match="'A' at frame 39, place 2 is nan"):
        save_retimed(damaged, 0, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# ---- bank.py retime ----------------------------------------------------------------------


@pytest.fixture
def run(monkeypatch, amusic, tmp_path):
    """`bank.py retime` in a folder of its own: exit status, stdout and stderr."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    monkeypatch.chdir(tmp_path)
    random_bank(3).save("hall")
    return lambda *words: amusic("bank", "retime", *words)


@pytest.mark.parametrize("words", [[], ["--motion", "kidnapped"], ["--motion", "paced"]])
def test_the_command_writes_the_bank_that_the_function_makes(run, tmp_path, words):
    code, out, err = run("hall", "--seed", 3, "--out", "new", *words)
    assert (code, err) == (0, "")
    assert out == f"{tmp_path.resolve() / 'new'}: 3 techniques, 40 queries, 60 references\n"
    written = ScoreBank.load("new", verify=True)
    made = retime(ScoreBank.load("hall"), 3, *words[1:])
    assert np.array_equal(written.scores, made.scores)
    assert np.array_equal(written.truth.matrix(), made.truth.matrix())
    assert np.array_equal(written.seconds, made.seconds)
    assert (written.name, written.source) == (made.name, made.source)
    assert made.source.startswith(f"re-timed ({words[1] if words else KIDNAPPED}) with seed 3")
    assert (written.tolerance, written.costs) == (made.tolerance, made.costs)


def test_a_bank_that_is_there_is_replaced_and_can_be_named(run):
    assert run("hall", "--seed", 1, "--out", "new")[0] == 0
    assert run("hall", "--seed", 2, "--out", "new", "--name", "ride")[0] == 0
    bank = ScoreBank.load("new", verify=True)
    assert bank.name == "ride"
    assert np.array_equal(bank.scores, retime(ScoreBank.load("hall"), 2).scores)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("hall --seed -1 --out new", "seed is -1; give a whole number >= 0"),
        ("hall --seed 1.5 --out new", "--seed: invalid int value: '1.5'"),
        ("hall --out new", "required: --seed"),
        ("hall --seed 1", "required: --out"),
        ("--seed 1 --out new", "required: BANK"),
        ("nowhere --seed 1 --out new", "nowhere does not exist"),
        ("note --seed 1 --out new", "note"),
        ("hall --seed 1 --out hall", "hall is the bank to re-time, which would be lost"),
        ("hall --seed 1 --out other", "other"),
        ("hall --seed 1 --out note", "note"),
        ("hall --seed 1 --out new --seeds 2", "did you mean '--seed'?"),
        ("hall --seed 1 --motion pased --out new", "unknown motion 'pased': did you mean 'paced'?"),
        ("hall --seed 1 --motion recorded --out new", "valid: paced, kidnapped"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_changes_nothing(run, tmp_path, words, sentence):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    (tmp_path / "note").write_text("mine")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    code, out, err = run(*words.split())
    assert (code, out) == (2, "")
    assert sentence in err, err
    assert len(err.splitlines()) == 1
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    assert not (tmp_path / "new").exists()


def test_a_damaged_recording_gets_no_new_checksum(run, tmp_path):
    scores = tmp_path / "hall" / "scores.npy"
    content = bytearray(scores.read_bytes())
    content[-2] ^= 1
    scores.write_bytes(content)
    code, _, err = run("hall", "--seed", 1, "--out", "new")
    assert code == 2
    assert "scores.npy is damaged" in err
    assert not (tmp_path / "new").exists()
