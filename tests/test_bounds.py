"""Single and virtual best, on rows that can be reckoned with by hand."""

from __future__ import annotations

import pytest
from amusic_baselines import make_policy
from env_cases import random_bank

from amusic_gym.evaluation.bounds import gap_closed, is_fixed, single_best, virtual_best
from amusic_gym.evaluation.contestants import all_subsets
from amusic_gym.evaluation.metrics import AVERAGED, mean_rows, summarise
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context


def row(bank, policy, auc, compute, **other):
    return {
        **dict.fromkeys(AVERAGED, 0.0),
        **{"bank": bank, "policy": policy, "auc": auc, "compute": compute, "accuracy": 1 - auc},
        **{
            "compute_weight": None,
            "statistic": "evidence",
            "carry": True,
            "costs": "runs",
            "queries": 10,
        },
        **{"median_error": None, **other},
    }


ROWS = [
    row("one", "single:A", 0.75, 0.25),
    row("one", "single:B", 0.5, 0.5),
    row("one", "music", 0.5, 1.0),
    row("one", "amusic", 1.0, 0.1, statistic="mean"),
    row("one", "raw:A", 1.0, 0.1, statistic="none"),
    row("two", "single:A", 0.25, 0.25),
    row("two", "single:B", 1.0, 0.5),
    row("two", "music", 0.875, 1.0),
    row("two", "oracle", 1.0, 0.1),
]


def test_single_best_is_best_on_average():
    best = single_best(ROWS)
    assert (best["policy"], best["chosen"], best["bank"]) == ("single best", "single:B", "mean")
    assert (best["auc"], best["compute"], best["queries"]) == (0.75, 0.5, 20)


def test_virtual_best_is_best_on_each_route():
    best = virtual_best(ROWS)
    assert (best["policy"], best["bank"]) == ("virtual best", "mean")
    assert best["chosen"] == {"one": "single:A", "two": "single:B"}
    assert (best["auc"], best["compute"], best["queries"]) == (0.875, 0.375, 20)


def test_within_a_compute():
    assert single_best(ROWS, most_compute=0.4)["chosen"] == "single:A"
    cheap = virtual_best(ROWS, most_compute=0.25)
    assert cheap["chosen"] == {"one": "single:A", "two": "single:A"}
    assert (cheap["auc"], cheap["compute"]) == (0.5, 0.25)
    # 1 as a sum of many shares may come out a bit above 1
    everything = [row("one", "music", 0.5, 1.0 + 4e-16)]
    assert single_best(everything, most_compute=1.0)["chosen"] == "music"


def test_by_another_column():
    assert single_best(ROWS, by="accuracy")["chosen"] == "single:A"
    assert virtual_best(ROWS, by="accuracy")["chosen"] == {"one": "single:B", "two": "single:A"}


def test_of_equally_good_ones_the_cheaper():
    rows = [row("one", "music", 0.5, 1.0), row("one", "single:A", 0.5, 0.25)]
    for order in (rows, rows[::-1]):
        assert single_best(order)["chosen"] == "single:A"
        assert virtual_best(order)["chosen"] == {"one": "single:A"}


def test_the_single_best_was_run_on_every_route_the_virtual_one_need_not():
    rows = [*ROWS, row("two", "single:C", 1.0, 0.125)]
    assert single_best(rows)["chosen"] == "single:B"
    assert virtual_best(rows)["chosen"]["two"] == "single:C"
    apart = [row("one", "single:A", 0.5, 0.5), row("two", "single:B", 0.5, 0.5)]
    with pytest.raises(ValueError, match="no fixed subset was run on every route at a compute of"):
        single_best(apart)


def test_rows_are_left_as_they_were():
    before = [dict(one) for one in ROWS]
    single_best(ROWS)
    virtual_best(ROWS)
    assert before == ROWS


@pytest.mark.parametrize("bound", [single_best, virtual_best])
@pytest.mark.parametrize(
    ("rows", "arguments", "sentence"),
    [
        ([], {}, "no row of a fixed subset; compare some, for example with --all-subsets"),
        ([row("one", "raw:A", 1, 1), row("one", "oracle", 1, 1)], {}, "no row of a fixed subset"),
        (
            [*ROWS, row("one", "subset:A+B", 1, 1, statistic="mean")],
            {},
            "have several statistic: evidence, mean; give those of one",
        ),
        (
            [*ROWS, row("one", "subset:A+B", 1, 1, carry=False)],
            {},
            "have several carry: True, False; give those of one",
        ),
        (
            [*ROWS, row("one", "subset:A+B", 1, 1, costs="paper")],
            {},
            "have several costs: runs, paper; give those of one",
        ),
        ([*ROWS, ROWS[0]], {}, "single:A has two rows on 'one'; give one row per route"),
        (ROWS, {"most_compute": 0.2}, "at a compute of at most 0.2; raise most_compute, or"),
        (ROWS, {"by": "auk"}, "unknown column to be best in 'auk': did you mean 'auc'"),
        (ROWS, {"by": "lost"}, "unknown column to be best in 'lost'"),
    ],
)
def test_rows_without_a_bound_are_refused(bound, rows, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        bound(rows, **arguments)


def test_fixed_are_the_policies_of_all_subsets():
    assert all(is_fixed(policy) for policy in all_subsets(["A", "B", "C"]))
    others = ("raw:A", "amusic", "amusic:evidence", "random:1", "cascade", "musical", "ppo:music")
    assert not any(is_fixed(policy) for policy in others)


def test_gap_closed():
    assert gap_closed(0.5, 0.5, 0.75) == 0.0
    assert gap_closed(0.75, 0.5, 0.75) == 1.0
    assert gap_closed(0.625, 0.5, 0.75) == 0.5
    assert gap_closed(0.25, 0.5, 0.75) == -1.0
    assert gap_closed(0.5, 0.5, 0.5) is None


def test_on_the_rows_of_a_comparison():
    banks = [random_bank(seed) for seed in (1, 2, 3)]
    rows = []
    for bank in banks:
        context = Context.of(bank, statistic="evidence")
        for spec in all_subsets(bank.techniques):
            rows.append(summarise(rollout(make_policy(spec, context), bank, name=spec)))
    single, virtual = single_best(rows), virtual_best(rows)
    assert single["auc"] == max(mean["auc"] for mean in mean_rows(rows))
    assert virtual["auc"] == pytest.approx(
        sum(max(r["auc"] for r in rows if r["bank"] == bank.name) for bank in banks) / 3
    )
    assert virtual["auc"] >= single["auc"]
