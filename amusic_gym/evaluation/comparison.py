"""Policies against each other on the same routes: rows, traces and figures in one folder.

Every finished row is kept at once, so that a comparison which was stopped or killed goes on where
it was.
"""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill
from typing import Any, TypeVar

import numpy as np

from amusic_gym import __version__
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.bank_files import refuse_within_bank
from amusic_gym.banks.ranking import ranked
from amusic_gym.estimation.settings import SICSettings, statistic_label
from amusic_gym.evaluation import metrics, rollout, store
from amusic_gym.evaluation.audit import Audit, audit, parting
from amusic_gym.evaluation.contestants import Contestant
from amusic_gym.evaluation.tables import COLUMNS, OTHERS, Table, footnote, legend, marked
from amusic_gym.policies.protocol import Context, Correction
from amusic_gym.policies.trace import DONE, Trace
from amusic_gym.routes.bank_images import BankImages
from amusic_gym.utils.checks import whole
from amusic_gym.utils.escaping import CsvWriter
from amusic_gym.utils.names import distinct, file_stem
from amusic_gym.utils.storage import keep_only, write_whole

ROWS, TRACES, LISTS, RESULTS = "rows", "traces", "lists", "results.json"
LIST_COLUMNS = ("query", "rank", "place", "correct")

Report = Callable[[str], None]

_Item = TypeVar("_Item")


@dataclass(frozen=True)
class Comparison:
    """What came out: one trace and one row for each policy, λ and bank."""

    traces: list[Trace]  # in the order of the banks, then of the policies
    rows: list[dict[str, Any]]  # of ``results.json``, in the same order
    # the rows averaged over banks, of those (policy, λ, statistic, carry) that every bank has
    mean: list[dict[str, Any]]
    # name of a policy → of what it needs ground truth
    needs_truth: dict[str, str] = field(default_factory=dict)
    # name of a bank → its images, if it has a list of them
    images: dict[str, BankImages | None] = field(default_factory=dict)


@dataclass(frozen=True)
class _Entry:
    """One row to be: a policy with one λ on one bank."""

    contestant: Contestant
    context: Context
    compute_weight: float | None
    own: Correction
    key: Mapping[str, Any]  # all that may change the row

    def run(self) -> Trace:
        return rollout.rollout(
            self.contestant.make(self.context),
            self.context.bank,
            name=self.contestant.name,
            compute_weight=self.compute_weight,
            **self.own._asdict(),
        )


def compare(
    banks: Sequence[ScoreBank],
    contestants: Callable[[ScoreBank], Sequence[Contestant]],
    out: str | Path,
    *,
    statistic: str = SICSettings.statistic,
    carry: bool | None = None,
    discount: bool | None = None,
    seed: int = 0,
    top: int | None = None,
    report: Report = print,
) -> Comparison:
    """Run every contestant on every bank; write rows, traces and ``results.json`` to ``out``.

    Rows that are finished in ``out`` already are not run again; traces of an earlier comparison
    that has others than this one go. Nothing runs before every policy
    has been built once, so that a wrong name is refused at once.

    Args:
        banks: the routes, with the costs to reckon with. A name that several share is numbered.
        contestants: the policies for a bank.
        out: the folder; made if it is not there.
        statistic: SIC's, for every policy that does not bring its own.
        carry: whether places are carried on as candidates, likewise; None: as the statistic has it.
        discount: whether MuSIC discounts alike rows, likewise; None: as the statistic has it.
        seed: for policies that draw.
        top: also write each query's ranked list of so many places, to ``lists``; None: none.
        report: is given one line per finished row.

    Raises:
        ValueError: for no bank, no policy, banks with different cost models, a policy that does
            not fit a bank, or an ``out`` in the folder of a bank.
    """
    check_banks(banks)
    whole("seed", seed, 0)
    count = whole("top", 1 if top is None else top, 1)
    chosen = {"statistic": statistic, "carry": carry, "discount": discount}
    names = distinct([bank.name or "bank" for bank in banks], taken=("mean",))
    entries = [
        entry
        for bank, name in zip(banks, names, strict=True)
        for entry in _entries(_renamed(bank, name), contestants, chosen, seed)
    ]
    if not entries:
        raise ValueError("no policy to compare; give at least one")
    out = Path(out)
    refuse_within_bank(out)
    files = [out / TRACES / f"{stem}.csv" for stem in trace_stems([e.key for e in entries])]
    lists = [out / LISTS / file.name for file in files] if top is not None else []
    run_on = {entry.context.bank.name: entry.context.bank for entry in entries}
    images = {name: BankImages.load(bank) for name, bank in run_on.items()}
    traces, rows = [], []
    for number, (entry, file) in enumerate(zip(entries, files, strict=True), 1):
        trace, kept = _finish(entry, out / ROWS, report)
        row = metrics.summarise(trace)
        trace.write_csv(file, images[trace.bank])
        for path in lists[number - 1 : number]:
            write_whole(path, ranked_lists(entry.context.bank, trace, count))
        traces.append(trace)
        rows.append(row)
        report(f"[{number}/{len(entries)}] {_line(row)}{' (was finished)' if kept else ''}")
    mean = metrics.mean_rows(_shared(rows))
    text = json.dumps({"rows": rows, "mean": mean}, indent=1, allow_nan=False)
    write_whole(out / RESULTS, text.encode() + b"\n")
    keep_only(out, "traces", files)
    keep_only(out, "lists", lists)
    made = [entry.contestant for entry in entries]
    needs_truth = {each.name: each.needs_truth for each in made if each.needs_truth}
    return Comparison(traces, rows, mean, needs_truth, images)


def check_banks(banks: Sequence[ScoreBank]) -> None:
    """Refuse no bank at all, and banks with different cost models, with a ValueError."""
    if not banks:
        raise ValueError("no score bank to compare on; give at least one")
    costs = list(dict.fromkeys(bank.costs for bank in banks))
    if len(costs) > 1:
        raise ValueError(
            f"the banks reckon with different costs ({', '.join(costs)}), which have no common "
            "mean; choose one cost model that all have, for example 'runs'"
        )


def _entries(
    bank: ScoreBank,
    contestants: Callable[[ScoreBank], Sequence[Contestant]],
    chosen: Mapping[str, Any],
    seed: int,
) -> list[_Entry]:
    """The rows of one bank; builds each policy once to see that it can be built."""
    context = Context.of(bank, seed=seed, **chosen)
    identity = store.bank_identity(bank)
    code = store.code_digest(Path(rollout.__file__))
    entries = []
    chosen_ones = dict.fromkeys(contestants(bank))
    try:
        made = [(each, each.make(context)) for each in chosen_ones]
    except ValueError as error:
        raise ValueError(f"bank {bank.name!r}: {error}") from error
    for contestant, policy in made:
        own = Correction.under(policy, **chosen)
        for weight in dict.fromkeys(contestant.compute_weights):
            key = {
                "bank": bank.name,
                "bank_identity": identity,
                "policy": contestant.name,
                "policy_version": contestant.version,
                "compute_weight": weight,
                **own._asdict(),
                "costs": bank.costs,
                "seed": seed,
                "package_version": __version__,
                "package_code": code,
            }
            entries.append(_Entry(contestant, context, weight, own, key))
    return entries


def _finish(entry: _Entry, folder: Path, report: Report) -> tuple[Trace, bool]:
    """The entry's trace, and whether it was there already."""
    stem = store.stem_of(entry.key)
    try:
        if (kept := store.load(folder, stem)) is not None:
            return _trace(entry, kept, folder, stem), True
    except ValueError as error:
        report(f"{error}: computed again")
    trace = entry.run()
    done: dict[str, Any] = {name: getattr(trace, name).tolist() for name in DONE}
    done["p_correct"] = [None if np.isnan(p) else p for p in done["p_correct"]]
    store.save(folder, stem, {"row": metrics.summarise(trace), "trace": done})
    return trace, False


def _trace(entry: _Entry, kept: dict[str, Any], folder: Path, stem: str) -> Trace:
    try:
        return Trace.join(
            entry.context.bank,
            policy=entry.contestant.name,
            statistic=entry.own.statistic,
            carry=entry.own.carry,
            compute_weight=entry.compute_weight,
            **kept["trace"],
        )
    except (ValueError, LookupError, TypeError, ArithmeticError) as error:
        raise store.damaged(folder, stem, error) from None


def _renamed(bank: ScoreBank, name: str) -> ScoreBank:
    if bank.name == name:
        return bank
    view = bank.subset(bank.techniques)  # a view of its own, whose name is free to change
    view.name = name
    return view


def ranked_lists(bank: ScoreBank, trace: Trace, count: int) -> bytes:
    """CSV of a line per query and rank, 1 to ``count`` at most, with the columns `LIST_COLUMNS`.

    What is ranked is said in `amusic_gym.banks.ranking`.
    """
    text = io.StringIO()
    writer = CsvWriter(text)
    writer.writerow(LIST_COLUMNS)
    for frame, prediction in enumerate(trace.predictions.tolist()):
        for rank, place in enumerate(ranked(bank, frame, trace.ran[frame], prediction, count), 1):
            right = bank.truth.is_true(int(place), frame)
            writer.writerow([frame, rank, int(place), int(right)])
    return text.getvalue().encode()


def trace_stems(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of the traces' files, without their ends, of all rows of ``results.json``."""
    weights = (row["compute_weight"] for row in rows)
    ends = ("" if weight is None else f"-{weight:g}" for weight in weights)
    names = [f"{row['bank']}-{row['policy']}{end}" for row, end in zip(rows, ends, strict=True)]
    return distinct([file_stem(name) for name in names])


def spread(items: Sequence[_Item], count: int) -> list[_Item]:
    """At most ``count`` of the items, evenly spaced, the ends among them."""
    if len(items) <= count:
        return list(items)
    steps = max(count - 1, 1)
    return [items[round(i * (len(items) - 1) / steps)] for i in range(count)]


SHOWN = (
    *("accuracy", "auc", "auc_vprbench", "auc_paper", *metrics.RECALLS),
    *("recall_at_100_precision", "ptr", "compute", "reselections", "lost"),
)
"""Columns of ``results.json`` in a terminal."""

LINE = 100  # letters of a line of text below a table


def table(comparison: Comparison) -> str:
    """The rows as text, a block per bank, and their mean where there are several banks.

    Below, what the columns mean, which policies need ground truth, and a warning for every policy
    and bank where p̂ and the truth part.
    """
    needs = comparison.needs_truth
    blocks = [_block(bank, rows, needs) for bank, rows in rows_by_bank(comparison.rows).items()]
    if len(blocks) > 1 and comparison.mean:
        blocks.append(_block(f"mean over {len(blocks)} banks", comparison.mean, needs))
    note = footnote((row["policy"] for row in comparison.rows), needs)
    below = [fill(legend(SHOWN), LINE), note, "\n".join(partings(comparison.traces))]
    return "\n\n".join(filter(None, [*blocks, *below]))


def partings(traces: Sequence[Trace]) -> list[str]:
    """One line for each policy and bank where mean p̂ and accuracy differ by more than `PARTING`."""
    groups: dict[tuple[str, str], list[tuple[str, Audit]]] = {}
    for trace in traces:
        weight = trace.compute_weight
        if (held := audit(trace)) is not None:
            group = groups.setdefault((trace.policy, trace.bank), [])
            group.append(("" if weight is None else f"λ {weight:g}", held))
    lines = [parting(f"{policy} on {bank}", held) for (policy, bank), held in groups.items()]
    return [line for line in lines if line is not None]


def _block(title: str, rows: Sequence[dict[str, Any]], needs_truth: dict[str, str]) -> str:
    title = f"{title} ({rows[0]['queries']} frames, {rows[0]['costs']} costs)"
    heads = ["policy", *OTHERS, *(COLUMNS[name].heading for name in SHOWN)]
    return Table(title, heads, [_cells(row, needs_truth) for row in rows], words=3).text()


def _cells(row: dict[str, Any], needs_truth: dict[str, str]) -> list[str]:
    weight = "" if row["compute_weight"] is None else f"{row['compute_weight']:g}"
    values = [f"{row[n]:g}" if n == "reselections" else f"{row[n]:.4f}" for n in SHOWN]
    statistic = statistic_label(row["statistic"], row["carry"])
    return [marked(row["policy"], needs_truth), weight, statistic, *values]


def _line(row: dict[str, Any]) -> str:
    weight = "" if row["compute_weight"] is None else f" λ {row['compute_weight']:g}"
    return (
        f"{row['bank']} {row['policy']}{weight}: auc {row['auc']:.4f}, compute {row['compute']:.4f}"
    )


def _shared(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows whose like every bank has: a mean over other banks could not be compared."""
    keys = [tuple(row[name] for name in metrics.MEAN_KEY) for row in rows]
    banks = len({row["bank"] for row in rows})
    return [row for row, key in zip(rows, keys, strict=True) if keys.count(key) == banks]


def rows_by_bank(rows: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Name of a bank → its rows."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["bank"], []).append(row)
    return groups
