"""Source files that a module depends on, by the imports of its text."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent.parent  # this package's folder
_FIRST_DEFINITION = re.compile(rb"^(?:@|def |class |async )", re.MULTILINE)


def imports_of(text: bytes, module: str, *, is_package: bool) -> Iterator[str]:
    """Dotted names that a source file imports, with those that may be modules.

    What is imported inside a function counts; what is for type checkers only does not.
    """
    try:
        pending: list[ast.AST] = [ast.parse(text)]
    except SyntaxError:  # imported where that does no harm, if at all
        return
    parts = [*module.split("."), "__init__"] if is_package else module.split(".")
    for node in pending:  # grows while it is walked
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = node.module or ""
            if node.level:
                parents = parts[: -node.level]
                start = ".".join([*parents, *filter(None, [node.module])])
            yield start
            yield from (f"{start}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            pending += node.orelse
        elif not isinstance(node, ast.expr):
            pending += ast.iter_child_nodes(node)


@cache
def _imported(file: Path, package: Path, lazily: bool) -> tuple[str, ...]:
    """Modules of a package that a file imports."""
    inside = file.relative_to(package.parent) if package in file.parents else Path(file.name)
    is_package = file.name == "__init__.py"
    module = ".".join((inside.parent if is_package else inside.with_suffix("")).parts)
    text = file.read_bytes()
    if not lazily:
        text = _FIRST_DEFINITION.split(text, 1)[0]  # parsing all takes tens of milliseconds
    found = imports_of(text, module, is_package=is_package)
    return tuple(name for name in found if name.startswith(f"{package.name}."))


def source_files(
    entry: Path,
    *,
    package: Path = PACKAGE,
    lazily: bool = True,
) -> tuple[Path, ...]:
    """A source file, and the files of a package that it depends on.

    A parent package's ``__init__.py`` is not among them unless its names are imported from it.

    With ``lazily`` imports inside functions count, else those before the first definition.
    """
    files = [entry]
    pending = list(_imported(entry, package, lazily))
    seen: set[str] = set()
    for name in pending:  # grows while it is walked
        if name in seen:
            continue
        seen.add(name)
        at = package.parent.joinpath(*name.split("."))
        for file in (at.with_suffix(".py"), at / "__init__.py"):
            if file.is_file() and file not in files:
                files.append(file)
                pending += _imported(file, package, lazily)
    return tuple(sorted(files))


def digest_of(*files: Path) -> str:
    """SHA-256 of files of one package, in hexadecimal digits: their names and their bytes."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()
