"""Techniques: images to descriptors to scores.

Adding one: a file with its class, one line in ``TECHNIQUES``, one test. From outside the package:
``register("mine", Mine)``, or name the class as ``"package.module:Mine"`` wherever a technique is
named.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from pathlib import Path

from amusic_gym.names import suggest
from amusic_gym.techniques.protocol import Descriptor, Image, Technique

__all__ = ["TECHNIQUES", "Descriptor", "Image", "Technique", "make_technique", "register"]

Factory = Callable[..., Technique]

TECHNIQUES: dict[str, str | Factory] = {
    "hog": "amusic_gym.techniques.hog:HOG",
    "cohog": "amusic_gym.techniques.cohog:CoHOG",
    "calc": "amusic_gym.techniques.calc:CALC",
    "netvlad": "amusic_gym.techniques.netvlad:NetVLAD",
}
"""Name on the command line → class, or where it is: it is imported when it is used."""


def register(name: str, factory: Factory | str) -> None:
    """Make a technique known by ``name``.

    Raises:
        ValueError: for a name that is taken by another technique, or holds ``,``, ``=`` or ``:``.
    """
    key = name.casefold()
    if not key.strip() or set(key) & set(",=:+/\\"):
        raise ValueError(f"technique name {name!r}; give letters, digits, '-' or '_'")
    if TECHNIQUES.get(key, factory) != factory:
        raise ValueError(f"technique {name!r} is registered already; choose another name")
    TECHNIQUES[key] = factory


def make_technique(name: str, weights: str | Path | None = None) -> Technique:
    """Build a technique.

    Args:
        name: one of ``TECHNIQUES``, upper or lower case, or ``"package.module:Class"``.
        weights: its weights file; None: those that ship, or none.

    Raises:
        ValueError: for an unknown name, with the nearest suggested; for something that is no
            technique; for one that takes no weights; for a file of other weights.
        FileNotFoundError: for a weights file that is not there.
    """
    factory = _factory(name)
    if weights is None:
        technique: object = factory()
    elif _takes_weights(factory):
        technique = factory(weights=weights)
    else:
        raise ValueError(f"technique {name!r} takes no weights; leave out {weights}")
    if not isinstance(technique, Technique) or not isinstance(getattr(technique, "name", 0), str):
        raise ValueError(
            f"technique {name!r} is a {type(technique).__name__}; derive its class from "
            "amusic_gym.techniques.Technique and give it a name, a text"
        )
    return technique


def _takes_weights(factory: Factory) -> bool:
    parameters = inspect.signature(factory).parameters
    return "weights" in parameters or any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def _factory(name: str) -> Factory:
    if ":" not in name and name.casefold() not in TECHNIQUES:
        raise ValueError(suggest("technique", name, TECHNIQUES))
    found = name if ":" in name else TECHNIQUES[name.casefold()]
    if not isinstance(found, str):
        return found
    module, _, attribute = found.partition(":")
    try:
        factory: Factory = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"technique {name!r} cannot be imported: {error}") from error
    if not callable(factory):
        raise ValueError(f"technique {name!r} is a {type(factory).__name__}; name a class")
    return factory
