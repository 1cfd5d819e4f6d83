"""Techniques: images to descriptors to scores.

Adding one: a file with its class, one line in ``TECHNIQUES``, one test. From outside the package:
``register("mine", Mine)``, or name the class as ``"package.module:Mine"`` wherever a technique is
named.
"""

import contextlib
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from amusic_gym.techniques.own_code import guarded, told
from amusic_gym.techniques.protocol import Descriptor, Image, Technique
from amusic_gym.utils.names import suggest

__all__ = ["TECHNIQUES", "Descriptor", "Image", "Technique", "make_technique", "register"]

Factory = Callable[..., Technique]

TECHNIQUES: dict[str, str | Factory] = {
    "hog": "amusic_gym.techniques.hog:HOG",
    "cohog": "amusic_gym.techniques.cohog:CoHOG",
    "calc": "amusic_gym.techniques.calc:CALC",
    "netvlad": "amusic_gym.techniques.netvlad:NetVLAD",
    "gist": "amusic_gym.techniques.gist:GIST",
    "gist-lear": "amusic_gym.techniques.gist:LearGIST",
    "effnet": "amusic_gym.techniques.effnet:EffNet",
    "effnet-rmac": "amusic_gym.techniques.effnet:EffNetRMAC",
    "amosnet": "amusic_gym.techniques.amosnet:AMOSNet",
    "hybridnet": "amusic_gym.techniques.amosnet:HybridNet",
    "rmac": "amusic_gym.techniques.rmac:RMACTechnique",
    "fabmap": "amusic_gym.techniques.fabmap:FABMAP",
    "torchscript": "amusic_gym.techniques.any_network:TorchScript",
    "onnx": "amusic_gym.techniques.any_network:ONNX",
    "hub": "amusic_gym.techniques.any_network:Hub",
}
"""Name on the command line → class, or where it is: it is imported when it is used.

Of a class that takes an ``argument``, this is what stands behind the name and a colon.
"""


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


def make_technique(
    name: str,
    weights: str | Path | None = None,
    *,
    device: str = "cpu",
    trust: bool = False,
) -> Technique:
    """Build a technique.

    Args:
        name: one of ``TECHNIQUES``, upper or lower case, where it takes some with settings behind
            a colon; or ``"package.module:Class"``, a module that Python finds, or of the current
            directory.
        weights: its weights file; None: those that ship, or none.
        device: ``"cpu"`` or ``"cuda"``, for techniques that can be told.
        trust: whether ``hub:`` may run the code of its repository.

    Raises:
        ValueError: for an unknown name, with the nearest suggested; for something that is no
            technique; for one that takes no weights; for a file of other weights; for one whose
            module or class raises something, which is its cause.
        FileNotFoundError: for a weights file that is not there.
    """
    factory, options = _with_argument(name)
    if weights is not None:
        if not _takes(factory, "weights"):
            raise ValueError(f"technique {name!r} takes no weights; leave out {weights}")
        options["weights"] = weights
    told_of: dict[str, Any] = {"device": device, "trust": trust}
    options |= {key: value for key, value in told_of.items() if _named(factory, key)}
    try:
        technique: object = guarded(
            f"technique {name!r} cannot be made", factory, factory, **options
        )
    except ValueError as error:
        if isinstance(error.__cause__, FileNotFoundError):  # its weights, say
            raise error.__cause__ from None
        raise
    if not isinstance(technique, Technique) or not isinstance(getattr(technique, "name", 0), str):
        raise ValueError(
            f"technique {name!r} is a {type(technique).__name__}; derive its class from "
            "amusic_gym.techniques.Technique and give it a name, a text"
        )
    return technique


def _with_argument(name: str) -> tuple[Factory, dict[str, Any]]:
    """What makes a technique, and what stands behind its name where that takes something."""
    head, colon, argument = name.partition(":")
    if colon and head.casefold() in TECHNIQUES:
        factory = _factory(head)
        if _named(factory, "argument"):
            return factory, {"argument": argument}
    factory = _factory(name)
    needed = None if ":" in name else inspect.signature(factory).parameters.get("argument")
    if needed is not None and needed.default is needed.empty:
        raise ValueError(f"technique {name!r} needs more behind its name: {name}:…")
    return factory, {}


def _named(factory: Factory, name: str) -> bool:
    return name in inspect.signature(factory).parameters


def _takes(factory: Factory, name: str) -> bool:
    parameters = inspect.signature(factory).parameters
    return name in parameters or any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def _factory(name: str) -> Factory:
    if ":" not in name and name.casefold() not in TECHNIQUES:
        raise ValueError(suggest("technique", name, TECHNIQUES))
    found = name if ":" in name else TECHNIQUES[name.casefold()]
    if not isinstance(found, str):
        return found
    module, _, attribute = found.partition(":")
    if not (module.strip(".") and attribute):
        raise ValueError(f"technique {name!r} is not of the form package.module:Class")
    _look_here(module)
    try:
        kind = getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:  # a module of one's own may raise anything
        why = str(error) if isinstance(error, ImportError | AttributeError) else told(error)
        raise ValueError(f"technique {name!r} cannot be imported: {why}") from error
    if not isinstance(kind, type):
        raise ValueError(f"technique {name!r} is a {type(kind).__name__}; name a class")
    if not issubclass(kind, Technique):  # before it is called: it may do anything
        raise ValueError(
            f"technique {name!r} is a class that is no technique; derive it from "
            "amusic_gym.techniques.Technique"
        )
    return kind


def _look_here(module: str) -> None:
    """Let a module of the current directory be found, after all others, also by workers."""
    top = module.partition(".")[0]
    with contextlib.suppress(OSError, ImportError, ValueError):
        here = os.getcwd()
        importlib.invalidate_caches()
        if top in sys.modules or here in sys.path or importlib.util.find_spec(top) is not None:
            return
        sys.path.append(here)
        if importlib.util.find_spec(top) is None:
            sys.path.remove(here)
