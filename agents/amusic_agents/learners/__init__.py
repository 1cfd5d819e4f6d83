"""The algorithms that train a selector, and the kinds of selector that come out.

Adding an algorithm: a file with its ``LEARNER``, one line in ``ALGORITHMS``; where its network is
of a new kind, a ``KIND`` and one line in ``KINDS``. `amusic_agents.network.VERSION` is that of all
kinds: raise it whenever stored weights of any would mean something else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stable_baselines3.common.base_class import BaseAlgorithm
    from torch import nn

    from amusic_agents.config import TrainingConfig
    from amusic_gym.envs.sources import RouteSource
    from amusic_gym.policies.protocol import Selector

ALGORITHMS = {
    "ppo": "amusic_agents.learners.ppo",
    "imitation": "amusic_agents.imitation",
    "imitation+ppo": "amusic_agents.learners.ppo",  # after amusic_agents.imitation
    "rollouts": "amusic_agents.policy_iteration",
    "reselect": "amusic_agents.learners.reselect",
}
"""Name on the command line → module with its ``LEARNER``, imported when used."""

KINDS = {
    "selector": "amusic_agents.selector",
    "subsets": "amusic_agents.subsets",
    "reselect": "amusic_agents.learners.reselect",
}
"""Name in the weights' file → module with its ``KIND``; without a name it is the first."""


@dataclass(frozen=True)
class Kind:
    """A network that a run folder may hold, and the policy around it.

    Attributes:
        name: as in ``KINDS``.
        sizes: dataclass of the network's sizes; refuses those that no network has.
        network: makes a network of such sizes.
        selector: makes the policy from network, statistic and arguments of the environment.
    """

    name: str
    sizes: Callable[..., Any]
    network: Callable[[Any], nn.Module]
    selector: Callable[[Any, str, Mapping[str, Any] | None], Selector]


@dataclass(frozen=True)
class Learner:
    """An algorithm of Stable-Baselines3.

    Attributes:
        kind: name of the kind of network that it trains.
        make_model: the algorithm on simulated or given routes, seeded, on one thread.
        network: the trained network of a model: what the run folder keeps.
        sizes: the network's sizes, from the configuration.
    """

    kind: str
    make_model: Callable[[TrainingConfig, RouteSource], BaseAlgorithm]
    network: Callable[[BaseAlgorithm], nn.Module]
    sizes: Callable[[TrainingConfig], Any]


def learner(algorithm: str) -> Learner:
    """The learner of an algorithm.

    Raises:
        ValueError: for an unknown one, or one that does not learn step by step from rewards.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(suggest("algorithm", algorithm, ALGORITHMS))
    found: Learner | None = getattr(import_module(ALGORITHMS[algorithm]), "LEARNER", None)
    if found is None:
        raise ValueError(
            f"algorithm {algorithm!r} does not learn step by step from rewards; call"
            " amusic_agents.imitation.imitate or amusic_agents.policy_iteration.iterate_policy"
        )
    return found


def kind(name: str) -> Kind:
    """The kind of network of this name.

    Raises:
        ValueError: for an unknown one.
    """
    if name not in KINDS:
        raise ValueError(suggest("kind of selector", name, KINDS))
    found: Kind = import_module(KINDS[name]).KIND
    return found
