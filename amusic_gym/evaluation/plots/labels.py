"""How policies and techniques are named and coloured, the same in every figure and page.

Colours are taken from Okabe and Ito's and Tol's sets, made for every common kind of colour vision;
their bright yellow is left out, it vanishes on white.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING

from amusic_gym.evaluation.marks import MARK

if TYPE_CHECKING:
    from amusic_gym.policies.trace import Trace

SWEEP_COLOURS = ("#D55E00", "#7B3294", "#008837", "#A50F15")  # one per policy with λ
POLICY_MARKS = {  # policy -> colour and marker in figures of policies
    "amusic": ("#0072B2", "D"),
    "music": ("#000000", "s"),
    "cascade": ("#6F4E37", "^"),
    "random": ("#999999", "v"),
    "periodic": ("#E7298A", "o"),
    "voi": ("#005A32", "D"),
    "oracle": ("#999933", "*"),
    "mpf": ("#AA3377", "<"),
    "hmpf": ("#AA3377", ">"),
    "dynmpf": ("#AA3377", "p"),
    "switchhit": ("#B15928", "X"),
    "plurality": ("#6699CC", "h"),
    "borda": ("#6699CC", "H"),
    "hmm": ("#004488", "d"),
}
OTHER_MARK = ("#6F4E37", "P")
MAY_IDLE = ("random", "periodic", "voi")  # policies with a variant under which nothing may run
FIXED = ("single", "subset")  # policies that run the same techniques on every frame


def policy_label(policy: str) -> str:
    """A policy's name for a reader: "single:HOG" -> "HOG", "amusic" -> "A-MuSIC"."""
    kind, _, argument = policy.partition(":")
    names = {
        **{"amusic": "A-MuSIC", "music": "MuSIC", "ppo": "selector"},
        **{"mpf": "MPF", "hmpf": "H-MPF-style", "dynmpf": "Dyn-MPF-style", "hmm": "Markov filter"},
        **{"switchhit": f"SwitchHit-style {MARK}", "oracle": f"oracle {MARK}", "borda": "Borda"},
        **{"voi": "value of information"},
    }
    if kind in FIXED and argument:
        return argument
    if kind == "raw" and argument:
        return f"{argument}, no SIC"
    if kind == "random" and argument:
        return f"random, p = {argument.replace('/idle', ', may idle')}"
    if kind == "periodic" and argument:
        return _periodic_label(*argument.split("/"))
    if kind == "voi" and argument:
        return names[kind] + _voi_label(argument)
    if kind == "ppo" and argument:
        return f"selector {PurePath(argument).name}"
    return names.get(kind, kind) + (f" ({argument})" if argument else "")


def _periodic_label(period: str, *subsets: str) -> str:
    """The argument of "periodic": ("5", "HOG", "idle") -> "HOG every 5 frames, else idle"."""
    often = "every frame" if period == "1" else f"every {period} frames"
    chosen, *between = subsets or ("all",)
    return ", else ".join([f"{chosen} {often}", *between])


def _voi_label(argument: str) -> str:
    """The argument of "voi": "0.15/idle" -> ", fixed λ 0.15, may idle"."""
    parts = argument.split("/")
    return "".join(", may idle" if part == "idle" else f", fixed λ {part}" for part in parts)


def is_idle(policy: str) -> bool:
    """Whether nothing may run on a frame: "random:0.5/idle", "voi:idle"."""
    kind, _, argument = policy.partition(":")
    return kind in MAY_IDLE and argument.split("/")[-1] == "idle"


def is_variant(policy: str) -> bool:
    """Whether it is a variant of a policy that has a mark: "amusic:evidence", "random:0.5/idle"."""
    return is_idle(policy) or policy.startswith("amusic:")


def policy_mark(policy: str) -> tuple[str, str]:
    """Colour and marker of a policy that is neither fixed nor swept over compute weights."""
    return POLICY_MARKS.get(policy.partition(":")[0], OTHER_MARK)


def weight_label(weight: float) -> str:
    """A compute weight as short as it stays exact to three digits."""
    return f"λ {weight:.3g}"


def all_techniques(ensembles: Iterable[Sequence[str]]) -> tuple[str, ...]:
    """Every technique of several ensembles once, in order of first appearance."""
    return tuple(dict.fromkeys(name for ensemble in ensembles for name in ensemble))


def trace_label(trace: Trace) -> str:
    """A trace's policy and, where it has one, compute weight."""
    name = policy_label(trace.policy)
    if trace.compute_weight is not None:
        name += f", {weight_label(trace.compute_weight)}"
    return legend_name(name)


def bank_label(bank: str) -> str:
    """A bank's name as far as a title holds it; a stand-in for an empty one."""
    return (bank if len(bank) <= 36 else bank[:35] + "…") or "unnamed bank"


def legend_name(name: str) -> str:
    """Matplotlib hides entries that begin with an underscore; a space before it shows them."""
    return f" {name}" if name.startswith("_") else name


def sweep_colour(number: int) -> str:
    """Colour of the learned selector of that number in a figure."""
    return SWEEP_COLOURS[number % len(SWEEP_COLOURS)]
