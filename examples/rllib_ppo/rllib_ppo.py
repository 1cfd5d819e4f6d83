"""PPO of RLlib (Ray's new API stack): subsets of the techniques, on single environments.

    pip install -r examples/rllib_ppo/requirements.txt
    python examples/rllib_ppo/rllib_ppo.py

Reaches 0.689 per frame at λ 0.3 (seed 1) in 27 s of one core. Compare with docs/training.md.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import ray
import torch
from amusic_agents.evaluation import mean_reward
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.tune.registry import register_env
from tqdm import trange

from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.envs.wrappers import DiscreteSubsets, VectorDiscreteSubsets

ENVS, BATCH = 32, 2048


def make(bank: SimulatedRoutes, compute_weight: float, config: Any) -> DiscreteSubsets:
    """One environment."""
    name = "amusic_gym:amusic_gym/TechniqueSelection-v0"
    return DiscreteSubsets(gym.make(name, bank=bank, compute_weight=compute_weight))


def main() -> None:
    """Train, and say what is reached on routes that no training draws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timesteps", type=int, default=40_000)
    parser.add_argument("--compute-weight", type=float, default=0.3)
    parser.add_argument("--routes", type=int, default=64, help="simulated, of training and of test")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    routes = SimulatedRoutes(pool=args.routes, seed=args.seed)
    register_env("techniques", partial(make, routes, args.compute_weight))
    config = (
        PPOConfig()
        .environment("techniques")
        .env_runners(num_env_runners=0, num_envs_per_env_runner=ENVS)
        .training(
            lr=5e-4,
            gamma=0.95,
            lambda_=0.9,
            clip_param=0.2,
            use_kl_loss=False,
            vf_loss_coeff=0.5,
            entropy_coeff=0.005,
            grad_clip=0.5,
            train_batch_size=BATCH,
            minibatch_size=256,
            num_epochs=4,
        )
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64]))
        .debugging(seed=args.seed, log_level="ERROR")
    )
    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False)
    algorithm = config.build_algo()
    for _ in trange(max(1, args.timesteps // BATCH), unit="update"):
        algorithm.train()
    module = algorithm.get_module()

    def act(observation: np.ndarray, info: object) -> np.ndarray:
        with torch.no_grad():
            given = {Columns.OBS: torch.from_numpy(observation)}
            return module.forward_inference(given)[Columns.ACTION_DIST_INPUTS].argmax(1).numpy()

    reached = mean_reward(
        act,
        compute_weight=args.compute_weight,
        routes=args.routes,
        wrap=VectorDiscreteSubsets,
    )
    algorithm.stop()
    ray.shutdown()
    print(f"mean reward per frame {reached:.3f}")


if __name__ == "__main__":
    main()
