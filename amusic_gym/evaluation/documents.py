"""Text that a command writes into a document, between two comments that name the command.

The first comment holds a digest of the text, so that a number typed by hand is found (`altered`).
"""

import hashlib
import re
from collections.abc import Mapping

BLOCK = re.compile(
    r"<!-- made by: (?P<by>[^\[\n]+?)(?: \[(?P<digest>\w*)\])? -->\n(?P<text>.*?)<!-- end -->",
    re.DOTALL,
)


def filled(document: str, blocks: Mapping[str, str]) -> str:
    """The Markdown document with new text, by name, in some of its blocks.

    These stand between ``<!-- made by: NAME -->`` and ``<!-- end -->``.

    Raises:
        ValueError: for a block that the document does not have exactly once.
    """
    there = [found["by"] for found in BLOCK.finditer(document)]
    for name in blocks:
        if there.count(name) != 1:
            raise ValueError(
                f"the document has {there.count(name)} blocks made by {name!r}; give it the lines"
                f" <!-- made by: {name} --> and <!-- end --> once"
            )

    def new(found: re.Match[str]) -> str:
        name = found["by"]
        if name not in blocks:
            return found[0]
        text = f"\n{blocks[name].strip()}\n\n"
        return f"<!-- made by: {name} [{_digest(text)}] -->\n{text}<!-- end -->"

    return BLOCK.sub(new, document)


def altered(document: str) -> list[str]:
    """Names of the blocks whose text is not the one that was filled in."""
    return [
        found["by"]
        for found in BLOCK.finditer(document)
        if found["digest"] != _digest(found["text"])
    ]


def outside(document: str) -> str:
    """The document without its blocks."""
    return BLOCK.sub("", document)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
