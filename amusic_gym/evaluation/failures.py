"""Contact sheets of the failures of a comparison, from the traces in its folder."""

import csv
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from amusic_gym.evaluation.comparison import RESULTS, TRACES, spread, trace_stems
from amusic_gym.policies.trace import FILE_COLUMNS
from amusic_gym.routes.bank_images import ListedImage, parse_change
from amusic_gym.utils.names import suggest
from amusic_gym.utils.reading import read_json
from amusic_gym.utils.storage import keep_only, write_whole

MOST = 40  # failures on a sheet
ACROSS = 4  # failures side by side
WIDTH, HEIGHT, MARGIN = 160, 120, 8  # pixels of a picture, and between failures
ABOVE, BELOW = 34, 38  # pixels for the sheet's title, and for the words of a failure


def contact_sheets(
    folder: Path,
    out: Path,
    *,
    policies: Collection[str] = (),
    most: int = MOST,
    report: Callable[[str], object] = print,
) -> list[Path]:
    """A PNG for each bank, policy and λ with failures: query, matched place and true place of each.

    A failure is a wrong frame that has a true place. Of more than ``most``, an even spread. Without
    ``policies``, named as in ``results.json``, all are taken. Sheets of an earlier call in ``out``
    that are not written again go. ``report`` is given a line per trace.

    Raises:
        FileNotFoundError: where there is no comparison, or an image is not there any more.
        ValueError: for an unknown policy, or a trace without image files.
    """
    rows = read_json(folder / RESULTS, "run compare again")["rows"]
    known = dict.fromkeys(row["policy"] for row in rows)
    for policy in policies:
        if policy not in known:
            raise ValueError(suggest("policy of this comparison", policy, known))
    made = []
    for row, stem in zip(rows, trace_stems(rows), strict=True):
        if policies and row["policy"] not in policies:
            continue
        failed = failures(folder / TRACES / f"{stem}.csv")
        weight = "" if row["compute_weight"] is None else f", lambda {row['compute_weight']:g}"
        words = f"{row['policy']}{weight} on {row['bank']}"
        shown = spread(failed, most)
        report(f"{words}: {len(failed)} of {row['queries']} frames failed")
        if shown:
            title = f"{words}: {len(shown)} of {len(failed)} failures, {row['queries']} frames"
            made.append(write_whole(out / f"{stem}.png", _sheet(title, shown)))
    keep_only(out, "contact sheets", made)
    return made


def failures(trace: Path) -> list[dict[str, str]]:
    """The lines of a trace on which a place that is on the map was not recognised.

    Raises:
        FileNotFoundError: when it is not there.
        ValueError: when it names no image files.
    """
    with trace.open(newline="", encoding="utf-8", errors="surrogateescape") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    if not set(FILE_COLUMNS) <= set(reader.fieldnames or ()):
        raise ValueError(f"{trace} is of an older version; run compare again")
    if not all(row["query_file"] for row in rows):
        raise ValueError(
            f"{trace} names no image files; compare on a bank that amusic bank images, render or"
            " tour made"
        )
    return [row for row in rows if row["correct"] == "0" and row["true_place"]]


def _sheet(title: str, rows: Sequence[dict[str, str]]) -> bytes:
    """A PNG: three pictures and two lines of words for every failure."""
    import cv2

    from amusic_gym.envs.pictures.canvas import GREY, LARGE, SMALL, Box, Canvas

    across, down = min(ACROSS, len(rows)), -(-len(rows) // ACROSS)
    width, height = 3 * WIDTH + MARGIN, HEIGHT + BELOW
    canvas = Canvas(across * width + MARGIN, ABOVE + down * height)
    canvas.text(title, MARGIN, 22, width=across * width, size=LARGE)
    for number, row in enumerate(rows):
        left = MARGIN + number % ACROSS * width
        top = ABOVE + number // ACROSS * height
        for at, image in enumerate(_images(row)):
            box = Box(left + at * WIDTH, top, left + (at + 1) * WIDTH - 1, top + HEIGHT)
            if image is not None:
                canvas.photograph(image.read(), box)
        below = top + HEIGHT
        held = f", p {float(row['p_correct']):.2f}" if row["p_correct"] else ""
        words = f"frame {row['frame']}{held}: {row['techniques'] or 'nothing ran'}"
        canvas.text(words, left, below + 13, width=3 * WIDTH, size=SMALL)
        places = "none yet" if row["prediction"] == "-1" else f"place {row['prediction']}"
        for at, label in enumerate(("camera", f"matched: {places}", f"true: {row['true_place']}")):
            canvas.text(label, left + at * WIDTH, below + 29, size=SMALL, colour=GREY, width=WIDTH)
    good, data = cv2.imencode(".png", canvas.pixels)
    assert good
    return data.tobytes()


def _images(row: dict[str, Any]) -> list[ListedImage | None]:
    """Query, matched and true."""
    change = parse_change(row["query_change"]) if row["query_change"] else None
    places = (row["matched_file"], row["true_file"])
    return [
        ListedImage(Path(row["query_file"]), change),
        *(ListedImage(Path(name)) if name else None for name in places),
    ]
