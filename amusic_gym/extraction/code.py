"""The key of a technique's results in the cache: class, parameters, code and libraries."""

import hashlib
import importlib.metadata
import inspect
import json
import marshal
import sys
from collections.abc import Mapping
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from amusic_gym.techniques.own_code import guarded, is_local
from amusic_gym.techniques.protocol import Technique
from amusic_gym.utils.imports import imports_of

_PACKAGE = "amusic_gym"
_ALWAYS = ("amusic_gym.routes.images", "amusic_gym.extraction.blocks")
"""Code that every descriptor and every score goes through."""


def identity(technique: Technique) -> dict[str, Any]:
    """All that descriptors and scores depend on besides the images, for the keys of the cache.

    The code is that of the files which define the class and its bases, and of the modules that
    they import, of the same package or of somebody's own (neither installed nor Python's), and so
    on, by their text. The libraries are those which that code imports. What a class of your own
    takes from elsewhere, say a file, ``parameters()`` must name.

    Raises:
        ValueError: for parameters that are not plain values, or that raise something.
    """
    kind: Any = type(technique)
    sources, libraries = _code_of(kind)
    return {
        "class": f"{kind.__module__}.{kind.__qualname__}",
        "name": technique.name,
        "parameters": _plain(technique),
        "code": sources,
        "libraries": {library: _version(library) for library in libraries},
    }


def describes_queries_alike(technique: Technique) -> bool:
    """Whether a query's descriptor is that of the same image on the map."""
    return type(technique).describe_query is Technique.describe_query


def _plain(technique: Technique) -> dict[str, Any]:
    plain = {}
    what = f"technique {technique.name!r}, parameters()"
    given = guarded(what, technique, lambda: dict(technique.parameters()))
    for name, value in given.items():
        value = value.item() if isinstance(value, np.generic) else value
        if not isinstance(value, str | int | float):  # bool is an int
            raise ValueError(
                f"parameter {name!r} of technique {technique.name!r} is {value!r}; "
                "parameters() must give texts, numbers, True or False"
            )
        plain[str(name)] = value
    return plain


@cache
def _code_of(kind: type) -> tuple[str, tuple[str, ...]]:
    """Digest of a class's code, and the libraries that it imports."""
    digest = hashlib.sha256()
    libraries = {"numpy"}
    pending = list(_ALWAYS)
    for base in inspect.getmro(kind):
        if base is not object:
            pending.append(base.__module__)
            if _file_of(base.__module__) is None:  # typed in, as in a notebook
                digest.update(_text_of(base))
    seen: set[str] = set()
    for module in pending:  # grows while it is walked
        if module in seen or module == _PACKAGE:  # the latter only makes things known
            continue
        seen.add(module)
        file = _file_of(module)
        if file is None:
            continue
        text = file.read_bytes()
        digest.update(hashlib.sha256(text).digest())
        home = module.partition(".")[0]
        for name in imports_of(text, module, is_package=file.name == "__init__.py"):
            top = name.partition(".")[0]
            if top in (home, _PACKAGE) or _is_own(top):
                pending += [name, top]  # the latter: a package's own file is run first
            elif top not in sys.stdlib_module_names:
                libraries.add(top)
    return digest.hexdigest(), tuple(sorted(libraries))


@cache
def _is_own(top: str) -> bool:
    """Whether a top-level module or package is neither installed nor Python's."""
    if top in sys.stdlib_module_names:
        return False
    file, spec = _file_of(top), _spec_of(top)
    places = [str(file)] if file else list(spec and spec.submodule_search_locations or ())
    return bool(places) and all(map(is_local, places))


@cache
def _file_of(module: str) -> Path | None:
    """Source file of a module; None where there is none, or the name is no module."""
    spec = _spec_of(module)
    origin = getattr(sys.modules.get(module), "__file__", None) or (spec and spec.origin) or ""
    return Path(origin) if origin.endswith(".py") and Path(origin).is_file() else None


def _spec_of(module: str) -> ModuleSpec | None:
    """The place a module is, or would be, imported from; nothing of it is run."""
    if module in sys.modules:
        return sys.modules[module].__spec__
    places: list[str] | None = None  # Python's path
    if parent := module.rpartition(".")[0]:
        above = _spec_of(parent)
        places = (above and above.submodule_search_locations) or []
    return PathFinder.find_spec(module, places)


def _text_of(kind: type) -> bytes:
    try:
        return inspect.getsource(kind).encode()
    except (OSError, TypeError):  # typed at the prompt: its compiled functions
        functions = [value for value in vars(kind).values() if isinstance(value, FunctionType)]
        return b"".join(marshal.dumps(function.__code__) for function in functions)


@cache
def _distributions() -> Mapping[str, list[str]]:
    return importlib.metadata.packages_distributions()


def _version(library: str) -> str:
    found = {importlib.metadata.version(each) for each in _distributions().get(library, ())}
    return ", ".join(sorted(found)) or str(
        getattr(sys.modules.get(library), "__version__", "unknown")
    )


def key_of(**parts: Any) -> str:
    """64 hexadecimal digits that stand for ``parts``, which must be plain data."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
