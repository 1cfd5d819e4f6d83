"""Registers the environment with Gymnasium, once."""

from __future__ import annotations

import copy
import enum
import os
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from amusic_gym.banks.bank import ScoreBank

ENV_ID = "amusic_gym/TechniqueSelection-v0"


def register() -> None:
    """Make the environment known to ``gymnasium.make`` and ``gymnasium.make_vec``."""
    if ENV_ID not in gym.registry:
        gym.register(
            id=ENV_ID,
            entry_point="amusic_gym.envs.env:TechniqueSelectionEnv",
            vector_entry_point="amusic_gym.envs.vector_env:TechniqueSelectionVectorEnv",
        )


class Specified:
    """An environment whose ``spec`` is JSON (``spec.to_json()``) where its arguments can be.

    Folders are in it as text, and so are banks that were loaded from one, and what Gymnasium knows
    by a name. A bank in memory, a live route or a reward of one's own is there as it was given, and
    Gymnasium refuses to write it.
    """

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """How the environment was made."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = copy.copy(spec)
        if self._spec is not None:
            self._spec.kwargs = {name: _plain(value) for name, value in self._spec.kwargs.items()}


def _plain(value: Any) -> Any:
    """An argument as text, a number or a list of these, if that makes the same environment."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, ScoreBank):
        return value if value.folder is None else str(value.folder)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value.value if isinstance(value, enum.Enum) else value
