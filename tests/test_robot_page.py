"""The Python of docs/robot.md runs as it says, one block after the other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from extraction_cases import make_images

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robot.md"

pytestmark = pytest.mark.slow


def test_the_page_drives_as_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)
    assert len(blocks) == 3
    for seed, name in enumerate(("reference", "drive")):
        make_images(tmp_path / "images" / name, 4, seed, size=(64, 64))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    values: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, "robot.md", "exec"), values)
    lines = capsys.readouterr().out.splitlines()
    assert values["result"].frame == 3
    assert len(lines) >= 1 + 4
    assert all(re.fullmatch(r"[0-3] HOG CoHOG", line) for line in lines[-4:])
