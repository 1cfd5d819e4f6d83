"""Leaderboards, and sentences on who is ahead where, of made-up findings."""

from __future__ import annotations

from types import SimpleNamespace

from amusic_gym.evaluation.study.standings import leaderboard, standing, where_ahead


def front(name: str, family: str, volume: float, begins: float, *auc: float | None, bank="mean"):
    return {
        **{"condition": "paced", "bank": bank, "front": name, "family": family},
        **{"hypervolume": volume, "hypervolume_interval": None, "begins": begins},
        "auc_at": list(auc),
    }


FRONTS = [
    front("fixed subsets", "fixed", 0.4, 0.05, 0.5, 0.5, 0.7, 0.7, 0.9),
    front("mine", "learned", 0.6, 0.05, 0.5, 0.6, 0.8, 0.8, 0.8),
    front("hmm", "peer", 0.0, 1.0, None, None, None, None, 0.85),
    front("xu", "peer", 0.0, 1.0, None, None, None, None, 0.95),
    front("oracle", "bound", 0.9, 0.05, 1.0, 1.0, 1.0, 1.0, 1.0),
    *(
        front(name, family, 0.0, 1.0, None, None, None, None, auc, bank=bank)
        for bank, of in {
            "hall": {"fixed subsets": 0.9, "mine": 0.8, "hmm": 0.91, "xu": 0.99},
            "road": {"fixed subsets": 0.9, "mine": 0.96, "hmm": 0.9, "xu": 0.95},
        }.items()
        for (name, auc), family in zip(
            of.items(), ("fixed", "learned", "peer", "peer"), strict=True
        )
    ),
]


def match(weight: float, compute: float, kind: str, difference: float | None):
    sure = None if difference is None else [difference - 0.01, difference + 0.01]
    return {
        **{"condition": "paced", "bank": "mean", "policy": "mine", "compute_weight": weight},
        **{"compute": compute, "kind": kind, "difference": difference},
        **{"rival": None if difference is None else "x", "difference_interval": sure},
    }


MATCHES = [
    match(0.1, 0.5, "fixed subsets", 0.1),
    match(0.1, 0.5, "cascade", 0.0),
    match(0.1, 0.5, "may idle", -0.2),
    match(1.0, 0.2, "fixed subsets", 0.1),
    match(1.0, 0.2, "cascade", 0.2),
    match(1.0, 0.2, "may idle", 0.2),
    match(6.0, 0.05, "fixed subsets", -0.1),
    match(6.0, 0.05, "cascade", None),
]
FINDINGS = SimpleNamespace(
    fronts=FRONTS,
    matches=MATCHES,
    routes=[{"bank": "hall"}, {"bank": "road"}],
    settings={"costs": "paper", "needs_truth": {"oracle": "of the route itself"}},
)


def test_a_leaderboard_has_the_greatest_area_first_and_then_the_highest_auc():
    table = leaderboard(FINDINGS, "paced", "Motions")
    assert [row[0] for row in table.rows] == ["oracle †", "mine", "fixed subsets", "xu", "hmm"]
    assert table.heads[-5:] == ["≤ 5%", "≤ 10%", "≤ 20%", "≤ 40%", "≤ 100%"]
    assert table.rows[1] == ["mine", "0.600", "", "5.0 %", *("0.500", "0.600"), *["0.800"] * 3]
    assert table.rows[3][4:] == ["–", "–", "–", "–", "0.950"]
    assert "Mean over 2 routes, paper costs" in table.note
    assert "† has seen ground truth: oracle of the route itself." in table.note


def test_who_is_highest_at_which_compute_and_where_peers_are_ahead():
    first, second = where_ahead(FINDINGS, "paced")
    assert first == (
        "Highest mean AUC at no more compute, paced: ≤ 5% **fixed subsets** and **mine** (0.500);"
        " ≤ 10% **mine** (0.600); ≤ 20% **mine** (0.800); ≤ 40% **mine** (0.800);"
        " ≤ 100% **xu** (0.950)."  # the oracle is no rival
    )
    assert second == (
        "Peers that are ahead of every rule and selector at any compute: **hmm** on hall (0.910,"
        " the best other 0.900); **xu** on hall (0.990, the best other 0.900)."
    )


def test_where_a_selector_is_ahead_of_all_and_where_behind():
    assert standing(FINDINGS, "paced") == [
        "**mine** is ahead of every kind of rule that always runs something at 20.0 %, of those"
        " that may idle at 20.0 %; behind fixed subsets at 5.0 %; behind may idle at 50.0 %; else"
        " level with the best."
    ]
