"""Registers the environment with Gymnasium, once."""

from __future__ import annotations

import gymnasium as gym

ENV_ID = "amusic_gym/TechniqueSelection-v0"


def register() -> None:
    """Make the environment known to ``gymnasium.make`` and ``gymnasium.make_vec``."""
    if ENV_ID not in gym.registry:
        gym.register(
            id=ENV_ID,
            entry_point="amusic_gym.env:TechniqueSelectionEnv",
            vector_entry_point="amusic_gym.vector_env:TechniqueSelectionVectorEnv",
        )
