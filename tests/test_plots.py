"""Figures and the page: drawn whole, right in what can be read off them, without global state."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation import metrics, plots
from amusic_gym.evaluation.plots import drawing as drawing_module
from amusic_gym.evaluation.plots import labels, tradeoff
from amusic_gym.evaluation.report import ReportFigure, write_report
from amusic_gym.policies.registry import parse, policies
from amusic_gym.policies.trace import Trace
from amusic_gym.utils import colours

pytestmark = pytest.mark.slow

NAMES = ("HOG", "CALC", "CoHOG", "$odd_name$")


def made_up(policy: str, *, seed: int = 0, weight: float | None = None, bank: str = "b") -> Trace:
    """A policy that is right four times in five, and surer when it is."""
    rng = np.random.default_rng(seed)
    frames = 60
    centres = np.arange(frames)
    centres[40:45] = -1
    scores = rng.normal(size=(len(NAMES), frames, frames))
    held = ScoreBank(
        scores, NAMES, [0.05, 0.2, 0.7, 0.8], tolerance=1, ground_truth=centres, name=bank
    )
    right = rng.random(frames) < 0.8
    ran = np.zeros((frames, len(NAMES)), bool)
    ran[:10] = True
    ran[10:, 2] = True
    late_runs = np.zeros((frames, len(NAMES)), int)
    late_runs[30] = [10, 10, 0, 10]
    return Trace.join(
        held,
        predictions=np.where(right, np.arange(frames), 0),
        confidence=right + rng.normal(size=frames),
        similarity=np.zeros(frames),
        p_correct=np.clip(0.7 * right + 0.3 * rng.random(frames), 0, 1),
        chosen=np.where(np.arange(frames) < 3, -1, rng.integers(0, 3, frames)),
        ran=ran,
        late_runs=late_runs,
        selections=np.isin(np.arange(frames), [10, 30]),
        policy=policy,
        statistic="evidence",
        compute_weight=weight,
    )


def some_rows() -> list[dict[str, Any]]:
    base = metrics.summarise(made_up("music"))
    policies = [
        ("music", None, 1.0, 0.9),
        ("amusic", None, 0.8, 0.85),
        ("amusic:evidence", None, 0.5, 0.9),
        ("single:HOG", None, 0.02, 0.4),
        ("single:CALC", None, 0.1, 0.3),
        ("subset:HOG+CALC", None, 0.12, 0.6),
        ("random:0.5", None, 0.5, 0.5),
        ("raw:HOG", None, 0.02, 0.1),
        ("ppo:runs/a", 0.1, 0.3, 0.88),
        ("ppo:runs/a", 1.0, 0.05, 0.7),
        ("ppo:runs/a", 10.0, 0.0, 0.2),
    ]
    return [
        {**base, "policy": p, "compute_weight": w, "compute": c, "auc": a}
        for p, w, c, a in policies
    ]


def png_size(path: Path) -> tuple[int, int]:
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    assert content.endswith(b"IEND\xaeB`\x82")
    width, height = struct.unpack(">II", content[16:24])
    return width, height


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures as they were when written, to read their texts and lines."""
    kept: list[Figure] = []
    original = drawing_module.figure_at

    @contextmanager
    def keeping(path: Path, width: float, height: float) -> Iterator[Figure]:
        with original(path, width, height) as figure:
            kept.append(figure)
            yield figure

    for module in ("curves", "route", "tradeoff"):
        monkeypatch.setattr(f"amusic_gym.evaluation.plots.{module}.figure_at", keeping)
    return kept


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(matplotlib.text.Text) if text.get_text()]


def test_every_figure_is_a_whole_png_and_nothing_global_changes(tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    traces = [made_up("amusic"), made_up("raw:HOG"), made_up("ppo", weight=0.1, seed=1)]
    paths = [
        plots.precision_recall(traces, tmp_path / "new" / "pr.png"),
        plots.front(some_rows(), tmp_path / "front.png"),
        plots.selections(traces, tmp_path / "selections.png"),
        plots.shares([made_up("music"), made_up("music", bank="c")], tmp_path / "shares.png"),
        plots.reliability({"all": traces}, tmp_path / "reliability.png"),
    ]
    for path in paths:
        assert min(png_size(path)) > 200
    assert dict(matplotlib.rcParams) == before
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_file()) == [
        "front.png", "reliability.png", "selections.png", "shares.png",
    ]  # fmt: skip


def test_drawing_imports_no_pyplot_and_importing_plots_no_matplotlib(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom amusic_gym.evaluation import plots\n"
        "assert 'matplotlib' not in sys.modules\n"
        "rows = [dict(bank='b', costs='runs', policy='music', compute_weight=None,"
        " compute=1.0, auc=0.5)]\n"
        f"plots.front(rows, {str(tmp_path / 'f.png')!r})\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_a_user_style_does_not_change_a_figure(tmp_path: Path) -> None:
    plain = plots.front(some_rows(), tmp_path / "plain.png").read_bytes()
    with matplotlib.rc_context({"lines.linewidth": 9, "axes.facecolor": "black"}):
        assert plots.front(some_rows(), tmp_path / "styled.png").read_bytes() == plain


def test_curves_are_listed_by_auc_with_their_numbers(tmp_path: Path, drawn: list[Figure]) -> None:
    traces = [made_up("raw:HOG", seed=2), made_up("amusic"), made_up("ppo", seed=1, weight=0.1)]
    plots.precision_recall(traces, tmp_path / "pr.png")
    listed = [t.get_text() for t in drawn[0].legends[0].get_texts()]
    expected = sorted((-metrics.auc(t), labels.trace_label(t)) for t in traces)
    assert listed == [f"{-area:.3f}  {name}" for area, name in expected]


def test_curves_fill_the_axes_and_those_of_a_selector_differ(
    tmp_path: Path, drawn: list[Figure]
) -> None:
    good = [made_up("ppo", seed=seed, weight=0.1 * seed) for seed in (1, 2, 3)]
    lost = {"correct": np.arange(60) < 6}
    bad = Trace(**{**vars(made_up("music")), **lost})
    plots.precision_recall(good, tmp_path / "a.png")
    plots.precision_recall([*good, bad], tmp_path / "b.png")
    plots.precision_recall([bad], tmp_path / "c.png")
    least = []
    for trace in good:
        precision, recall = metrics.curve(trace)
        least.append(precision[recall >= 0.1].min())
    low, high = drawn[0].axes[0].get_ylim()
    assert 0.5 < min(least) - 0.03 < low < min(least)
    assert 1.0 < high < 1.03
    assert drawn[1].axes[0].get_ylim() == (low, high)  # the bad one may leave the axes
    assert drawn[2].axes[0].get_ylim()[0] == 0
    lines = drawn[0].axes[0].get_lines()
    looks = {(line.get_color(), str(line._unscaled_dash_pattern)) for line in lines}
    assert len(looks) == len({dashes for _, dashes in looks}) == 3


def test_front_names_the_best_subsets_and_every_weight(tmp_path: Path, drawn: list[Figure]) -> None:
    plots.front(some_rows(), tmp_path / "front.png")
    seen = texts(drawn[0])
    for name in ("HOG", "HOG+CALC", "A-MuSIC", "A-MuSIC (evidence)", "MuSIC", "random, p = 0.5"):
        assert name in seen, name
    for weight in ("λ 0.1", "λ 1", "λ 10"):
        assert weight in seen, weight
    assert "CALC" not in seen  # HOG is cheaper and better
    assert "HOG, no SIC" not in seen
    assert any("measured costs" in text for text in seen)


def test_front_labels_do_not_cover_each_other(tmp_path: Path, drawn: list[Figure]) -> None:
    crowd = [
        {**some_rows()[0], "policy": f"subset:T{i}", "compute": 0.5 + i / 90, "auc": 0.8 + i / 90}
        for i in range(8)
    ]
    plots.front(some_rows() + crowd, tmp_path / "front.png")
    notes = drawn[0].axes[0].texts
    boxes = [matplotlib.text.Text.get_window_extent(note) for note in notes]
    assert len(boxes) >= 10
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i]), notes[i].get_text()


def test_pareto_keeps_what_nothing_cheaper_reaches() -> None:
    points = [(0.5, 0.6), (0.1, 0.5), (0.1, 0.4), (0.2, 0.5), (0.9, 0.7), (1.0, 0.65)]
    rows = [{"compute": compute, "auc": auc} for compute, auc in points]
    assert tradeoff.pareto(rows) == [rows[1], rows[0], rows[4]]


def test_selections_show_runs_late_runs_and_selections(tmp_path: Path, drawn: list[Figure]) -> None:
    trace = made_up("amusic")
    plots.selections([trace], tmp_path / "s.png")
    axes = drawn[0].axes[0]
    lines = [c for c in axes.collections if hasattr(c, "get_segments")]
    assert [segment[0][0] for segment in lines[-1].get_segments()] == [9.5, 29.5]
    hatched = [c for c in axes.collections if c.get_hatch()]
    spans = [
        (p.vertices[:, 0].min(), p.vertices[:, 0].max()) for c in hatched for p in c.get_paths()
    ]
    assert spans == [(19.5, 29.5)] * 3
    seen = texts(drawn[0])
    assert "17%" in seen  # HOG ran on 10 of 60 frames
    assert "no true place" in seen
    assert any("re-selections 1" in text for text in seen)


def test_shares_add_up_to_one_in_the_techniques_colours(
    tmp_path: Path, drawn: list[Figure]
) -> None:
    trace = made_up("music")
    plots.shares([trace], tmp_path / "shares.png")
    bars = drawn[0].axes[0].containers
    widths = [bar.patches[0].get_width() for bar in bars]
    assert sum(widths) == pytest.approx(1.0)
    assert widths[0] == pytest.approx((trace.chosen == 0).mean())
    assert widths[-1] == pytest.approx(3 / 60)
    colour = matplotlib.colors.to_hex(bars[0].patches[0].get_facecolor())
    assert colour.upper() == colours.technique_colours(NAMES)["HOG"]


def test_colours_are_steady_and_distinct() -> None:
    assert colours.technique_colours(["CALC"])["CALC"] == colours.technique_colours(NAMES)["CALC"]
    many = colours.technique_colours([f"T{i}" for i in range(16)])
    assert len(set(many.values())) == 16
    used = {policy.colour for policy in policies().values()}
    assert not (used | set(labels.SWEEP_COLOURS)) & set(colours.TECHNIQUE_COLOURS)


@pytest.mark.parametrize(
    ("policy", "name"),
    [
        ("amusic", "A-MuSIC"),
        ("amusic:evidence", "A-MuSIC (evidence)"),
        ("music", "MuSIC"),
        ("single:HOG", "HOG"),
        ("subset:HOG+CALC", "HOG+CALC"),
        ("raw:HOG", "HOG, no SIC"),
        ("random:0.5", "random, p = 0.5"),
        ("random:0.5/idle", "random, p = 0.5, may idle"),
        ("periodic:1", "all every frame"),
        ("periodic:5", "all every 5 frames"),
        ("periodic:5/HOG+CALC", "HOG+CALC every 5 frames"),
        ("periodic:5/CALC/HOG", "CALC every 5 frames, else HOG"),
        ("periodic:5/CALC/idle", "CALC every 5 frames, else idle"),
        ("voi", "value of information"),
        ("voi:idle", "value of information, may idle"),
        ("voi:0.2", "value of information, fixed λ 0.2"),
        ("voi:0.2/idle", "value of information, fixed λ 0.2, may idle"),
        ("cascade", "cascade"),
        ("ppo", "selector (ppo)"),
        ("ppo:out/demo/run", "selector (ppo:run)"),
    ],
)
def test_policies_have_names_for_readers(policy: str, name: str) -> None:
    assert labels.policy_label(policy) == name


def test_the_legend_of_a_front_is_within_the_figure(tmp_path: Path, drawn: list[Figure]) -> None:
    rows = some_rows()
    long = ("voi", "voi:idle", "ppo:runs/imitation_with_a_name_that_is_long")
    rows += [{**row, "policy": name} for name in long for row in rows[-3:]]
    for shown in (some_rows(), rows):
        plots.front(shown, tmp_path / "front.png")
        (legend,) = drawn[-1].legends
        box, page = legend.get_window_extent(), drawn[-1].bbox
        assert page.x0 <= box.x0
        assert box.x1 <= page.x1
        assert page.y0 <= box.y0


@pytest.mark.parametrize("kind", ["random:0.5", "periodic:5/HOG", "voi:0.2"])
def test_what_may_idle_is_drawn_as_a_variant(kind: str) -> None:
    assert parse(f"{kind}/idle").is_variant
    assert not parse(kind).is_variant
    assert parse("voi:idle").is_variant
    assert not parse("single:idle").is_variant
    assert parse(f"{kind}/idle").policy is parse(kind).policy


def test_odd_names_are_drawn_as_they_are(tmp_path: Path, drawn: list[Figure]) -> None:
    plots.shares([made_up("music", bank="_路線 $x^2$")], tmp_path / "shares.png")
    assert "_路線 $x^2$" in texts(drawn[0])


def test_nothing_right_and_nothing_estimated(tmp_path: Path) -> None:
    trace = made_up("music")
    nothing = {"correct": np.zeros(60, bool), "p_correct": np.full(60, np.nan)}
    hopeless = Trace(**{**vars(trace), **nothing})
    plots.precision_recall([hopeless], tmp_path / "pr.png")
    plots.selections([hopeless], tmp_path / "s.png")
    with pytest.raises(ValueError, match="give traces with p_correct"):
        plots.reliability({"a": [trace], "b": [hopeless]}, tmp_path / "r.png")
    assert not (tmp_path / "r.png").exists()


def test_reliability_shows_every_bin_that_has_frames(tmp_path: Path, drawn: list[Figure]) -> None:
    def told(p_correct: list[float], right: list[int]) -> Trace:
        estimates, correct = np.full(60, np.nan), np.zeros(60, bool)
        estimates[: len(right)], correct[: len(right)] = p_correct, right
        return Trace(**{**vars(made_up("music")), "correct": correct, "p_correct": estimates})

    groups = {
        "as recorded": [told([0.6] * 40, [1, 0] * 20)],
        "re-timed": [
            told([0.25] * 4, [1, 0, 0, 0]),
            told([0.25] * 4 + [0.75] * 36, [0] * 4 + [1] * 36),
        ],
    }
    plots.reliability(groups, tmp_path / "r.png", bins=2)
    upper, lower = drawn[0].axes
    lines = [[line.get_xdata().tolist(), line.get_ydata().tolist()] for line in upper.lines]
    assert lines[1][0] == [pytest.approx(0.6)]
    assert [lines[1][1], *lines[2:5]] == [
        [0.5],
        [[], []],
        [[0.25, 0.75], [0.125, 1.0]],
        [[0.25], [0.125]],
    ]
    assert [bar.get_height() for bar in lower.patches] == [0, 40, 8, 36]
    assert [text.get_text() for text in lower.texts] == ["", "40", "8", "36"]
    quality = "AUROC 0.986  ·  Brier 0.074  ·  calibration error 0.227  ·  44 frames"
    assert f"re-timed: {quality}" in texts(drawn[0])


@pytest.mark.parametrize("draw", [plots.precision_recall, plots.selections])
def test_a_figure_holds_one_bank(draw: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="one bank per figure, but the traces hold b, c"):
        draw([made_up("music"), made_up("music", bank="c")], tmp_path / "f.png")
    with pytest.raises(ValueError, match="hold none"):
        draw([], tmp_path / "f.png")


def test_front_refuses_to_mix_cost_models(tmp_path: Path) -> None:
    rows = some_rows()
    with pytest.raises(ValueError, match="one cost model per figure"):
        plots.front([rows[0], {**rows[1], "costs": "paper"}], tmp_path / "f.png")


class Page(HTMLParser):
    """What a page loads, and its words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.opened: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.opened.append(tag)
        self.loaded += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def report(tmp_path: Path, **changes: Any) -> str:
    picture = plots.front(some_rows(), tmp_path / "front.png")
    given: dict[str, Any] = {
        "title": "A <b>title</b>",
        "sentences": ["One & all."],
        "rows": [*metrics.mean_rows(some_rows()), *some_rows()],
        "figures": [ReportFigure(picture, 'What the "compute" buys')],
    } | changes
    return write_report(tmp_path / "index.html", **given).read_text()


def test_report_is_self_contained_and_says_what_it_was_given(tmp_path: Path) -> None:
    text = report(tmp_path)
    page = Page(text)
    assert page.loaded
    assert all(address.startswith("data:") for address in page.loaded)
    assert "default-src 'none'" in text
    assert not re.search(r"@import|https?:(?!//www.w3.org/2000/svg)", text)
    assert not {"b", "iframe"} & set(page.opened)
    words = " ".join(page.words)
    for part in ("A <b>title</b>", "One & all.", "Mean over banks", "selector (ppo:a)", "A-MuSIC"):
        assert part in words, part
    assert page.opened.count("table") == 2
    assert page.opened.count("tr") == 2 * (1 + len(some_rows()))
    assert 'alt="What the &#34;compute&#34; buys"' in text


def test_report_writes_a_dash_for_no_median_error(tmp_path: Path) -> None:
    row = {**some_rows()[0], "median_error": None}
    assert "<td>–</td>" in report(tmp_path, rows=[row])


def test_report_refuses_what_it_cannot_show(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="draw it before the report"):
        report(tmp_path, figures=[ReportFigure(tmp_path / "none.png", "")])
    (tmp_path / "no.png").write_bytes(b"GIF89a")
    with pytest.raises(ValueError, match="is no PNG or JPEG file"):
        report(tmp_path, figures=[ReportFigure(tmp_path / "no.png", "")])
    with pytest.raises(ValueError, match="rows is empty"):
        report(tmp_path, rows=[])
    assert not (tmp_path / "index.html").exists()
