"""What a page's script shows: points of the front, drives frame by frame, small pictures.

One drive and its pictures are in the page; the others lie beside it, as scripts and JPEG files: a
page that is opened from a folder may load these, but no other data.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.evaluation.plots import labels
from amusic_gym.policies.registry import FAMILIES, FIXED, Family, parse
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.bank_images import BankImages, ListedImage
from amusic_gym.utils.colours import technique_colours
from amusic_gym.utils.storage import keep_only, write_whole

LONGEST_SIDE = 160  # pixels of a picture
COLUMNS, PER_SHEET = 10, 50  # pictures side by side on a sheet, and all on it
ROOM = 5_000_000  # characters of pictures and figures in the page; more lie beside it

Row = Mapping[str, Any]


class Beside:
    """The files beside a page, in a folder of its name."""

    def __init__(self, page: Path) -> None:
        self.page = page
        self.folder = page.with_name(f"{page.stem}_files")
        self.room = ROOM
        self._written: list[Path] = []

    def write(self, name: str, content: bytes) -> str:
        """Write a file; returns its address from the page."""
        self._written.append(write_whole(self.folder / name, content))
        return f"{self.folder.name}/{name}"

    def inside(self, data: str) -> bool:
        """Whether there is room for a data URL in the page; if so it is taken."""
        fits = len(data) <= self.room
        self.room -= len(data) * fits
        return fits

    def sweep(self) -> None:
        """Remove the files that an earlier page had here and this one has not."""
        keep_only(self.page.parent, f"files of {self.page.name}", self._written)


def page_data(
    rows: Sequence[Row],
    traces: Sequence[Trace],
    images: Mapping[str, BankImages | None],
    highlights: Sequence[tuple[str, Trace]],
    beside: Beside,
) -> str:
    """What the page's script reads, as JSON that HTML can hold; `write_report` has the arguments.

    The first drive of ``highlights``, or of all, is shown; the others go ``beside`` the page.
    """
    shown = highlights[0][1] if highlights else None
    order = sorted(traces, key=lambda trace: trace is not shown)
    banks = {trace.bank: trace for trace in order}
    names = labels.all_techniques(trace.techniques for trace in order)
    drives = []
    for number, trace in enumerate(order):
        body = json.dumps(drive_data(trace), separators=(",", ":"))
        url = beside.write(f"{number}.js", f"drive({number},{body})".encode()) if number else ""
        bank = list(banks).index(trace.bank)
        drives.append([bank, trace.policy, trace.compute_weight, url])
    sheets = {}
    for number, name in enumerate(banks):
        if (held := images.get(name)) is not None:
            for kind in ("query", "reference"):
                pictures = getattr(held, kind)
                sheets[name, kind] = _sheets(pictures, f"{number}-{kind}", beside, not number)
    of = {id(trace): number for number, trace in enumerate(order)}
    data = {
        "scopes": _scopes(rows),
        "policies": _policies(rows, names),
        "banks": [_bank(trace, sheets) for trace in banks.values()],
        "drives": drives,
        "first": drive_data(order[0]) if order else None,
        "highlights": [[words, of[id(trace)]] for words, trace in highlights],
        "colours": technique_colours(names),
    }
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def drive_data(trace: Trace) -> dict[str, Any]:
    """A drive, frame by frame: places, techniques run (bits), p̂ in percent, cost of the runs."""
    runs = trace.runs
    unit = 1.0 if trace.costs == "runs" else 1000.0
    known = ~np.isnan(trace.p_correct)
    percent = np.rint(100.0 * np.where(known, trace.p_correct, 0.0)).astype(int)
    return {
        "at": trace.predictions.tolist(),
        "true": trace.true_place.tolist(),
        "off": [None if np.isnan(gap) else int(gap) for gap in trace.error],
        "right": [
            int(right) if place else -1
            for right, place in zip(trace.correct, trace.has_place, strict=True)
        ],
        "ran": _bits(trace.ran),
        "late": _bits(trace.late_frames()),
        "p": [value if has else None for value, has in zip(percent.tolist(), known, strict=True)],
        "cost": np.round(runs @ trace.seconds * unit, 1).tolist(),
        "trusted": trace.chosen.tolist(),
    }


def _bits(flags: NDArray[np.bool_]) -> Any:
    """(Q, T) flags as a list of one number per frame, the first technique its lowest bit."""
    return (flags @ (2 ** np.arange(flags.shape[1], dtype=np.int64))).tolist()


def _bank(trace: Trace, sheets: Mapping[tuple[str, str], Any]) -> dict[str, Any]:
    places = max(trace.true_place.max(), trace.predictions.max()) + 1
    return {
        "name": labels.bank_label(trace.bank),
        "frames": trace.queries,
        "places": int(places),
        "techniques": trace.techniques,
        "costs": trace.costs,
        "all": round(float(trace.seconds.sum()) * (1.0 if trace.costs == "runs" else 1000.0), 1),
        "query": sheets.get((trace.bank, "query")),
        "reference": sheets.get((trace.bank, "reference")),
    }


def _scopes(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The points of each bank's front: [compute, AUC, interval or null, policy, λ]."""
    shown = [row for row in rows if parse(row["policy"]).policy.charted]
    return [
        {
            "bank": labels.bank_label(name),
            "costs": next(row["costs"] for row in shown if row["bank"] == name),
            "points": [
                [row["compute"], row["auc"], row.get("auc_interval"), row["policy"]]
                + [row["compute_weight"]]
                for row in shown
                if row["bank"] == name
            ],
        }
        for name in dict.fromkeys(row["bank"] for row in shown)
    ]


def _policies(rows: Sequence[Row], techniques: Sequence[str]) -> dict[str, list[Any]]:
    """Label, colour, legend's words, and whether hollow; techniques alone have their own colour."""
    own = technique_colours(techniques)
    swept: dict[str, str] = {}
    for row in rows:
        if row["compute_weight"] is not None and not _family(row["policy"]).colour:
            swept.setdefault(row["policy"], labels.sweep_colour(len(swept)))
    found = {}
    for policy, row in {row["policy"]: row for row in rows}.items():
        known, label = parse(policy), labels.row_label(row)
        family = _family(policy)
        colour = swept.get(policy) or family.colour or known.policy.colour
        colour = colour or own.get(known.argument or "", "")
        words = label if policy in swept or not family.best else family.best
        if known.policy.family == FIXED and known.policy.colour is None:
            words = "fixed subset"
        found[policy] = [label, colour, words, known.is_variant]
    return found


def _family(policy: str) -> Family:
    return FAMILIES[parse(policy).policy.family]


def _sheets(
    images: Sequence[ListedImage], name: str, beside: Beside, inside: bool
) -> dict[str, Any]:
    """Small pictures of all images, `PER_SHEET` to a sheet; every one in a box of the first's."""
    import cv2

    height, width = _picture(images[0]).shape[:2]
    urls: list[str] = []
    for begin in range(0, len(images), PER_SHEET):
        rows = -(-min(PER_SHEET, len(images) - begin) // COLUMNS)
        sheet = np.full((rows * height, COLUMNS * width, 3), 128, np.uint8)
        for at, image in enumerate(images[begin : begin + PER_SHEET]):
            top, left = at // COLUMNS * height, at % COLUMNS * width
            picture = _picture(image)[:height, :width]
            sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
        jpeg = cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, 72])[1].tobytes()
        data = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
        file = f"{name}-{len(urls)}.jpg"
        urls.append(data if inside and beside.inside(data) else beside.write(file, jpeg))
    return {
        **{"width": width, "height": height, "columns": COLUMNS, "per": PER_SHEET},
        **{"count": len(images), "urls": urls},
    }


@lru_cache(maxsize=2048)
def _picture(image: ListedImage) -> NDArray[np.uint8]:
    import cv2

    pixels = image.read()
    scale = min(1.0, LONGEST_SIDE / max(pixels.shape[:2]))
    size = tuple(max(1, round(side * scale)) for side in pixels.shape[1::-1])
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
