"""DQN of Tianshou: one number per subset of the techniques, on single environments.

    pip install -r examples/tianshou_dqn/requirements.txt
    python examples/tianshou_dqn/tianshou_dqn.py

Reaches 0.700 per frame at λ 0.3 (seed 1) in 28 s of one core. Compare with docs/training.md.
"""

from __future__ import annotations

import argparse
from functools import partial

import gymnasium as gym
import numpy as np
import torch
from amusic_agents.evaluation import mean_reward
from tianshou.algorithm import DQN
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.envs.wrappers import DiscreteSubsets, VectorDiscreteSubsets

ENVS = 16


def make(bank: SimulatedRoutes, compute_weight: float) -> DiscreteSubsets:
    """One environment."""
    name = "amusic_gym:amusic_gym/TechniqueSelection-v0"
    return DiscreteSubsets(gym.make(name, bank=bank, compute_weight=compute_weight))


def main() -> None:
    """Train, and say what is reached on routes that no training draws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timesteps", type=int, default=10_000)
    parser.add_argument("--compute-weight", type=float, default=0.3)
    parser.add_argument("--routes", type=int, default=64, help="simulated, of training and of test")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    routes = SimulatedRoutes(pool=args.routes, seed=args.seed)
    envs = DummyVectorEnv([partial(make, routes, args.compute_weight)] * ENVS)
    envs.seed(args.seed)
    single = make(routes, args.compute_weight)
    net = Net(
        state_shape=single.observation_space.shape,
        action_shape=single.action_space.n,
        hidden_sizes=[64, 64],
    )
    policy = DiscreteQLearningPolicy(
        model=net,
        action_space=single.action_space,
        observation_space=single.observation_space,
        eps_training=0.15,
    )
    algorithm = DQN(
        policy=policy,
        optim=AdamOptimizerFactory(lr=1e-3),
        gamma=0.95,
        n_step_return_horizon=3,
        target_update_freq=500,
    )
    collector = Collector(algorithm, envs, VectorReplayBuffer(20_000, ENVS))
    collector.reset()
    algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=collector,
            max_epochs=1,
            epoch_num_steps=args.timesteps,
            collection_step_num_env_steps=ENVS * 4,
            update_step_num_gradient_steps_per_sample=0.3,
            batch_size=128,
            verbose=False,
        )
    )

    def act(observation: np.ndarray, info: object) -> np.ndarray:
        with torch.no_grad():
            return net(observation)[0].argmax(1).numpy()

    reached = mean_reward(
        act,
        compute_weight=args.compute_weight,
        routes=args.routes,
        wrap=VectorDiscreteSubsets,
    )
    print(f"mean reward per frame {reached:.3f}")


if __name__ == "__main__":
    main()
