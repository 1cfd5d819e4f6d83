"""The page in a real browser: what it shows on hovering, and that it asks nobody for anything."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import chromium, requested

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.comparison import Comparison, compare
from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.figures import write_page
from amusic_gym.extraction import extract

pytestmark = pytest.mark.slow

FRAMES = 70  # more than a sheet holds
BLUE, GREEN = 0, 1


def colour_of(number: int, query: bool) -> tuple[int, int, int]:
    """Blue and green tell the number in steps that survive JPEG, red the traverse."""
    return 20 + 28 * (number % 8), 20 + 28 * (number // 8), 230 if query else 20


def number_in(picture: np.ndarray) -> tuple[int, bool]:
    """`colour_of` backwards, from a screenshot."""
    blue, green, red = np.median(picture[4:-4, 4:-4].reshape(-1, 3), axis=0)
    return round((blue - 20) / 28) + 8 * round((green - 20) / 28), bool(red > 125)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Comparison]:
    """The page of a comparison on two banks of plain images."""
    folder = tmp_path_factory.mktemp("page")
    for name in ("reference", "query"):
        (folder / name).mkdir()
        for at in range(FRAMES):
            image = np.full((48, 64, 3), colour_of(at, name == "query"), np.uint8)
            image[at % 40 : at % 40 + 3, :2] = 255 - image[0, 0]  # for HOG, at the edge
            cv2.imwrite(str(folder / name / f"{at:02}.png"), image)
    banks = []
    for name in ("first", "<b>second"):
        extracted = extract(
            *(folder / "reference", folder / "query", "hog"),
            tolerance=1,
            seconds={"HOG": 0.01},
            cache=folder / "cache",
            out=folder / "banks" / str(len(banks)),
        )
        scores = np.random.default_rng(len(banks)).normal(size=(3, FRAMES, FRAMES))
        scores[0, range(FRAMES), range(FRAMES)] += 1.5
        scores[2, range(FRAMES), range(FRAMES)] += 4
        bank = ScoreBank(scores, ["A", "B", "C"], [1, 2, 4], tolerance=1, name=name)
        bank.path = extracted.path  # scores that fail now and then, on these images
        banks.append(bank)
    specs = ["single:A", "raw:A", "music", "amusic", "random:0.3", "oracle", "voi"]
    policies = contestants(specs, compute_weights=(0.1, 2.0))
    result = compare(banks, lambda bank: policies, folder / "out", report=len)
    return write_page(result, folder / "out"), result


@pytest.fixture(scope="module")
def open_page(made: tuple[Path, Comparison]) -> Iterator[Any]:
    with chromium() as browser:
        browser.get(made[0].as_uri())
        yield browser


def pictured(browser: Any, figure: str) -> tuple[int, bool]:
    shot = browser.find_element("css selector", f"#{figure} div").screenshot_as_png
    return number_in(cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR))


def script(browser: Any, code: str, *arguments: Any) -> Any:
    return browser.execute_script(code, *arguments)


def shown(browser: Any) -> tuple[str, str, float | None]:
    """Bank, policy and λ of the drive that is shown."""
    bank, policy, weight, _ = script(browser, "return DATA.drives[state.drive]")
    return script(browser, "return DATA.banks[arguments[0]].name", bank), policy, weight


def trace_of(made: tuple[Path, Comparison], browser: Any) -> Any:
    key = shown(browser)
    return next(t for t in made[1].traces if (t.bank, t.policy, t.compute_weight) == key)


def hover(browser: Any, frame: int) -> None:
    """Move the mouse to a frame of the route."""
    from selenium.webdriver import ActionChains

    strip = browser.find_element("id", "strip")
    x = script(browser, "return xOf(arguments[0])", frame)
    width, height = strip.rect["width"], strip.rect["height"]
    actions = ActionChains(browser)
    actions.move_to_element_with_offset(strip, round(x - width / 2), round(20 - height / 2))
    actions.perform()


def test_hovering_shows_the_frame_s_pictures_and_facts(made, open_page):
    trace = trace_of(made, open_page)
    wrong = int(np.flatnonzero(~trace.correct)[0])
    for frame in (0, 49, 50, FRAMES - 1, wrong):
        hover(open_page, frame)
        assert script(open_page, "return state.frame") == frame
        place = int(trace.predictions[frame])
        assert pictured(open_page, "query") == (frame, True)
        assert pictured(open_page, "matched") == (place, False)
        assert pictured(open_page, "truth") == (int(trace.true_place[frame]), False)
        told = open_page.find_element("id", "told").text
        right = trace.correct[frame]
        assert f"place {place}: {'right' if right else 'wrong'}" in told
        ran = [name for name, on in zip(trace.techniques, trace.ran[frame], strict=True) if on]
        assert " + ".join(ran) in told
        assert f"{trace.p_correct[frame]:.2f}" in told
        assert f"{1000 * trace.seconds @ trace.runs[frame]:g} ms" in told
    assert "wrong by" in told


def test_every_point_of_the_front_shows_its_drive(made, open_page):
    dots = script(open_page, "return document.querySelectorAll('#front circle').length")
    seen = set()
    for number in range(dots):
        dot = open_page.find_elements("css selector", "#front circle")[number]
        name = dot.get_attribute("aria-label")
        script(open_page, "arguments[0].dispatchEvent(new Event('click'))", dot)
        script(open_page, "return new Promise((done) => setTimeout(done, 150))")
        bank, policy, weight = shown(open_page)
        row = next(
            row
            for row in made[1].mean
            if (row["policy"], row["compute_weight"]) == (policy, weight)
        )
        assert f"AUC {row['auc']:.3f}" in name
        seen.add((policy, weight))
        trace = trace_of(made, open_page)
        assert script(open_page, "return loaded[state.drive].at") == trace.predictions.tolist()
    assert len(seen) == dots == len(made[1].mean) - 1  # raw scores are not charted


def test_another_route_is_read_from_beside_the_page(made, open_page):
    option = open_page.find_element("css selector", "#bank option:last-child")
    assert option.text == "<b>second"
    option.click()
    script(open_page, "return new Promise((done) => setTimeout(done, 150))")
    trace = trace_of(made, open_page)
    assert trace.bank == "<b>second"
    hover(open_page, 55)
    assert pictured(open_page, "query") == (55, True)


def test_failures_only_stops_at_failures(made, open_page):
    from selenium.webdriver.common.keys import Keys

    index = script(open_page, "return DATA.drives.findIndex((each) => each[1] === 'raw:A')")
    script(open_page, "choose(arguments[0])", index)
    script(open_page, "return new Promise((done) => setTimeout(done, 150))")
    wrong = np.flatnonzero(~trace_of(made, open_page).correct).tolist()
    assert 3 < len(wrong) < FRAMES - 3
    open_page.find_element("id", "failures").click()
    slider, seen = open_page.find_element("id", "frame"), []
    slider.send_keys(Keys.HOME)
    for _ in wrong:
        seen.append(script(open_page, "return state.frame"))
        assert slider.get_attribute("aria-valuetext").startswith(f"Frame {seen[-1]}, Matched")
        slider.send_keys(Keys.ARROW_RIGHT)
    open_page.find_element("id", "failures").click()
    assert seen == wrong


def test_tables_sort_and_are_saved_as_csv(made, open_page):
    table = open_page.find_element("tag name", "table")
    button = next(b for b in table.find_elements("css selector", "th button") if b.text == "AUC")

    def aucs() -> list[str]:
        cells = "[...arguments[0].tBodies[0].rows].map((row) => row.cells[3].innerText)"
        return script(open_page, f"return {cells}", table)

    plain = sorted(f"{row['auc']:.3f}" for row in made[1].mean)
    button.click()
    assert aucs() == plain[::-1]
    button.click()
    assert aucs() == plain
    assert button.find_element("xpath", "..").get_attribute("aria-sort") == "ascending"
    text = script(
        open_page,
        "URL.createObjectURL = (blob) => { window.saved = blob; return '#'; };"
        "document.querySelector('.save').click(); return window.saved.text();",
    )
    head, *rows = csv.reader(io.StringIO(text))
    assert head[:4] == ["Policy", "λ", "SIC", "AUC"]
    assert [row[3] for row in rows] == plain


def test_nothing_leaves_the_page_and_nothing_is_wrong(made, open_page):
    asked = requested(open_page)
    folder = made[0].parent.as_uri()
    assert any(f"{folder}/index_files/" in each for each in asked)
    assert all(each.startswith((folder, "data:", "blob:")) for each in asked), asked
    assert open_page.get_log("browser") == []


@pytest.mark.parametrize("dark", [False, True])
def test_a_phone_shows_all_of_it_in_its_width(made, dark):
    with chromium(375, 812, dark) as browser:
        browser.get(made[0].as_uri())
        wide = script(
            browser,
            "return [...document.querySelectorAll('body *')]"
            ".filter((e) => !e.closest('.scroll > *') && e.getBoundingClientRect().right >"
            " document.documentElement.clientWidth + 1)"
            ".map((e) => e.outerHTML.slice(0, 80))",
        )
        assert wide == []
        assert script(browser, "return document.documentElement.scrollWidth") <= 375
        unnamed = script(
            browser,
            "return [...document.querySelectorAll('button,select,input,circle,[role=img]')]"
            ".filter((e) => !(e.ariaLabel || e.textContent || e.labels?.length))"
            ".map((e) => e.outerHTML.slice(0, 80))",
        )
        assert unnamed == []
        background = script(browser, "return getComputedStyle(document.body).backgroundColor")
        assert (background == "rgb(255, 255, 255)") != dark
        assert browser.get_log("browser") == []


def test_the_first_screen_is_there_within_a_second(made):
    assert made[0].stat().st_size < 6_000_000
    with chromium() as browser:
        ready = "return performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd"
        times = []
        for _ in range(3):  # other tests run beside
            browser.get(made[0].as_uri())
            times.append(script(browser, ready))
        assert min(times) < 1000
        assert browser.find_element("id", "front").rect["y"] < 400
        assert browser.find_element("id", "strip").rect["y"] < 800
