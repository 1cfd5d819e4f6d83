"""One HTML page to explore: a drive frame by frame, AUC against compute, tables, figures.

The page is `report.html` with `report.js` in it. It opens from a folder, without a server, and
loads nothing but what is in the folder beside it (`amusic_gym.evaluation.report_drives`). It reads
on a phone and on paper, light and dark, with a keyboard and with a screen reader.
"""

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from amusic_gym.estimation.settings import statistic_label
from amusic_gym.evaluation.plots.labels import row_label
from amusic_gym.evaluation.report_drives import Beside, page_data
from amusic_gym.evaluation.tables import COLUMNS, Table
from amusic_gym.policies.registry import MARK
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.bank_images import BankImages
from amusic_gym.utils.storage import write_whole

GENERATOR = b'<meta name="generator" content="amusic-gym">'  # by which a page of ours is known

PICTURES = {b"\x89PNG\r\n": "png", b"\xff\xd8\xff": "jpeg"}
"""First bytes of a figure's file -> its type."""


@dataclass(frozen=True)
class ReportFigure:
    """A PNG or JPEG file and the sentence under it, which stands for it where it cannot be seen."""

    path: str | Path
    caption: str

    @property
    def source(self) -> str:
        """The file as a data URL."""
        path = Path(self.path)
        if not path.is_file():
            raise FileNotFoundError(f"figure {path} is not there; draw it before the report")
        content = path.read_bytes()
        kind = next((name for magic, name in PICTURES.items() if content.startswith(magic)), None)
        if kind is None:
            raise ValueError(f"figure {path} is no PNG or JPEG file; write it as one of these")
        return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def refuse_other_page(path: Path) -> None:
    """Refuse with a ValueError the name of a file that is no page of ours, which would be lost."""
    if path.is_file():
        with path.open("rb") as file:
            if GENERATOR not in file.read(4096):
                raise ValueError(
                    f"{path} is no page of amusic-gym; rename it, or give another folder"
                )


def write_report(
    path: str | Path,
    *,
    title: str,
    sentences: Sequence[str],
    rows: Sequence[Mapping[str, Any]],
    figures: Sequence[ReportFigure] = (),
    traces: Sequence[Trace] = (),
    images: Mapping[str, BankImages | None] | None = None,
    highlights: Sequence[tuple[str, Trace]] = (),
    tables: Sequence[Table] = (),
    below: Sequence[Table] = (),
) -> Path:
    """Write the page: the drives, the front of `rows`, tables and figures.

    Args:
        path: of the page; its other files go to a folder beside it, ``NAME_files``.
        title: above all.
        sentences: what the numbers say: the first on the first screen, the others below it.
        rows: of results; the mean first to have it as the summary. ``auc_interval``, where there
            is one, is drawn.
        figures: below the tables.
        traces: the drives that can be looked at; none: the page has no drive.
        images: name of a bank → its images.
        highlights: drives with a button each, and its words; the first is shown at first.
        tables: more of them, before the rows' first.
        below: more of them, behind that.

    Raises:
        FileNotFoundError: a figure is not there.
        ValueError: there is no row, a figure is no PNG file, or a page of others is there.
    """
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    if not rows:
        raise ValueError("rows is empty; give at least one results row")
    refuse_other_page(Path(path))
    sources = [figure.source for figure in figures]  # refused before anything is written
    beside = Beside(Path(path))
    data = Markup(page_data(rows, traces, images or {}, highlights, beside))
    for at, figure in enumerate(figures):
        if not beside.inside(sources[at]):
            sources[at] = Path(os.path.relpath(figure.path, Path(path).parent)).as_posix()
    environment = Environment(
        autoescape=True, trim_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined
    )
    environment.filters["label"] = row_label
    environment.filters["sic"] = lambda row: statistic_label(row["statistic"], row["carry"])
    page = environment.from_string(Path(__file__).with_suffix(".html").read_text("utf-8")).render(
        title=title,
        sentences=sentences,
        banks=[_bank(name, rows) for name in dict.fromkeys(row["bank"] for row in rows)],
        columns={key: column for key, column in COLUMNS.items() if key in rows[0]},
        figures=list(zip(figures, sources, strict=True)),
        tables=tables,
        below=below,
        mark=MARK,
        data=data,
        script=Markup(Path(__file__).with_suffix(".js").read_text("utf-8")),
    )
    written = write_whole(path, page.encode())
    beside.sweep()
    return written


def _bank(name: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    own = [row for row in rows if row["bank"] == name]
    return {
        "name": "Mean over banks" if name == "mean" else name or "unnamed bank",
        "rows": own,
        "costs": ", ".join(dict.fromkeys(str(row["costs"]) for row in own)),
        "frames": ", ".join(dict.fromkeys(str(row["queries"]) for row in own)),
        "marked": any(MARK in row_label(row) for row in own),
    }
