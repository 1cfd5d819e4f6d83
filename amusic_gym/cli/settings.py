"""The settings of a training as options of a command, derived from their dataclasses."""

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from amusic_agents.config import (
    DEFAULTS,
    USED_BY,
    TrainingConfig,
    leaves,
    plain,
    training_config,
    with_leaves,
    with_values,
)

from amusic_gym.cli.parser import Parser, add_correction, pairs
from amusic_gym.utils.reading import read_json

SHORT = {"rollouts.iterations": "--iterations", "rollouts.states": "--states"}
"""Second names of options."""

PREFIX = "settings."  # of the options' names among a command's arguments

APART = ("carry", "discount", "simulation")
"""Settings whose options are of another form than their values."""

FREE = ("timesteps", "threads")  # settings that may be others when a training is resumed


def option(name: str) -> str:
    """The option of a setting: ``--network-hidden`` of ``network.hidden``."""
    return "--" + name.replace("_", "-").replace(".", "-")


def add_settings(parser: Parser) -> None:
    """Add an option for every setting of a training, and ``--config``."""
    add = parser.add_argument
    file = (
        "settings as JSON, as a run folder's config.json has them under 'training'; options go"
        " before it"
    )
    add("--config", type=Path, metavar="FILE", help=file)
    defaults = training_config("ppo")
    said = _described(defaults)
    for name, default in leaves(defaults).items():
        if name in APART:
            continue
        others = [f"{which}: {_shown(its[name])}" for which, its in DEFAULTS.items() if name in its]
        known = "; ".join([_shown(default), *others])
        names = [option(name), *([SHORT[name]] if name in SHORT else [])]
        about = f"{said.get(name, '')} (default: {known})".replace("%", "%%")
        add(*names, dest=PREFIX + name, help=about, **_kind(default))
    add_correction(parser, "in training and ever after")
    drawn = (
        "draw training routes from other ranges, for example retimed=0 wander=0:0 (names:"
        " amusic_gym.routes.simulate.Simulation)"
    )
    add("--simulation", nargs="+", metavar="NAME=VALUE", help=drawn)


def _kind(default: Any) -> dict[str, Any]:
    """How argparse reads a setting with this default."""
    if isinstance(default, bool):
        return {"action": "store_const", "const": not default}
    if isinstance(default, tuple):
        return {"type": float, "nargs": len(default), "metavar": ("LOW", "HIGH")}
    return {"type": type(default), "metavar": {int: "N", float: "X"}.get(type(default), "NAME")}


def _shown(value: Any) -> str:
    return " ".join(f"{each:g}" for each in value) if isinstance(value, tuple) else str(value)


def _described(settings: Any) -> dict[str, str]:
    """What docstrings say of every setting, by its name as of ``leaves``."""
    said = {}
    for kind in reversed(type(settings).__mro__):
        for name, text in re.findall(r"^ {8}(\w+): (.*(?:\n {12}.*)*)", kind.__doc__ or "", re.M):
            said[name] = " ".join(text.split()).removesuffix(".")
    for each in fields(settings):
        within = getattr(settings, each.name)
        if is_dataclass(within):
            said |= {f"{each.name}.{name}": text for name, text in _described(within).items()}
    return said


def given_settings(args: argparse.Namespace) -> dict[str, Any]:
    """What the options say, by name as of ``leaves``; lists where settings have tuples."""
    given = {
        name.removeprefix(PREFIX): value
        for name, value in vars(args).items()
        if name.startswith(PREFIX) and value is not None
    }
    given |= {name: getattr(args, name) for name in ("carry", "discount")}
    if args.simulation:
        given["simulation"] = ranges(args.simulation)
    return {name: value for name, value in given.items() if value is not None}


def ranges(items: Sequence[str]) -> dict[str, float | str | tuple[float, ...]]:
    """``["retimed=0.5", "queries=80:100"]`` as ranges of a simulation."""
    return {name: _value(value) for name, value in pairs(items, "--simulation").items()}


def _value(text: str) -> float | str | tuple[float, ...]:
    try:
        numbers = tuple(float(part) if "." in part else int(part) for part in text.split(":"))
    except ValueError:
        return text  # a word, such as a kind of motion
    return numbers if len(numbers) > 1 else numbers[0]


def settings_of(args: argparse.Namespace) -> TrainingConfig:
    """The algorithm's defaults, with what ``--config`` and then the options say."""
    given = given_settings(args)
    file = {} if args.config is None else _read(args.config)
    config = training_config(given.get("algorithm", file.get("algorithm", "ppo")))
    try:
        config = with_values(config, {**file, "algorithm": config.algorithm})
    except ValueError as error:
        raise ValueError(f"{args.config}: {error}") from error
    refuse_unused(config.algorithm, given)
    return with_leaves(config, given)  # type: ignore[no-any-return]


def refuse_unused(algorithm: str, names: Iterable[str]) -> None:
    """Refuse settings of other algorithms."""
    for name in names:
        users = USED_BY.get(name.partition(".")[0], (algorithm,))
        if algorithm not in users:
            raise ValueError(
                f"{SHORT.get(name, option(name))} is of the algorithm {' or '.join(users)};"
                f" leave it out, or give --algorithm {users[0]}"
            )


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = read_json(path, "write it again")
    within = found.get("training", found)
    if not isinstance(within, dict):
        raise ValueError(f"{path}: training is {within!r}; give an object with the settings")
    return within


def refuse_others(given: Mapping[str, Any], base: TrainingConfig, out: Path) -> None:
    """Refuse settings that are not those of the training to resume; some may be others."""
    own = leaves(base)
    for name, value in given.items():
        if name not in FREE and plain(value) != own[name]:
            raise ValueError(
                f"{name} is {value}, but {out} was trained with {own[name]}; leave it out to"
                " resume, or give another folder"
            )
