"""Training by Stable-Baselines3's PPO: a bit per technique, or when to select again."""

import json
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, ProgressBarCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from amusic_agents.adapter import SB3VecEnv
from amusic_agents.config import TrainingConfig
from amusic_agents.learning import make_env
from amusic_agents.network import NetworkSelector, SelectorNetwork
from amusic_agents.records import Records
from amusic_agents.reselect import HeldSelection, ReselectNetwork, ReselectSelector, ReselectSizes
from amusic_agents.run_folder import CHECKPOINT, Tensors, check_layers, part, read_list
from amusic_agents.selector import TrainedSelector, load_selector
from amusic_gym.envs.sources import RouteSource
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.settings import BLOCK


class NetworkPolicy(ActorCriticPolicy):
    """Actor-critic policy around a network that gives the logits itself.

    ``make_network`` makes it; it gives logits and the critic's features, ``latent_dim_vf`` long.
    """

    def __init__(
        self, *arguments: Any, make_network: Callable[[], nn.Module], **keywords: Any
    ) -> None:
        self.make_network = make_network
        super().__init__(*arguments, **keywords)

    def _build(self, lr_schedule: Any) -> None:
        network: Any = self.make_network()
        self.mlp_extractor = network
        self.action_net = nn.Identity()
        self.value_net = nn.Linear(network.latent_dim_vf, 1)
        self.value_net.apply(partial(self.init_weights, gain=1.0))
        optimiser: Any = self.optimizer_class
        self.optimizer = optimiser(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class PPOLearner(BaseCallback):
    """PPO with a bit per technique; evaluates, writes checkpoints, logs the reward's terms.

    With ``start``, the run folder of an imitation, PPO begins from its weights; they are evaluated
    first, and so stay the best until others are better. ``callbacks`` are called after this one.
    """

    kind: type[NetworkSelector] = TrainedSelector

    def __init__(
        self,
        config: TrainingConfig,
        source: RouteSource,
        records: Records,
        start: Path | None = None,
        callbacks: Sequence[BaseCallback] = (),
    ) -> None:
        super().__init__()
        self.config = config
        self.records = records
        self.callbacks = callbacks
        self.init_callback(self.make_model(config, source))
        if start is not None:
            self.network.load_state_dict(load_selector(start).network.state_dict())
        self._next = config.evaluate_every

    @staticmethod
    def make_network(config: TrainingConfig) -> nn.Module:
        """The network, untrained."""
        return SelectorNetwork(config.network)

    @staticmethod
    def make_env(config: TrainingConfig, source: RouteSource) -> TechniqueSelectionVectorEnv:
        """The environment to learn in."""
        return make_env(config, source)

    @classmethod
    def make_model(cls, config: TrainingConfig, source: RouteSource) -> PPO:
        """PPO on the native vector environment, on one thread, seeded."""
        return PPO(
            NetworkPolicy,
            SB3VecEnv(cls.make_env(config, source)),
            policy_kwargs={"make_network": partial(cls.make_network, config)},
            n_steps=config.n_steps,
            batch_size=config.batch,
            n_epochs=config.epochs,
            learning_rate=lambda left: config.learning_rate * left,
            gamma=config.reward_discount,
            gae_lambda=config.gae_lambda,
            ent_coef=config.entropy,
            seed=config.seed,
            device="cpu",
        )

    @property
    def network(self) -> nn.Module:
        """The network that is being trained."""
        return self.model.policy.mlp_extractor  # type: ignore[return-value]

    def run(self, progress: bool) -> None:
        """Train to the last evaluation; a KeyboardInterrupt comes after a checkpoint."""
        done, wanted = self.model.num_timesteps, self.config.timesteps
        if wanted <= done and self._is_evaluated():
            return
        if done == 0:
            self.checkpoint()
        self.model.set_logger(_logger(self.records.out, done))
        try:
            if done == 0 and self.config.algorithm == "imitation+ppo":
                self.evaluate()
            if done < wanted:
                self._learn(wanted - done, progress)
            if not self._is_evaluated():
                self.evaluate()
                self.logger.dump(self.model.num_timesteps)
        except KeyboardInterrupt:
            self.checkpoint()
            if not self.records.evaluations:
                self.records.write_selector(self.network)
            raise
        finally:
            self.model.logger.close()

    def _learn(self, timesteps: int, progress: bool) -> None:
        bars = [ProgressBarCallback()] if progress else []
        try:
            self.model.learn(
                timesteps, callback=[self, *self.callbacks, *bars], reset_num_timesteps=False
            )
        finally:
            for bar in bars:  # an interrupted one would go on moving, and hide the cursor
                if hasattr(bar, "pbar"):
                    bar.pbar.close()

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps >= self._next:
            self.evaluate()
        # At first the critic may learn alone: a new one is wrong about everything, and a few
        # updates by its advantages would undo an imitation.
        frozen = self.model.num_timesteps < self.config.frozen_updates * self.config.rollout
        for name, parameter in self.network.named_parameters():
            parameter.requires_grad_(not frozen or name.startswith("critic."))

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self._log(info for info in self.locals["infos"] if "episode" in info)
        return True

    def _log(self, ended: Iterable[dict[str, Any]]) -> None:
        """Record means per frame of the reward's terms, and the return, of ended episodes."""
        for info in ended:
            self.logger.record_mean("route/return", info["episode"]["r"])
            for name, value in info["episode"]["reward_terms"].items():
                self.logger.record_mean(f"route/{name}", value)

    def _is_evaluated(self) -> bool:
        done = self.records.evaluations
        return bool(done) and done[-1].timesteps >= self.model.num_timesteps

    def evaluate(self) -> None:
        """Evaluate, keep the selector if it is the best, write a checkpoint."""
        steps = self.model.num_timesteps
        result = self.records.evaluate(self.network, steps)
        for name, value in result._asdict().items():
            self.logger.record(f"held_out/{name}", value)
        self._next = steps + self.config.evaluate_every
        self.checkpoint()

    def checkpoint(self) -> None:
        """Write everything that resuming needs."""
        model = self.model
        tensors = {f"policy.{k}": v for k, v in model.policy.state_dict().items()}
        optimiser = model.policy.optimizer.state_dict()["state"]
        for index, values in optimiser.items():
            tensors |= {f"optimiser.{index}.{k}": torch.as_tensor(v) for k, v in values.items()}
        tensors["random.torch"] = torch.get_rng_state()
        name, keys, *rest = np.random.get_state(legacy=True)
        metadata = {
            "timesteps": str(model.num_timesteps),
            "updates": str(model._n_updates),
            "numpy": json.dumps([name, np.asarray(keys).tolist(), *rest]),
        }
        self.records.save(tensors, metadata)

    def restore(self) -> None:
        """Take the model back to the last checkpoint; its routes begin anew.

        Raises:
            ValueError: if the checkpoint is damaged or another training's, or has more frames than
                are asked for.
        """
        model, path = self.model, self.records.out / CHECKPOINT
        with self.records.restoring(self.network) as (tensors, metadata):
            policy = part(tensors, "policy.")
            check_layers(path, policy, model.policy.state_dict())
            model.policy.load_state_dict(policy)
            self._restore_optimiser(part(tensors, "optimiser."))
            model.num_timesteps = int(metadata["timesteps"])
            model._n_updates = int(metadata["updates"])
            self._next = model.num_timesteps + self.config.evaluate_every
            assert model.env is not None
            # Other routes than those already driven, but the same after every resume from here.
            model.env.seed(self.config.seed + model.num_timesteps)
            torch.set_rng_state(tensors["random.torch"])
            name, keys, *rest = read_list(path, metadata, "numpy")
            np.random.set_state((name, np.array(keys, np.uint32), *rest))
        done, wanted = model.num_timesteps, self.config.timesteps
        if wanted + self.config.rollout <= done:  # more than the overshoot
            raise ValueError(
                f"{self.records.out} has {done} frames of training already; give more timesteps"
                f" than {wanted} to go on"
            )

    def _restore_optimiser(self, tensors: Tensors) -> None:
        optimiser = self.model.policy.optimizer
        parameters = optimiser.param_groups[0]["params"]
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, tensor in tensors.items():
            index, _, key = name.partition(".")
            if tensor.ndim and tensor.shape != parameters[int(index)].shape:
                raise ValueError(f"shape {tuple(tensor.shape)} of the optimiser's {name!r}")
            state.setdefault(int(index), {})[key] = tensor
        optimiser.load_state_dict({**optimiser.state_dict(), "state": state})


def _logger(out: Path, timesteps: int) -> Logger:
    """Curves as CSV and for TensorBoard; those before a resume stay as they are."""
    suffix = f"-{timesteps}" if timesteps else ""
    kinds = ("csv", "tensorboard")
    return Logger(str(out), [make_output_format(kind, str(out), suffix) for kind in kinds])


class ReselectLearner(PPOLearner):
    """PPO with one decision: whether to select again."""

    kind = ReselectSelector

    @staticmethod
    def make_network(config: TrainingConfig) -> nn.Module:
        """The network, untrained."""
        return ReselectNetwork(ReselectSizes())

    @staticmethod
    def make_env(config: TrainingConfig, source: RouteSource) -> TechniqueSelectionVectorEnv:
        """The environment with its re-select bit, as one decision."""
        return make_env(config, source, ReselectVectorEnv, reselection=BLOCK)


class ReselectVectorEnv(TechniqueSelectionVectorEnv):
    """The environment to learn in, with one bit, `Discrete(2)`: whether to select again."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._held = HeldSelection(self.task.block)
        self.single_action_space: spaces.Space = spaces.Discrete(2)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, **arguments: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode on every route."""
        observation, info = super().reset(**arguments)
        self._held.note(info)
        return observation, info

    def step(self, actions: ArrayLike) -> tuple[Any, ...]:
        """Step every route with its decision (N,)."""
        result = super().step(self._held.actions(np.asarray(actions) == 1))
        self._held.note(result[4])
        return result
