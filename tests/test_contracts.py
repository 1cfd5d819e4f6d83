"""docs/contracts.md and the tests with a contract's number in their names belong together."""

from __future__ import annotations

import ast
import re
from pathlib import Path

TESTS = Path(__file__).resolve().parent
PAGE = TESTS.parent / "docs" / "contracts.md"


def numbered_tests() -> set[int]:
    """Numbers of all tests that hold a contract."""
    trees = (ast.parse(path.read_text("utf-8")) for path in TESTS.glob("test_*.py"))
    names = [node.name for tree in trees for node in ast.walk(tree) if hasattr(node, "name")]
    return {int(found[1]) for name in names if (found := re.match(r"test_(\d+)_", str(name)))}


def test_every_contract_has_tests_and_every_numbered_test_a_contract():
    rows = [int(n) for n in re.findall(r"^\| (\d+) \|", PAGE.read_text("utf-8"), re.MULTILINE)]
    assert rows == list(range(1, len(rows) + 1))
    assert numbered_tests() == set(rows)


def test_numbers_have_two_digits_so_that_one_selects_no_other():
    text = "\n".join(path.read_text("utf-8") for path in TESTS.glob("test_*.py"))
    assert not re.findall(r"def test_(?:\d|\d{3,}|promise_\d+)_", text)
