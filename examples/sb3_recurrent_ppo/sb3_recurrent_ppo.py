"""RecurrentPPO of sb3-contrib: an LSTM that remembers the route; two values per technique.

RecurrentPPO of sb3-contrib 2.9.2 fails on `MultiBinary` actions; on `MultiDiscrete` it learns.

    pip install -r examples/sb3_recurrent_ppo/requirements.txt
    python examples/sb3_recurrent_ppo/sb3_recurrent_ppo.py

Reaches 0.682 per frame at λ 0.3 (seed 1) in 18 s of one core. Compare with docs/training.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from amusic_agents.adapter import SB3VecEnv
from amusic_agents.evaluation import mean_reward
from sb3_contrib import RecurrentPPO

from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.envs.wrappers import VectorMultiDiscreteBits


class Driver:
    """The model's actions with the memory of every route."""

    def __init__(self, model: RecurrentPPO) -> None:
        self.model = model
        self.memory: Any = None

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> np.ndarray:
        """Actions (N, T)."""
        begun = info["frame"] < 0  # nothing has run on a route yet
        actions, self.memory = self.model.predict(
            observation, state=self.memory, episode_start=begun, deterministic=True
        )
        return actions


def main() -> None:
    """Train, and say what is reached on routes that no training draws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timesteps", type=int, default=60_000)
    parser.add_argument("--compute-weight", type=float, default=0.3)
    parser.add_argument("--routes", type=int, default=64, help="simulated, of training and of test")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    env = gym.make_vec(
        "amusic_gym:amusic_gym/TechniqueSelection-v0",
        num_envs=64,
        bank=SimulatedRoutes(pool=args.routes, seed=args.seed),
        compute_weight=args.compute_weight,
        autoreset_mode="SameStep",
    )
    model = RecurrentPPO(
        "MlpLstmPolicy",
        SB3VecEnv(VectorMultiDiscreteBits(env)),
        policy_kwargs={"lstm_hidden_size": 32, "net_arch": [64]},
        n_steps=32,
        batch_size=512,
        n_epochs=2,
        learning_rate=2e-3,
        gamma=0.95,
        gae_lambda=0.9,
        seed=args.seed,
        device="cpu",
    )
    model.learn(args.timesteps, progress_bar=True)
    reached = mean_reward(
        Driver(model),
        compute_weight=args.compute_weight,
        routes=args.routes,
        wrap=VectorMultiDiscreteBits,
    )
    print(f"mean reward per frame {reached:.3f}")


if __name__ == "__main__":
    main()
