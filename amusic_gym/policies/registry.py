"""The registered policies: how each is built, and all that comparisons and figures must know of it.

A provider is a module whose ``POLICIES`` maps names to :class:`RegisteredPolicy`: those of
`PROVIDERS`, and of other distributions the objects behind their entry points in the group
``amusic_gym.policies``. They are imported when a policy is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from importlib.metadata import entry_points
from typing import NamedTuple, NoReturn

from amusic_gym.policies.protocol import Context, Policy
from amusic_gym.utils.names import suggest

PROVIDERS = ("amusic_baselines", "amusic_agents.policies")
ENTRY_POINTS = "amusic_gym.policies"

MARK = "†"
"""Behind the names of policies that need ground truth."""

IDLE = "idle"
"""The end of an argument that lets nothing run on a frame."""


class Family(NamedTuple):
    """Policies that are compared as one kind."""

    # name of the front of AUC against compute that they make together; "": one each
    front: str = ""
    best: str = ""  # what a legend calls the best of them
    colour: str = ""  # of that front
    marker: str = ""  # of that front


FIXED, CASCADE, AMUSIC, PERIODIC, VOI = "fixed", "cascade", "amusic", "periodic", "voi"
RANDOM, MAY_IDLE, LEARNED, PEER, BOUND = "random", "idle", "learned", "peer", "bound"
VARIANT = "variant"

FAMILIES = {
    FIXED: Family("fixed subsets"),
    CASCADE: Family("cascade", "cascade", "#6F4E37", "^"),
    AMUSIC: Family("A-MuSIC"),
    PERIODIC: Family("periodic", "periodic rule", "#E7298A", "o"),
    VOI: Family("value of information", "value of information", "#005A32", "D"),
    RANDOM: Family("random", "random choice", "#CC9900", "v"),
    MAY_IDLE: Family("may idle", "rule that may idle", "#4477AA", "o"),
    LEARNED: Family(),
    PEER: Family(),
    BOUND: Family(),
    VARIANT: Family(),
}
"""``idle`` are rules of any kind under which nothing may run on a frame; ``peer`` other policies
from the literature; ``bound`` those that no robot could run; ``variant``, in no front, a policy
under another statistic, for ablations."""

FRONTS = {name: family.front for name, family in FAMILIES.items() if family.front}


def front_of(policy: str, family: str) -> str | None:
    """What the front is called that a policy is part of; None: of none.

    Those of a peer with whatever argument make one.
    """
    if family == VARIANT:
        return None
    return FRONTS.get(family, parse(policy).policy.name if family == PEER else policy)


class Facts(NamedTuple):
    """What only the argument of a policy tells."""

    version: str = ""  # what its behaviour depends on besides code: a digest of its weights
    needs_truth: str = ""  # of what it needs ground truth, if it does


def _no_facts(argument: str | None) -> Facts:
    return Facts()


def _never(argument: str) -> bool:
    return False


@dataclass(frozen=True)
class RegisteredPolicy:
    """All that is known of the policies ``NAME`` and ``NAME:ARGUMENT``.

    A name that ends in @ is that of ``NAME@ARGUMENT``.

    Attributes:
        name: before the colon.
        build: makes one from its argument, None without a colon, and a context. A function of a
            module, so that other processes find it.
        family: of `FAMILIES`.
        label: for a reader; "": the name.
        label_of: label by argument; None: the label, the argument in brackets behind it.
        colour: of its mark in figures; None: of the technique that its argument names, or grey.
        marker: Matplotlib's.
        line: Matplotlib's style of its precision-recall curve.
        charted: whether figures of AUC against compute show it.
        needs_truth: of what it needs ground truth, if it does.
        draws: whether it draws at random.
        constant: whether the runs are known before the route.
        may_idle: whether an argument that ends in `IDLE` lets nothing run on a frame.
        has_variants: whether an argument makes a variant of it, which is drawn hollow.
        reads_weight: whether, by argument, it weighs compute with its environment's λ.
        facts: what its argument tells; refuses a wrong one.
    """

    name: str
    build: Callable[[str | None, Context], Policy]
    family: str
    label: str = ""
    label_of: Callable[[str], str] | None = None
    colour: str | None = "#6F4E37"
    marker: str = "P"
    line: str = "-"
    charted: bool = True
    needs_truth: str = ""
    draws: bool = False
    constant: bool = False
    may_idle: bool = False
    has_variants: bool = False
    reads_weight: Callable[[str], bool] = _never
    facts: Callable[[str | None], Facts] = _no_facts

    def __post_init__(self) -> None:
        """Refuse an unknown family."""
        if self.family not in FAMILIES:
            raise ValueError(suggest("family", self.family, FAMILIES))


class Spec(NamedTuple):
    """A ``NAME`` or ``NAME:ARGUMENT``, taken apart."""

    policy: RegisteredPolicy
    argument: str | None  # None without a colon

    @property
    def label(self) -> str:
        """For a reader: "single:HOG" -> "HOG", "amusic" -> "A-MuSIC"."""
        policy, argument = self
        label = policy.label or policy.name
        if policy.needs_truth:
            label += f" {MARK}"
        if not argument:
            return label
        return policy.label_of(argument) if policy.label_of else f"{label} ({argument})"

    @property
    def idles(self) -> bool:
        """Whether nothing may run on a frame: "random:0.5/idle", "voi:idle"."""
        return self.policy.may_idle and (self.argument or "").split("/")[-1] == IDLE

    @property
    def is_variant(self) -> bool:
        """Whether it is drawn hollow: "amusic:evidence", "random:0.5/idle"."""
        return self.idles or (self.policy.has_variants and bool(self.argument))


@cache
def policies() -> dict[str, RegisteredPolicy]:
    """Name → policy, of all providers."""
    found = dict[str, RegisteredPolicy]()
    for provider in PROVIDERS:
        found |= import_module(provider).POLICIES
    for each in entry_points(group=ENTRY_POINTS):
        found |= each.load()
    return found


def register(policy: RegisteredPolicy) -> RegisteredPolicy:
    """Add a policy for this process.

    Raises:
        ValueError: if its name is taken.
    """
    if policy.name in policies():
        raise ValueError(f"there is a policy {policy.name!r}; give yours another name")
    policies()[policy.name] = policy
    return policy


def parse(spec: str) -> Spec:
    """A spec's policy and argument; of an unknown name a stand-in that can be shown but not built.

    Traces and rows may be of policies that were never registered.
    """
    kind, at, rest = spec.partition("@")
    if at and kind + at in policies():
        return Spec(policies()[kind + at], rest)
    name, colon, argument = spec.partition(":")
    policy = policies().get(name) or RegisteredPolicy(name, partial(_refuse, name), PEER)
    return Spec(policy, argument if colon else None)


def _refuse(name: str, argument: str | None, context: Context) -> NoReturn:
    raise ValueError(suggest("policy", name, policies()))


def make_policy(spec: str, context: Context) -> Policy:
    """Build the policy of a ``NAME`` or ``NAME:ARGUMENT``.

    Raises:
        ValueError: for an unknown name or a wrong argument, with the valid ones.
    """
    policy, argument = parse(spec)
    return policy.build(argument, context)
