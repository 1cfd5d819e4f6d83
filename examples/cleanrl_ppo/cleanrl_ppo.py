"""PPO in one file, in the manner of CleanRL, on the native vector environment.

    pip install -r examples/cleanrl_ppo/requirements.txt
    python examples/cleanrl_ppo/cleanrl_ppo.py

Reaches 0.707 per frame at λ 0.3 (seed 1) in 28 s of one core. Compare with docs/training.md.
"""

from __future__ import annotations

import argparse

import gymnasium as gym
import numpy as np
import torch
from amusic_agents.evaluation import mean_reward
from torch import nn
from torch.distributions import Bernoulli
from tqdm import trange

from amusic_gym.envs.observation import ROUTE_FEATURES, TECHNIQUE_FEATURES
from amusic_gym.envs.sources import SimulatedRoutes

ENVS, STEPS, EPOCHS, MINIBATCHES = 64, 64, 4, 4
RATE, GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, NORM = 1e-3, 0.95, 0.9, 0.2, 0.005, 0.5, 0.5


class Agent(nn.Module):
    """Actor and critic; each technique is seen by the same layers, so that its place is no matter.

    Args:
        techniques: how many.
        size: of a technique's features and of the route's, of which the observation consists.
    """

    def __init__(self, techniques: int, size: tuple[int, int]) -> None:
        super().__init__()
        self.parts = [techniques * size[0], size[1]]
        self.encoder = layers(sum(size), 64)
        self.actor = layers(2 * 64, 1)
        self.critic = layers(64, 1)
        nn.init.constant_(self.actor[-1].bias, 1.0)  # begin with most techniques running

    def forward(self, observation: torch.Tensor) -> tuple[Bernoulli, torch.Tensor]:
        """A probability of running for every technique, and the value."""
        techniques, route = observation.split(self.parts, 1)
        own = techniques.unflatten(1, (-1, len(TECHNIQUE_FEATURES)))  # (B, T, F)
        around = route.unsqueeze(1).expand(-1, own.shape[1], -1)
        codes = self.encoder(torch.cat([own, around], 2)).relu()
        mean = codes.mean(1)
        both = torch.cat([codes, mean.unsqueeze(1).expand_as(codes)], 2)
        return Bernoulli(logits=self.actor(both).squeeze(2)), self.critic(mean).squeeze(1)


def layers(inputs: int, outputs: int) -> nn.Sequential:
    """A hidden layer, and outputs that begin small."""
    made = nn.Sequential(nn.Linear(inputs, 64), nn.ReLU(), nn.Linear(64, outputs))
    nn.init.orthogonal_(made[-1].weight, 0.01 if outputs == 1 else 1.0)
    return made


def advantages(rewards, values, last, ends) -> torch.Tensor:
    """Generalised advantage estimates (STEPS, ENVS); ``ends`` says after which steps nothing is."""
    result, running = torch.zeros_like(rewards), torch.zeros(ENVS)
    for t in reversed(range(STEPS)):
        following = last if t == STEPS - 1 else values[t + 1]
        delta = rewards[t] + GAMMA * following * ~ends[t] - values[t]
        running = delta + GAMMA * LAMBDA * running * ~ends[t]
        result[t] = running
    return result


def update(agent, optimiser, batch) -> None:
    """Clipped policy and value losses over shuffled minibatches."""
    size = len(batch["observations"])
    for _ in range(EPOCHS):
        for indices in torch.randperm(size).chunk(MINIBATCHES):
            part = {name: values[indices] for name, values in batch.items()}
            policy, value = agent(part["observations"])
            ratio = (policy.log_prob(part["actions"]).sum(-1) - part["logprobs"]).exp()
            gain = part["advantages"]
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
            value_loss = (value - part["returns"]).square().mean()
            loss = -torch.min(gain * ratio, gain * clipped).mean()
            loss = loss - ENTROPY * policy.entropy().sum(-1).mean() + VALUE * value_loss
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), NORM)
            optimiser.step()


def main() -> None:
    """Train, and say what is reached on routes that no training draws."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--timesteps", type=int, default=400_000)
    parser.add_argument("--compute-weight", type=float, default=0.3)
    parser.add_argument("--routes", type=int, default=64, help="simulated, of training and of test")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    envs = gym.make_vec(
        "amusic_gym:amusic_gym/TechniqueSelection-v0",
        ENVS,
        bank=SimulatedRoutes(pool=args.routes, seed=args.seed),
        compute_weight=args.compute_weight,
        autoreset_mode="SameStep",
    )
    features = len(TECHNIQUE_FEATURES), len(ROUTE_FEATURES)
    agent = Agent(envs.single_action_space.n, features)
    optimiser = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    seen = torch.from_numpy(envs.reset(seed=args.seed)[0])
    updates = max(1, args.timesteps // (ENVS * STEPS))
    for number in trange(updates, unit="update"):
        optimiser.param_groups[0]["lr"] = RATE * (1 - number / updates)
        steps: dict[str, list[torch.Tensor]] = {}
        for _ in range(STEPS):
            with torch.no_grad():
                policy, value = agent(seen)
                action = policy.sample()
            following, reward, terminated, truncated, _ = envs.step(action.numpy())
            step = {
                "observations": seen,
                "actions": action,
                "logprobs": policy.log_prob(action).sum(-1),
                "values": value,
                "rewards": torch.from_numpy(reward).float(),
                "ends": torch.from_numpy(terminated | truncated),
            }
            for name, tensor in step.items():
                steps.setdefault(name, []).append(tensor)
            seen = torch.from_numpy(following)
        data = {name: torch.stack(tensors) for name, tensors in steps.items()}
        with torch.no_grad():
            last = agent(seen)[1]
        gains = advantages(data.pop("rewards"), data["values"], last, data.pop("ends"))
        data |= {"advantages": gains, "returns": gains + data.pop("values")}
        update(agent, optimiser, {name: tensor.flatten(0, 1) for name, tensor in data.items()})

    def act(observation: np.ndarray, info: object) -> np.ndarray:
        with torch.no_grad():
            return agent(torch.from_numpy(observation))[0].mode.numpy()

    reached = mean_reward(act, compute_weight=args.compute_weight, routes=args.routes)
    print(f"mean reward per frame {reached:.3f}")


if __name__ == "__main__":
    main()
