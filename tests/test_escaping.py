"""Names as each medium shows them: terminal, Markdown, CSV, and the names of files."""

from __future__ import annotations

import csv
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from amusic_gym.evaluation.tables import Table
from amusic_gym.utils.escaping import CsvWriter, for_csv, for_markdown, for_terminal
from amusic_gym.utils.names import file_stem


@given(st.text())
def test_a_terminal_gets_no_control_character(text):
    shown = for_terminal(text)
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in shown if c not in "\n\t")
    assert "\u202e" not in shown
    if text.isprintable():
        assert shown == text.replace("\ufeff", "\\ufeff")


def test_an_escape_sequence_is_shown():
    assert for_terminal("\x1b[2J\x9b31mHOG\r\u202e") == r"\x1b[2J\x9b31mHOG\r\u202e"


def test_markdown_holds_no_html_and_no_further_cell():
    table = Table("<b>", ["a|b"], [["<script>alert(1)</script>"], ["[x](javascript:1) `c`\ny"]])
    shown = table.markdown()
    assert shown.splitlines()[0] == "### &lt;b>"
    assert shown.splitlines()[2:] == [
        r"| a\|b |",
        "| :-- |",
        "| &lt;script>alert(1)&lt;/script> |",
        r"| \[x](javascript:1) \`c\` y |",
    ]
    assert for_markdown("ppo@belief † λ 0.3") == "ppo@belief † λ 0.3"


@pytest.mark.parametrize("text", ["=1+1", "@SUM(A1)", "+cmd", "-2+3", "-", "=", "-1-1"])
def test_a_spreadsheet_computes_no_name(text):
    assert for_csv(text) == f"'{text}"


@pytest.mark.parametrize("cell", ["-1.5", "+2", "-inf", "-1e-05", -3, 2.5, "", "HOG+CALC", None])
def test_numbers_and_plain_names_stay(cell):
    assert for_csv(cell) == cell


def test_each_cell_of_a_table_is_escaped():
    file = io.StringIO()
    writer = CsvWriter(file)
    writer.writerow(["=a", -1.5])
    writer.writerows([["b,c", "\x1b"], ["", "-2"]])
    assert list(csv.reader(io.StringIO(file.getvalue()))) == [
        ["'=a", "-1.5"],
        ["b,c", r"\x1b"],
        ["", "-2"],
    ]


@given(st.text(min_size=1, max_size=200))
def test_a_name_is_short_enough_for_a_file_whatever_its_script(name):
    stem = file_stem(name)
    assert 0 < len(stem.encode()) <= 80
    assert stem.isprintable()


def test_names_in_other_scripts_keep_both_ends():
    assert file_stem("北" * 80 + "night") == "北" * 13 + "__" + "北" * 11 + "night"
    assert file_stem("night 1") == "night_1"
