"""Contact sheets: every failure and nothing else, as the drive saw it."""

from __future__ import annotations

import csv
import json

import cv2
import numpy as np
import pytest
from env_cases import random_bank

from amusic_gym.cli import start
from amusic_gym.evaluation import failures as module
from amusic_gym.evaluation.comparison import compare
from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.failures import contact_sheets
from amusic_gym.routes.bank_images import BankImages, ListedImage
from amusic_gym.routes.conditions import Change, Condition

pytestmark = pytest.mark.slow


@pytest.fixture
def compared(tmp_path):
    """A comparison on random scores, most of it wrong, on images of one colour each."""
    bank = random_bank(4, queries=12, references=12, tolerance=1)
    listed = []
    for at in range(24):
        path = tmp_path / "images" / f"{at:02}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), np.full((12, 16, 3), 10 * at, np.uint8))
        listed.append(ListedImage(path))
    listed[3] = ListedImage(listed[3].path, Change(Condition.parse("night"), 0, 3))
    loaded = bank.save(tmp_path / "bank")
    BankImages(tuple(listed[:12]), tuple(listed[12:])).save(loaded)
    bank = type(bank).load(loaded)
    specs = contestants(["raw:T2", "music", "oracle", "voi"], compute_weights=(0.1,))
    result = compare([bank], lambda bank: specs, tmp_path / "out", report=len)
    return tmp_path / "out", result, listed


def test_a_sheet_for_every_drive_that_failed(compared):
    folder, result, _ = compared
    said = []
    sheets = contact_sheets(folder, folder / "failures", report=said.append)
    failed = [t for t in result.traces if not (t.correct | ~t.has_place).all()]
    assert 1 < len(sheets) == len(failed)
    assert [path.suffix for path in sheets] == [".png"] * len(sheets)
    assert len(said) == len(result.traces)
    wrong = int((~result.traces[0].correct & result.traces[0].has_place).sum())
    assert said[0].endswith(f"raw:T2 on {result.traces[0].bank}: {wrong} of 12 frames failed")
    few = contact_sheets(folder, folder / "failures", policies=["music"], report=len)
    assert [path for path in sheets if path.exists()] == few


def test_a_sheet_shows_the_query_the_matched_and_the_true_image(compared, monkeypatch):
    folder, result, listed = compared
    drawn = []
    monkeypatch.setattr(module, "_sheet", lambda title, rows: drawn.append((title, rows)) or b"")
    contact_sheets(folder, folder / "failures", policies=["raw:T2"], most=5, report=len)
    ((title, rows),) = drawn
    trace = result.traces[0]
    wrong = np.flatnonzero(~trace.correct & trace.has_place).tolist()
    assert f"{min(5, len(wrong))} of {len(wrong)} failures" in title
    frames = [int(row["frame"]) for row in rows]
    assert set(frames) <= set(wrong)
    assert (frames[0], frames[-1]) == (wrong[0], wrong[-1])
    for frame, row in zip(frames, rows, strict=True):
        query, matched, true = module._images(row)
        assert query == listed[frame]  # under its condition
        assert matched == listed[12 + trace.predictions[frame]]
        assert true == listed[12 + trace.true_place[frame]]


def test_the_pictures_are_on_the_sheet(compared):
    folder, result, listed = compared
    (sheet,) = contact_sheets(folder, folder / "f", policies=["raw:T2"], most=1, report=len)
    trace = result.traces[0]
    frame = int(np.flatnonzero(~trace.correct & trace.has_place)[0])
    pixels = cv2.imread(str(sheet))
    top = module.ABOVE + module.HEIGHT // 2
    shown = [pixels[top, module.MARGIN + module.WIDTH // 2 + at * module.WIDTH] for at in range(3)]
    places = trace.predictions[frame], trace.true_place[frame]
    wanted = [listed[frame], *(listed[12 + place] for place in places)]
    assert np.array_equal(shown, [image.read()[6, 8] for image in wanted])


def test_what_cannot_be_drawn_is_refused(compared, tmp_path, capsys):
    folder, _, listed = compared
    with pytest.raises(ValueError, match="did you mean .music"):
        start("failures", [str(folder), "--policy", "musik"])
    with pytest.raises(ValueError, match="--most"):
        start("failures", [str(folder), "--most", "0"])
    with pytest.raises(FileNotFoundError, match=r"results\.json"):
        start("failures", [str(tmp_path)])
    alone = tmp_path / "alone"
    compare([random_bank(1)], lambda bank: contestants(["music"]), alone, report=len)
    with pytest.raises(ValueError, match="names no image files"):
        start("failures", [str(alone)])
    for image in listed:
        image.path.unlink()
    with pytest.raises(FileNotFoundError, match=r"\.png"):
        start("failures", [str(folder)])
    assert not list((folder / "failures").glob("*.png"))


def test_the_command_names_its_sheets(compared, capsys):
    folder, *_ = compared
    start("failures", [str(folder), "--out", str(folder / "sheets")])
    lines = capsys.readouterr().out.splitlines()
    rows = json.loads((folder / "results.json").read_text())["rows"]
    with (folder / "traces" / "bank4-raw_T2.csv").open() as file:
        wrong = sum(row["correct"] == "0" for row in csv.DictReader(file))
    assert len(rows) == sum("frames failed" in line for line in lines)
    assert f": {wrong} of 12" in lines[0]
    assert all((folder / "sheets").joinpath(line).is_file() for line in lines if ".png" in line)
