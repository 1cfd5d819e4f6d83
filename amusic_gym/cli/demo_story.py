"""What the demo's numbers say, in plain sentences."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from amusic_gym.evaluation.audit import PARTING
from amusic_gym.evaluation.study import Findings
from amusic_gym.evaluation.study.findings import ahead
from amusic_gym.evaluation.study.plan import MEAN
from amusic_gym.evaluation.study.run import Row
from amusic_gym.evaluation.study.tables import rival_label
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.registry import FRONTS, MAY_IDLE
from amusic_gym.policies.trace import Trace

TIE = 0.005  # AUC by which a dearer λ must be better to be spoken of


def best_within(rows: Sequence[Row], compute: float) -> Row:
    """The cheapest row within `TIE` of the highest AUC at no more compute; or just the cheapest."""
    fitting = [row for row in rows if row["compute"] <= compute]
    if not fitting:
        return min(rows, key=lambda row: row["compute"])
    least = max(row["auc"] for row in fitting) - TIE
    return min((row for row in fitting if row["auc"] >= least), key=lambda row: row["compute"])


NOT_HOPELESS = 0.2  # accuracy of a drive that fails and is worth a look


class Tale(NamedTuple):
    """What the study of the tours says."""

    sentences: list[str]  # the first on the first selector
    table: Table  # of every selector, with the best rival of each kind at no more compute
    rivals: list[str]  # policies that the table names
    weights: dict[str, float]  # name of a selector → λ that is spoken of


def on_tours(findings: Findings, selectors: Mapping[str, str]) -> Tale:
    """Every selector against the best of each kind of rival on the tours.

    ``selectors``: name in the study → how a sentence begins.
    """
    points = [row for row in findings.points if row["bank"] == MEAN]
    of = {row["policy"]: row for row in points}
    amusic, same, music = of["amusic"], of["amusic:evidence"], of["music"]
    lines, matches, weights = [], [], {}
    for name, words in selectors.items():
        own = best_within([row for row in points if row["policy"] == name], same["compute"])
        against = _against(findings, own)
        matches += against
        weights[name] = own["compute_weight"]
        lines.append(
            f"{words}, at λ {own['compute_weight']:g}, reaches AUC {own['auc']:.3f}"
            f" ({_span(own['auc_interval'])}) at {own['compute']:.0%} of the compute of all"
            f" techniques; {_standing(against)}{_dearer(own, same)}."
        )
    lines.append(
        f"A-MuSIC as in the paper: {amusic['auc']:.3f} at {amusic['compute']:.0%}; the same rule on"
        f" the selector's statistic: {same['auc']:.3f} at {same['compute']:.0%}; every technique on"
        f" every frame: {music['auc']:.3f}. In brackets 95 % intervals over {len(findings.routes)}"
        f" tours and {len(findings.settings['seeds'])} draws, of one training; each rival is the"
        " best of its kind on these very tours, of equals the cheapest, which no one would know"
        " beforehand."
    )
    if parted := dict.fromkeys(r["front"] for r in findings.audit if r["greatest_gap"] > PARTING):
        lines.append(
            f"Estimated correctness is too high by more than {PARTING:g} on some tour for"
            f" {', '.join(parted)}: see the audit."
        )
    rivals = list(dict.fromkeys(match["rival"] for match in matches))
    return Tale(lines, _table(matches), rivals, weights)


def highlights(
    traces: Sequence[Trace], tours: Sequence[str], stops: str, selector: str, tale: Tale
) -> list[tuple[str, Trace]]:
    """A selector's drives to look at first: as spoken of, with stops, and one that fails.

    ``tours`` and ``stops`` are names of banks. With stops there is one by the belief, too.
    """
    own = [trace for trace in traces if trace.policy == selector]
    spoken = [trace for trace in own if trace.compute_weight == tale.weights[selector]]
    belief = [trace for trace in traces if trace.bank == stops and trace.policy == "ppo@belief"]
    chosen = [
        (f"as above, on {tours[0]}", [each for each in spoken if each.bank == tours[0]]),
        ("with stops", [each for each in spoken if each.bank == stops]),
        ("with stops, by the belief", belief),
    ]
    found = [(words, drives[0]) for words, drives in chosen if drives]
    ranked = sorted(
        (trace for trace in own if trace.bank in tours), key=lambda trace: trace.correct.mean()
    )
    worst = next((each for each in ranked if each.correct.mean() >= NOT_HOPELESS), ranked[0])
    return [*found, (f"one that fails: λ {worst.compute_weight:g} on {worst.bank}", worst)]


def _against(findings: Findings, own: Row) -> list[Row]:
    """The best rival of each kind at no more compute than a point of a selector."""
    key = ("bank", "policy", "compute_weight")
    return [
        row
        for row in findings.matches
        if all(row[name] == own[name] for name in key) and row["rival"] is not None
    ]


def _standing(matches: Sequence[Row]) -> str:
    """How a point of a selector stands to its rivals, by name."""
    idle = [row for row in matches if row["kind"] == FRONTS[MAY_IDLE]]
    others = [row for row in matches if row["kind"] != FRONTS[MAY_IDLE]]
    said = f"at no more it is {_verdicts(others)}" if others else "nothing else is so cheap"
    return said + (f"; of rules that may run nothing, {_verdicts(idle)}" if idle else "")


def _dearer(own: Row, amusic: Row) -> str:
    """A-MuSIC on the same statistic, where it costs more and is therefore no rival."""
    if amusic["compute"] <= own["compute"]:
        return ""
    return f"; A-MuSIC on the same statistic takes {amusic['compute']:.0%} for {amusic['auc']:.3f}"


VERDICTS = {True: "ahead of", None: "level with", False: "behind"}


def _verdicts(matches: Sequence[Row]) -> str:
    parts = []
    for verdict, words in VERDICTS.items():
        if named := [_named(row) for row in matches if ahead(row) is verdict]:
            parts.append(f"{words} {', '.join(named)}")
    return "; ".join(parts)


def _named(match: Row) -> str:
    """A rival, its AUC and compute: "HOG (0.676 at 5%)"."""
    return f"{rival_label(match)} ({match['rival_auc']:.3f} at {match['rival_compute']:.0%})"


def _table(matches: Sequence[Row]) -> Table:
    rows = [
        [f"{match['policy']}, λ {match['compute_weight']:g}", VERDICTS[ahead(match)]]
        + [rival_label(match), match["kind"], f"{match['rival_auc'] + match['difference']:.3f}"]
        + [f"{match['rival_auc']:.3f}", f"{match['rival_compute']:.1%}"]
        + [_span(match["difference_interval"] or [match["difference"]], "+")]
        for match in matches
    ]
    heads = ["selector", "is", "rival", "the best of", "AUC", "rival's", "its compute"]
    title = "The best rival of each kind at no more compute"
    note = (
        "AUC: the selector's at that λ, and the rival's, which costs no more; its compute as a"
        " share of running everything. Level with: 0 is in the 95 % interval of the difference, the"
        " selector's minus the rival's."
    )
    return Table(title, [*heads, "difference, 95 %"], rows, note, words=4)


def _span(ends: Sequence[float], sign: str = "") -> str:
    return " to ".join(f"{end:{sign}.3f}" for end in ends)


def other(bank: str, rows: Sequence[Row], selector: str) -> str:
    """One sentence on a recording: a selector against A-MuSIC."""
    paper, same = (
        next(row for row in rows if row["policy"] == name) for name in ("amusic", "amusic:evidence")
    )
    own = best_within([row for row in rows if row["policy"] == selector], same["compute"])
    return (
        f"On {bank}, which no training saw, {selector} reaches AUC {own['auc']:.3f} at"
        f" {own['compute']:.1%} of the compute (λ {own['compute_weight']:g}); A-MuSIC"
        f" {paper['auc']:.3f} at {paper['compute']:.0%}, on the selector's statistic"
        f" {same['auc']:.3f} at {same['compute']:.0%}."
    )
