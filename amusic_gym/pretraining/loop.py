"""A training that shows how far it is, can be stopped, and goes on with the same bits."""

import contextlib
import json
import math
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from types import FrameType
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn
from tqdm import tqdm

from amusic_gym.pretraining.job import TrainingJob
from amusic_gym.utils.storage import write_whole

SAVE_EVERY = 100  # steps between checkpoints; Ctrl-C makes one too
DECAY = 1e-4  # weight decay
WARM_UP = 0.1  # share of the steps in which the learning rate rises


def learning_rate(step: int, steps: int, highest: float) -> float:
    """Rises linearly, then falls as half a cosine to 0."""
    warm = max(1, round(WARM_UP * steps))
    if step < warm:
        return highest * (step + 1) / warm
    return highest * (1 + math.cos(math.pi * (step - warm) / max(1, steps - warm))) / 2


@contextlib.contextmanager
def interrupt_later() -> Iterator[threading.Event]:
    """Hold back Ctrl-C, which sets the event that this yields; a second one interrupts at once."""
    pressed = threading.Event()
    usual = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, note)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, usual)


class Training:
    """Adam on a network, from its last checkpoint if the job is resumed.

    All that a step draws comes from a generator of its own, seeded with the training's seed and
    the step's number, so a training that was stopped and resumed gives the same bits.

    All that the result depends on, ``seed`` among it, stands in ``settings``, which are stored, and
    compared when resuming. ``rate`` is the highest learning rate; ``needed`` says whether resuming
    needs a checkpoint of this stage.

    Raises:
        FileNotFoundError: if there is no checkpoint to resume from.
        ValueError: for a damaged checkpoint, or one of other settings.
    """

    def __init__(
        self, network: nn.Module, job: TrainingJob, stage: str, settings: Mapping[str, Any], *,
        steps: int, rate: float, needed: bool = True,
    ) -> None:  # fmt: skip
        self.network = network
        self.job = job
        self.checkpoint = job.checkpoint(stage)
        self.settings: dict[str, Any] = json.loads(json.dumps(dict(settings)))
        self.steps = steps
        self.rate = rate
        self.optimiser = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=DECAY)
        self.losses: list[float] = []  # one per step
        if job.resume and (needed or self.checkpoint.exists()):
            self._restore()

    def run(self, loss_of: Callable[[np.random.Generator], Tensor]) -> list[float]:
        """Train to the end; each step's loss. A KeyboardInterrupt comes after a checkpoint."""
        self.network.train()
        done = len(self.losses)
        hidden = not self.job.progress
        bar = tqdm(total=self.steps, initial=done, desc="training", disable=hidden)
        with bar, interrupt_later() as interrupted:
            for step in range(done, self.steps):
                loss = self._step(loss_of, step)
                bar.set_postfix(loss=f"{loss:.4f}", refresh=False)
                bar.update()
                stop = interrupted.is_set()
                if stop or step + 1 == self.steps or (step + 1) % SAVE_EVERY == 0:
                    self._save()
                if stop:
                    raise KeyboardInterrupt
        return self.losses

    def _step(self, loss_of: Callable[[np.random.Generator], Tensor], step: int) -> float:
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(step, self.steps, self.rate)
        loss = loss_of(np.random.default_rng([self.settings["seed"], step]))
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        self.losses.append(float(loss.detach()))
        return self.losses[-1]

    def _save(self) -> None:
        """Write the checkpoint, whole or not at all; no pickle in it."""
        tensors = {f"network.{name}": t for name, t in self.network.state_dict().items()}
        for index, state in self.optimiser.state_dict()["state"].items():
            tensors.update({f"adam.{index}.{name}": value for name, value in state.items()})
        kept = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}
        about = {"settings": json.dumps(self.settings), "losses": json.dumps(self.losses)}
        write_whole(self.checkpoint, save(kept, about))

    def _restore(self) -> None:
        if not self.checkpoint.is_file():
            raise FileNotFoundError(
                f"{self.checkpoint} is not there: nothing to resume; leave out --resume"
            )
        try:
            with safe_open(self.checkpoint, framework="pt") as file:
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
                about = file.metadata() or {}
            settings, self.losses = json.loads(about["settings"]), json.loads(about["losses"])
        except (SafetensorError, KeyError, ValueError) as error:
            raise ValueError(
                f"{self.checkpoint} is damaged ({error}); delete it and train again"
            ) from error
        for name in sorted(settings.keys() | self.settings.keys()):
            if settings.get(name) != self.settings.get(name):
                raise ValueError(
                    f"{name} is {self.settings.get(name)!r}, but {self.checkpoint} was made with"
                    f" {settings.get(name)!r}; give the same, or train again without --resume"
                )
        states: dict[int, dict[str, Tensor]] = {}
        network = {}
        for name, tensor in tensors.items():
            part, _, rest = name.partition(".")
            if part == "network":
                network[rest] = tensor
            else:
                index, _, key = rest.partition(".")
                states.setdefault(int(index), {})[key] = tensor
        self.network.load_state_dict(network)
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": states, "param_groups": groups})
