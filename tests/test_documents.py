"""Text that commands write into documents, and that nobody wrote over it."""

from __future__ import annotations

from pathlib import Path

import pytest

from amusic_gym.evaluation.documents import altered, filled, outside

DOCS = Path(__file__).parent.parent / "docs"
EMPTY = (
    "# Title\n\n<!-- made by: a -->\n<!-- end -->\n\nText.\n\n"
    "<!-- made by: b -->\nold\n<!-- end -->\n"
)


def test_a_block_takes_its_text_and_the_rest_stays():
    once = filled(EMPTY, {"a": "| 1 |"})
    assert "-->\n\n| 1 |\n\n<!-- end -->\n\nText." in once
    assert once.endswith("<!-- made by: b -->\nold\n<!-- end -->\n")
    assert filled(once, {"a": "| 1 |"}) == once
    assert outside(once) == "# Title\n\n\n\nText.\n\n\n"


def test_what_is_typed_by_hand_is_found():
    whole = filled(EMPTY, {"a": "| .951 |", "b": "| .2 |"})
    assert altered(whole) == []
    assert altered(whole.replace(".951", ".961")) == ["a"]
    assert altered(EMPTY) == ["a", "b"]  # never filled


@pytest.mark.parametrize("document", ["nothing", EMPTY + EMPTY])
def test_a_document_without_the_block_once_is_refused(document):
    with pytest.raises(ValueError, match="blocks made by 'a'; give it the lines"):
        filled(document, {"a": "1"})


@pytest.mark.parametrize("name", ["results.md", "leaderboard.md"])
def test_every_table_of_the_results_is_as_the_command_made_it(name):
    document = (DOCS / name).read_text("utf-8")
    assert document.count("made by: scripts/results.py") == 3
    assert altered(document) == []
    assert not [line for line in outside(document).splitlines() if line.startswith("|")]
