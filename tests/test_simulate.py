from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from amusic_baselines import make_policy
from planted_routes import planted

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import STATISTICS
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context
from amusic_gym.routes.motion import MOTIONS
from amusic_gym.routes.route_model import RouteModel, decoys, no_repeats, repeated_places
from amusic_gym.routes.simulate import Simulation, simulate
from amusic_gym.routes.simulated_descriptors import BLOCK, smooth, write_scores
from amusic_gym.routes.statistics import MEASURES, describe

pytestmark = pytest.mark.slow

# Everything that could blur what a test looks at, off.
PLAIN = Simulation(
    conditions=(1, 1),
    exclusive=0.0,
    all_fail=0.0,
    all_good=0.0,
    useless=0.0,
    ability_spread=0.0,
    ability=(0.8, 0.8),
    alias_density=0.0,
    bland_density=0.0,
    dimensions=(32, 32),
    smoothness=(3.0, 3.0),
    shift=(0.3, 0.3),
)


def centres(bank: ScoreBank) -> np.ndarray:
    """The true place of each frame (Q,)."""
    matrix = bank.truth.matrix()
    best = np.arange(bank.references)
    assert (np.diff(matrix.astype(np.int8), axis=1) == 1).sum(axis=1).max() <= 1  # one interval
    low, high = matrix.argmax(axis=1), bank.references - 1 - matrix[:, ::-1].argmax(axis=1)
    tolerance = bank.tolerance
    return np.where(low > 0, low + tolerance, np.where(high < best[-1], high - tolerance, low))


def accuracy(bank: ScoreBank, frames: slice = slice(None)) -> np.ndarray:
    """Top-1 accuracy of each technique (T,) on some frames."""
    numbers = np.arange(bank.queries)[frames]
    return np.array(
        [bank.truth.correct(rows[frames].argmax(axis=1), numbers).mean() for rows in bank.scores]
    )


def true_z(bank: ScoreBank) -> np.ndarray:
    """z-score of the true place (T, Q)."""
    scores = bank.scores.astype(np.float64)
    z = (scores - scores.mean(axis=2, keepdims=True)) / scores.std(axis=2, keepdims=True)
    return z[:, np.arange(bank.queries), centres(bank)]


@pytest.mark.parametrize("make", [simulate, planted])
def test_the_same_seed_gives_the_same_bank_and_another_one_another(make: Any) -> None:
    first, again, other = make(7), make(7), make(8)
    assert np.array_equal(first.scores, again.scores)
    assert np.array_equal(first.seconds, again.seconds)
    assert np.array_equal(first.truth.matrix(), again.truth.matrix())
    assert first.shape != other.shape or not np.array_equal(first.scores, other.scores)


def test_global_random_state_is_neither_used_nor_changed() -> None:
    np.random.seed(1)
    before = np.random.get_state()[1].copy()
    first = simulate(3, queries=40).scores
    assert np.array_equal(before, np.random.get_state()[1])
    np.random.seed(2)
    assert np.array_equal(first, simulate(3, queries=40).scores)


def test_shapes_names_and_costs_are_as_asked() -> None:
    bank = simulate(0, queries=30, references=50, techniques=5)
    assert bank.shape == (5, 30, 50)
    assert bank.techniques == ("A", "B", "C", "D", "E")
    assert bank.scores.dtype == np.float32
    assert np.isfinite(bank.scores).all()
    assert ((bank.seconds >= 0.02) & (bank.seconds <= 2.0)).all()


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize(
    ("queries", "references", "techniques"), [(1, 1, 1), (1, 7, 26), (3, 3, 2)]
)
def test_the_smallest_routes_work(
    motion: Any, queries: int, references: int, techniques: int
) -> None:
    for seed in range(5):
        bank = simulate(
            seed, queries=queries, references=references, techniques=techniques, motion=motion
        )
        assert bank.shape == (techniques, queries, references)


def test_drawn_routes_stay_within_the_ranges() -> None:
    simulation = Simulation(queries=(20, 30), techniques=(2, 5), map_factor=(1.5, 2.0))
    banks = [simulation.route(np.random.default_rng(seed)) for seed in range(40)]
    assert {len(bank.techniques) for bank in banks} == {2, 3, 4, 5}
    assert all(20 <= bank.queries <= 30 for bank in banks)
    same = [bank.queries == bank.references for bank in banks]
    assert 5 < sum(same) < 35
    assert all(s or 1.4 < b.references / b.queries < 2.1 for s, b in zip(same, banks, strict=True))


def test_the_recorded_motion_advances_by_one_from_any_start() -> None:
    starts = set()
    for seed in range(10):
        places = centres(simulate(seed, queries=40, references=90))
        assert (np.diff(places[3:-3]) == 1).all()
        starts.add(int(places[5]) - 5)
    assert len(starts) > 5
    assert centres(simulate(0, queries=40, references=40))[20] == 20


@pytest.mark.parametrize("motion", ["paced", "kidnapped"])
def test_the_other_motions_stop_hurry_and_jump_within_the_map(motion: Any) -> None:
    moves = []
    for seed in range(20):
        bank = simulate(seed, queries=300, references=400, motion=motion)
        moves.extend(np.diff(centres(bank)).tolist())
    share = {step: moves.count(step) / len(moves) for step in (0, 1, 2)}
    assert share[0] > 0.05
    assert share[2] > 0.05
    assert share[1] > 0.4
    jumps = np.mean(np.abs(moves) > 10)
    assert 0.01 < jumps < 0.05 if motion == "kidnapped" else jumps < 0.005  # the end of the map


@pytest.mark.parametrize("motion", ["paced", "kidnapped"])
def test_without_events_every_motion_is_steady_until_the_map_ends(motion: Any) -> None:
    simulation = replace(PLAIN, motion=motion, jump=0.0, speed_change=0.0, queries=(60, 60))
    bank = replace(simulation, references=500).route(np.random.default_rng(0))
    assert (np.diff(centres(bank)[3:]) == 1).all()
    short = replace(simulation, references=30).route(np.random.default_rng(0))
    assert {0, 29} < set(short.truth.places.tolist())  # there and back at the first place


def test_a_share_of_the_routes_is_retimed_half_paced_and_half_kidnapped() -> None:
    simulation = replace(PLAIN, queries=(4, 4), retimed=0.6)
    names = [simulation.route(np.random.default_rng(seed)).name for seed in range(400)]
    kinds = [name.split()[1] if " " in name else "recorded" for name in names]
    assert kinds.count("recorded") == pytest.approx(160, abs=35)
    assert kinds.count("paced") == pytest.approx(120, abs=35)
    assert kinds.count("kidnapped") == pytest.approx(120, abs=35)


def test_the_recorded_routes_of_a_seed_stay_what_they_are() -> None:
    bank = simulate(7, queries=50)
    assert (bank.name, bank.shape) == ("simulated-7", (4, 50, 95))
    assert bank.scores[2, 30, :4].tolist() == pytest.approx(
        [0.196843, 0.234906, 0.211352, 0.213575], rel=1e-5
    )


def test_competence_decides_how_far_the_true_place_stands_out() -> None:
    medians = []
    for level in (0.0, 0.4, 0.8, 0.98):
        simulation = replace(PLAIN, ability=(level, level), queries=(200, 200))
        medians.append(np.median(true_z(simulation.route(np.random.default_rng(5)))))
    assert abs(medians[0]) < 0.35
    assert medians[0] + 0.5 < medians[1] < medians[2] - 0.5
    assert medians[3] > 3.0


def test_conditions_change_who_is_good() -> None:
    changes, quiet = [], []
    for seed in range(6):
        varied = replace(
            PLAIN, conditions=(4, 4), exclusive=1.0, queries=(300, 300), regime_length=(60.0, 60.0)
        )
        for simulation, found in ((varied, changes), (PLAIN, quiet)):
            route = replace(simulation, queries=(300, 300)).route(np.random.default_rng(seed))
            blocks = true_z(route)[:, :300].reshape(4, 15, 20).mean(axis=2)  # (T, blocks of 20)
            found.append(np.ptp(blocks, axis=1).mean())
    assert np.mean(changes) > 2.0 * np.mean(quiet)


def test_noise_that_lasts_is_told_from_hubs() -> None:
    rng = np.random.default_rng(0)
    slow = np.repeat(rng.normal(size=(10, 40)), 20, axis=0)  # the same for 20 frames
    hubs = 5.0 * rng.normal(size=40) + rng.normal(size=(200, 40))
    truth = {"tolerance": 1, "ground_truth": np.arange(200) // 5}
    bank = ScoreBank(np.stack([slow, hubs]), ["A", "B"], [1.0, 1.0], **truth)
    assert 0.4 < describe(bank, 0, {})["noise_lasts"] < 0.7  # 12 of 20 frames
    assert abs(describe(bank, 1, {})["noise_lasts"]) < 0.1
    short = ScoreBank(hubs[None, :5], ["A"], [1.0], tolerance=1, ground_truth=np.arange(5))
    assert np.isnan(describe(short, 0, {})["noise_lasts"])


def test_hubs_last_where_both_halves_prefer_the_same_places() -> None:
    rng = np.random.default_rng(0)
    hubs = rng.normal(size=40)
    scores = np.stack([hubs + 0.1 * rng.normal(size=(30, 40)), rng.normal(size=(30, 40))])
    scores[1, 15:] += 5.0 * hubs[::-1]
    bank = ScoreBank(scores, ["A", "B"], [1.0, 1.0], tolerance=1, ground_truth=np.arange(30))
    assert describe(bank, 0, {})["hubs_last"] > 0.95
    assert describe(bank, 1, {})["hubs_last"] < 0.5
    short = ScoreBank(scores[:, :1], ["A", "B"], [1.0, 1.0], tolerance=1, ground_truth=[0])
    assert np.isnan(describe(short, 0, {})["hubs_last"])


def test_all_fail_and_all_good_reach_every_technique() -> None:
    for share, least, most in (("all_fail", -0.5, 1.2), ("all_good", 2.0, 99.0)):
        route = replace(PLAIN, queries=(200, 200), **{share: 1.0}).route(np.random.default_rng(1))
        medians = np.median(true_z(route), axis=1)
        assert (medians > least).all()
        assert (medians < most).all()


# Made before there were trends, decoys and copies: three scores of the frame in the middle for the
# place at a third of the map, the deviation of all scores, and all costs. "kidnapped" is younger:
# it was made anew when simulated and re-timed routes came to share one walk, which draws otherwise.
BEFORE: dict[str, tuple[Any, tuple[int, int, int], list[float]]] = {
    "default": (
        lambda: simulate(3),
        (4, 300, 300),
        [0.294351, 0.249564, 0.161706, 0.20019, 1.428503],
    ),
    "kidnapped": (
        lambda: simulate(4, queries=60, motion="kidnapped"),
        (4, 60, 91),
        [0.372534, 0.383317, 0.591214, 0.10017, 3.263745],
    ),
    "planted": (
        lambda: planted(1),
        (4, 400, 1000),
        [0.623539, 0.535226, 0.534605, 0.057316, 4.051151],
    ),
    "drawn": (
        lambda: Simulation().route(np.random.default_rng(5)),
        (4, 301, 456),
        [0.253132, 0.389623, 0.366395, 0.092705, 1.855944],
    ),
    "re-timed": (
        lambda: replace(
            Simulation(), queries=(80, 110), map_factor=(1.0, 3.0), retimed=0.6,
            techniques=(2, 6), ability=(0.45, 0.97), useless=0.15, all_fail=0.02, exclusive=0.05,
        ).route(np.random.default_rng(2)),
        (3, 105, 105),
        [0.660925, 0.379842, 0.345308, 0.136859, 0.177712],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BEFORE)
def test_routes_without_trends_decoys_and_copies_are_as_they_were(name: str) -> None:
    make, shape, numbers = BEFORE[name]
    bank = make()
    assert bank.shape == shape
    middle = bank.scores[:3, bank.queries // 2, bank.references // 3].tolist()
    found = [*middle, float(bank.scores.astype(np.float64).std()), float(bank.seconds.sum())]
    np.testing.assert_allclose(found, numbers, atol=2e-5)  # of a matrix product on any processor


def test_decoys_move_along_or_stand_and_some_are_shared() -> None:
    place = np.concatenate([np.arange(30.0, 80.0), np.arange(10.0, 60.0)])
    spell = np.arange(100) // 25
    moving, standing, shared, strengths = 0, 0, 0, []
    for seed in range(30):
        options = {"chance": 0.7, "shared": 0.5, "strength": (0.3, 0.9)}
        where, lure = decoys(np.random.default_rng(seed), place, spell, 400, 3, **options)
        assert ((where >= 0.0) & (where <= 399.0)).all()
        for number in range(4):
            frames = np.flatnonzero(spell == number)
            assert (np.ptp(lure[:, frames], axis=1) == 0.0).all()
            took = np.flatnonzero(lure[:, frames[0]])
            for t in took:
                steps = np.diff(where[t, frames])
                inside = (where[t, frames] > 0.0) & (where[t, frames] < 399.0)
                if (steps == 0.0).all():
                    standing += 1
                else:
                    moving += 1
                    assert np.allclose(steps[inside[1:]], np.diff(place[frames])[inside[1:]])
            shared += len(took) - len(np.unique(where[took][:, frames], axis=0))
            strengths.extend(lure[took, frames[0]].tolist())
    assert min(moving, standing) > 0.35 * (moving + standing)
    assert 0.6 < (moving + standing) / 360 < 0.8
    assert shared > 20
    assert 0.3 <= min(strengths) < 0.35 < 0.85 < max(strengths) <= 0.9
    none = decoys(np.random.default_rng(0), place, spell, 400, 3, **options | {"chance": 0.0})
    assert not none[1].any()


def test_a_decoy_is_mistaken_for_the_place_where_a_technique_is_weak() -> None:
    simulation = replace(
        PLAIN, ability=(0.1, 0.1), queries=(200, 200), references=200, decoy=1.0,
        decoy_shared=1.0, decoy_strength=(0.9, 0.9),
    )  # fmt: skip
    fooled = simulation.route(np.random.default_rng(0)).scores.argmax(axis=2)
    alone = replace(simulation, decoy=0.0).route(np.random.default_rng(0)).scores.argmax(axis=2)
    assert (abs(np.diff(fooled, axis=0)) <= 2).mean() > 0.7  # all for the same place
    assert (abs(np.diff(alone, axis=0)) <= 2).mean() < 0.3
    assert np.isin(np.diff(fooled[0]), (-1, 0, 1, 2)).mean() > 0.7  # which stands or moves along


def test_a_copy_sees_what_the_technique_before_it_sees() -> None:
    simulation = replace(PLAIN, queries=(40, 40), techniques=(4, 4))
    bank = replace(simulation, copies=1.0).route(np.random.default_rng(3))
    assert (bank.scores == bank.scores[:1]).all()
    assert len(set(bank.seconds.tolist())) == 4
    equal = [
        np.array_equal(route.scores[t], route.scores[t - 1])
        for seed in range(30)
        for route in [replace(simulation, copies=0.3).route(np.random.default_rng(seed))]
        for t in (1, 2, 3)
    ]
    assert 0.15 < np.mean(equal) < 0.45


def test_a_route_that_leaves_the_map_has_no_true_place_and_looks_like_none_from_there_on() -> None:
    for seed in range(5):
        bank = simulate(seed, simulation=replace(PLAIN, leaves=1.0), references=300)
        on_map = bank.truth.has_place
        left = int(on_map.sum())
        assert 100 <= left < 300
        assert on_map[:left].all()
        first = centres(bank)[0]
        z = (bank.scores - bank.scores.mean(2, keepdims=True)) / bank.scores.std(2, keepdims=True)
        diagonal = z[:, np.arange(300), np.minimum(first + np.arange(300), 299)]
        assert diagonal[:, :left].mean() > 1.0
        assert abs(diagonal[:, left:].mean()) < 0.5


def test_on_leaving_the_map_p_falls() -> None:
    """Of what the carried place, which goes on as before, is believed."""
    routes = [simulate(seed, simulation=replace(PLAIN, leaves=1.0)) for seed in range(8)]
    sure = {}
    for route in routes:
        trace = rollout(
            make_policy("music", Context.of(route, statistic="evidence")), route, name="music"
        )
        on_map = route.truth.has_place
        since = np.cumsum(~on_map)
        sure.setdefault("on", []).append(trace.p_correct[on_map][10:])
        sure.setdefault("off", []).append(trace.p_correct[since > 20])
    on, off = (np.concatenate(sure[name]) for name in ("on", "off"))
    assert np.mean(on > 0.9) > 0.9
    assert np.mean(off > 0.9) < 0.4


def test_a_trend_makes_far_places_alike() -> None:
    alike = []
    for trend in (0.0, 0.7):
        simulation = replace(
            PLAIN, ability=(0.95, 0.95), queries=(150, 150), references=150, dimensions=(60, 60),
            trend=(trend, trend), trend_length=(100.0, 100.0),
        )  # fmt: skip
        rows = simulation.route(np.random.default_rng(1)).scores[0]
        frames = np.arange(20, 130)
        far = [np.mean([rows[q, c + d] for q, c in zip(frames, frames, strict=True)]) for d in
               (15, -15)]  # fmt: skip
        alike.append((np.mean(far) - rows.mean()) / rows.std())
    assert alike[1] > alike[0] + 0.3


@pytest.mark.parametrize("name", ["decoy", "decoy_shared", "copies", "leaves"])
def test_shares_of_decoys_and_copies_are_refused_out_of_range(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Simulation(**{name: 1.5})


def test_costs_span_two_orders_and_follow_ability_a_little() -> None:
    simulation = Simulation(queries=(2, 2), techniques=(8, 8), cost_follows_ability=0.3)
    rng = np.random.default_rng(0)
    ability = np.linspace(0.0, 1.0, 8)
    costs = np.array([simulation._seconds(rng, ability) for _ in range(800)])
    assert costs.min() < 0.03
    assert costs.max() > 1.5
    logs = np.log10(costs)
    assert abs(logs.mean() - math.log10(0.2)) < 0.05  # log-uniform: no pull to the centre
    following = np.mean([np.corrcoef(row, ability)[0, 1] for row in logs])
    assert 0.15 < following < 0.4


def test_aliased_places_look_like_what_they_repeat() -> None:
    source = repeated_places(np.random.default_rng(0), 200, 3.0, (20, 20))
    places = np.arange(200)
    repeats = np.flatnonzero(source != places)
    assert repeats.size >= 20
    assert (source[repeats] < repeats).all()
    shares = []
    for density in (0.0, 3.0):
        simulation = replace(
            PLAIN, alias_density=density, alias_length=(20, 20), aliasing=(1.0, 1.0),
            queries=(200, 200), same_length=1.0,
        )  # fmt: skip
        routes = [simulation.route(np.random.default_rng(seed)) for seed in range(4)]
        shares.append(np.mean([accuracy(route).mean() for route in routes]))
    assert shares[1] < shares[0] - 0.1


def test_hubs_and_voids_show_in_the_columns() -> None:
    spread = []
    for strength in (0.0, 1.5):
        simulation = replace(
            PLAIN, bland_density=4.0, bland=(strength, strength), shift=(0.8, 0.8),
            queries=(200, 200),
        )  # fmt: skip
        routes = [simulation.route(np.random.default_rng(seed)) for seed in range(4)]
        spread.append([describe(r, t, {})["hubness"] for r in routes for t in range(4)])
    assert np.mean(spread[1]) > 1.1 * np.mean(spread[0])
    assert (np.array(spread[1]) > spread[0]).mean() > 0.7


def test_a_condition_shifts_whole_rows_and_columns() -> None:
    queries, references = 400, 300
    place = np.arange(queries) % references * 1.0
    world = RouteModel(
        place=place,
        seen=place,
        condition=np.repeat([0, 1], queries // 2),
        competence=np.full((1, 2), 0.5),
        source=np.arange(references),
        bland=np.zeros(references, np.float32),
    )
    scores = np.empty((queries, references), np.float32)
    rows, columns = {}, {}
    for shift, lasting in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)):
        ranges = Simulation(shift=(shift, shift), lasting=(lasting, lasting))
        look = ranges._technique_model(np.random.default_rng(0))
        apart = []
        for seed in range(8):
            write_scores(np.random.default_rng(seed), world, look, 0, scores)
            day, night = scores[: queries // 2], scores[queries // 2 :]
            spread = scores.std(axis=1).mean()
            apart.append(
                [
                    abs(day.mean() - night.mean()) / spread,
                    (day - night).mean(axis=0).std() / spread,
                ]
            )
        rows[shift, lasting], columns[shift, lasting] = np.mean(apart, axis=0)
    assert rows[1.0, 0.0] > 2.0 * rows[0.0, 0.0]
    assert columns[1.0, 0.0] > 2.0 * columns[0.0, 0.0]
    # What lasts is the same by day and by night.
    assert rows[1.0, 1.0] < 0.7 * rows[1.0, 0.0]
    assert columns[1.0, 1.0] < 0.7 * columns[1.0, 0.0]


@pytest.mark.parametrize(("length", "grain"), [(0.0, 0.0), (4.0, 0.0), (4.0, 0.4), (300.0, 0.0)])
def test_smooth_sequences_have_the_stated_correlation(length: float, grain: float) -> None:
    rng = np.random.default_rng(0)
    many = np.stack(
        [smooth(rng, 3 * BLOCK + 5, 50, length, grain) for _ in range(60)]
    )  # (60, n, D)
    steps = many.transpose(1, 0, 2).reshape(3 * BLOCK + 5, -1).astype(np.float64)
    assert np.allclose(steps.std(axis=1), 1.0, atol=0.06)  # stationary, from the first step on
    for i, d in ((0, 1), (0, 5), (BLOCK - 1, 1), (BLOCK - 3, 6), (2 * BLOCK, 3)):
        expected = (1.0 - grain) * math.exp(-d / length) if length else 0.0
        assert abs(np.corrcoef(steps[i], steps[i + d])[0, 1] - expected) < 0.06


@pytest.mark.parametrize("bend", [-0.3, -0.03, 0.0, 0.03, 0.45])
def test_bending_changes_values_but_no_ranking(bend: float) -> None:
    simulation = replace(PLAIN, queries=(20, 20), references=60)
    flat = replace(simulation, bend=(0.0, 0.0)).route(np.random.default_rng(4))
    bent = replace(simulation, bend=(bend, bend)).route(np.random.default_rng(4))
    assert np.array_equal(flat.scores.argmax(axis=2), bent.scores.argmax(axis=2))
    ranks = np.argsort(flat.scores, axis=2)
    assert (np.diff(np.take_along_axis(bent.scores, ranks, axis=2), axis=2) >= -1e-6).all()


def test_planted_one_technique_is_good_at_a_time_and_each_in_its_turn() -> None:
    for seed, jumps in itertools.product(range(3), (False, True)):
        bank = planted(seed, jumps=jumps)
        assert bank.shape == (4, 400, 1000)
        parts = np.array([accuracy(bank, slice(i, i + 100)) for i in range(0, 400, 100)])
        good = parts.argmax(axis=1)
        assert sorted(good) == [0, 1, 2, 3]
        assert (parts.max(axis=1) > 0.9).all()
        assert (np.sort(parts, axis=1)[:, :-1] < 0.15).all()
        assert np.ptp(bank.seconds) < 0.15 * bank.seconds.mean()


def test_planted_motion_is_steady_or_jumps_at_every_regime() -> None:
    assert (np.diff(centres(planted(1))[3:-3]) == 1).all()
    steps = np.diff(centres(planted(1, jumps=True))[3:-3])
    assert np.flatnonzero(steps != 1).tolist() == [96, 196, 296]  # three frames are cut off


def test_planted_with_more_regimes_than_techniques_never_repeats_at_once() -> None:
    bank = planted(5, regimes=7, frames_per_regime=30, techniques=3, references=300)
    good = [int(accuracy(bank, slice(i, i + 30)).argmax()) for i in range(0, 210, 30)]
    assert sorted(good[:3]) == [0, 1, 2]
    assert all(a != b for a, b in itertools.pairwise(good))


@pytest.mark.parametrize(("length", "kinds"), [(1, 1), (5, 1), (1, 4), (4, 4), (40, 3)])
def test_no_repeats_uses_all_kinds_first(length: int, kinds: int) -> None:
    order = no_repeats(np.random.default_rng(0), length, kinds)
    assert order.shape == (length,)
    assert len(set(order[:kinds].tolist())) == min(length, kinds)
    assert kinds == 1 or (np.diff(order) != 0).all()


def test_every_measure_is_finite_on_a_simulated_route() -> None:
    bank = simulate(2, queries=60)
    places = centres(bank)
    measured = describe(bank, 1, dict.fromkeys(STATISTICS, places))
    assert set(measured) == set(MEASURES) | {"run_mean"}
    assert all(math.isfinite(value) for value in measured.values())
    assert measured["accuracy_mean"] == measured["accuracy_belief"] == 1.0
    assert measured["run_evidence"] == measured["run_belief"] == 0.0


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ({"seed": -1}, "seed is -1"),
        ({"seed": 1.5}, "seed is 1.5"),
        ({"seed": True}, "seed is True"),
        ({"seed": 0, "queries": 0}, "queries is 0"),
        ({"seed": 0, "queries": 2.0}, "queries is 2.0"),
        ({"seed": 0, "references": 0}, "references is 0"),
        ({"seed": 0, "queries": 300, "references": 299}, "at least as many places"),
        ({"seed": 0, "techniques": 0}, "techniques is 0"),
        ({"seed": 0, "techniques": 27}, "from 1 to 26"),
        ({"seed": 0, "motion": "pased"}, "did you mean 'paced'"),
        ({"seed": 0, "motion": "varied"}, "valid: recorded, paced, kidnapped"),
    ],
)
def test_simulate_refuses_bad_arguments(arguments: dict[str, Any], part: str) -> None:
    with pytest.raises(ValueError, match=part):
        simulate(**arguments)


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ({"techniques": 1}, "techniques is 1"),
        ({"regimes": 0}, "regimes is 0"),
        ({"frames_per_regime": -5}, "frames_per_regime is -5"),
        ({"references": 399}, "use at least 400"),
    ],
)
def test_planted_refuses_bad_arguments(arguments: dict[str, Any], part: str) -> None:
    with pytest.raises(ValueError, match=part):
        planted(0, **arguments)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("queries", (10, 5)),
        ("queries", (1.5, 3)),
        ("queries", 100),
        ("techniques", (0, 4)),
        ("ability", (0.2, 1.2)),
        ("weak", [0.0, 0.1]),
        ("shift", (0.0, math.nan)),
        ("seconds", (0.0, 1.0)),
        ("smoothness", (-1.0, 2.0)),
        ("dimensions", (1, 8)),
        ("map_factor", (0.5, 1.0)),
        ("regime_length", (0.0, 9.0)),
        ("useless", 1.1),
        ("hubs", "many"),
        ("alias_density", -1.0),
        ("alias_length", (0, 3)),
        ("tolerance", -1),
        ("references", 2.5),
    ],
)
def test_ranges_are_checked_when_they_are_made(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=name):
        Simulation(**{name: value})
