"""PPO of TorchRL: subsets of the techniques, on the native vector environment.

`GymEnv` finds the single environment by its id, and TorchRL's checker accepts it.

    pip install -r examples/torchrl_ppo/requirements.txt
    python examples/torchrl_ppo/torchrl_ppo.py

Reaches 0.733 per frame at λ 0.3 (seed 1) in 24 s of one core. Compare with docs/training.md.
"""

from __future__ import annotations

import argparse

import gymnasium as gym
import numpy as np
import torch
from amusic_agents.evaluation import mean_reward
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.envs import GymEnv, GymWrapper, check_env_specs
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from tqdm import trange

from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.envs.wrappers import VectorDiscreteSubsets

ENV = "amusic_gym:amusic_gym/TechniqueSelection-v0"
ENVS, STEPS, EPOCHS, BATCH, RATE = 64, 64, 4, 1024, 1e-3


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Two hidden layers."""
    hidden = (nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh())
    made = nn.Sequential(*hidden, nn.Linear(64, outputs))
    nn.init.orthogonal_(made[-1].weight, 0.01)
    return made


def main() -> None:
    """Train, and say what is reached on routes that no training draws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timesteps", type=int, default=250_000)
    parser.add_argument("--compute-weight", type=float, default=0.3)
    parser.add_argument("--routes", type=int, default=64, help="simulated, of training and of test")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    check_env_specs(GymEnv(ENV, compute_weight=args.compute_weight))
    bits = gym.make_vec(
        ENV,
        ENVS,
        bank=SimulatedRoutes(pool=args.routes, seed=args.seed),
        compute_weight=args.compute_weight,
        autoreset_mode="Disabled",  # TorchRL resets routes that have ended itself
    )
    made = VectorDiscreteSubsets(bits)
    env = GymWrapper(made, categorical_action_encoding=True)
    env.set_seed(args.seed)
    inputs = made.single_observation_space.shape[0]
    logits = network(inputs, made.single_action_space.n)
    actor = ProbabilisticActor(
        TensorDictModule(logits, ["observation"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )
    critic = ValueOperator(network(inputs, 1), in_keys=["observation"])
    loss_of = ClipPPOLoss(actor, critic, entropy_coeff=0.005, normalize_advantage=True)
    gains = GAE(gamma=0.95, lmbda=0.9, value_network=critic)
    optimiser = torch.optim.Adam(loss_of.parameters(), lr=RATE)
    state = env.reset()
    updates = max(1, args.timesteps // (ENVS * STEPS))
    for number in trange(updates, unit="update"):
        optimiser.param_groups[0]["lr"] = RATE * (1 - number / updates)
        with torch.no_grad():
            steps = env.rollout(
                STEPS, actor, auto_reset=False, tensordict=state, break_when_any_done=False
            )
            state = env.maybe_reset(steps[:, -1]["next"].exclude("reward"))
            gains(steps)
        flat = steps.reshape(-1)
        for _ in range(EPOCHS):
            for indices in torch.randperm(len(flat)).split(BATCH):
                losses = loss_of(flat[indices])
                loss = sum(losses[f"loss_{part}"] for part in ("objective", "critic", "entropy"))
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(loss_of.parameters(), 0.5)
                optimiser.step()

    def act(observation: np.ndarray, info: object) -> np.ndarray:
        with torch.no_grad():
            return logits(torch.from_numpy(observation)).argmax(1).numpy()

    reached = mean_reward(
        act,
        compute_weight=args.compute_weight,
        routes=args.routes,
        wrap=VectorDiscreteSubsets,
    )
    print(f"mean reward per frame {reached:.3f}")


if __name__ == "__main__":
    main()
