"""DQN of Stable-Baselines3: one number per subset of the techniques.

    pip install -r examples/sb3_dqn/requirements.txt
    python examples/sb3_dqn/sb3_dqn.py

Reaches 0.796 per frame at λ 0.3 (seed 1) in 20 s of one core. Compare with docs/training.md.
"""

from __future__ import annotations

import argparse

import gymnasium as gym
from amusic_agents.adapter import SB3VecEnv
from amusic_agents.evaluation import mean_reward
from stable_baselines3 import DQN

from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.envs.wrappers import VectorDiscreteSubsets


def main() -> None:
    """Train, and say what is reached on routes that no training draws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timesteps", type=int, default=150_000)
    parser.add_argument("--compute-weight", type=float, default=0.3)
    parser.add_argument("--routes", type=int, default=64, help="simulated, of training and of test")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    env = gym.make_vec(
        "amusic_gym:amusic_gym/TechniqueSelection-v0",
        num_envs=32,
        bank=SimulatedRoutes(pool=args.routes, seed=args.seed),
        compute_weight=args.compute_weight,
        autoreset_mode="SameStep",
    )
    model = DQN(
        "MlpPolicy",
        SB3VecEnv(VectorDiscreteSubsets(env)),
        learning_rate=1e-3,
        gamma=0.95,
        learning_starts=min(5_000, args.timesteps // 2),
        buffer_size=100_000,
        train_freq=2,
        gradient_steps=2,
        batch_size=128,
        target_update_interval=2_000,
        exploration_fraction=0.3,
        seed=args.seed,
        device="cpu",
    )
    model.learn(args.timesteps, progress_bar=True)
    reached = mean_reward(
        lambda observation, info: model.predict(observation, deterministic=True)[0],
        compute_weight=args.compute_weight,
        routes=args.routes,
        wrap=VectorDiscreteSubsets,
    )
    print(f"mean reward per frame {reached:.3f}")


if __name__ == "__main__":
    main()
