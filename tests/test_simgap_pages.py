"""Pages of `simgap` in a browser: they fit every width in both schemes, traces zoom and show values."""

import re

import numpy as np
import pytest

from helpers.arm_folder import write_arm
from helpers.command import run_simgap
from helpers.verdicts import FOUND, Drawn
from simgap.report.page import save_diagnosis_page
from simgap.report.traces import Trace, make_traces
from validation.browser import CONTRAST, LEAST_CONTRAST, LOADED

WIDTHS = (320, 400, 1400)
TRACKS = """
[...document.querySelectorAll(".bars figure")].map((figure) =>
  new Set([...figure.querySelectorAll(".track")].map((one) => one.getBoundingClientRect().width)).size)
"""
"""Number of different widths of the bars' tracks in each figure of errors."""


@pytest.fixture
def page(tmp_path):
    save_diagnosis_page(FOUND, make_traces(Drawn(), FOUND), tmp_path / "page.html")
    return (tmp_path / "page.html").as_uri()


@pytest.mark.parametrize("name", ["check", "diagnosis"])
def test_a_page_fits_every_width_in_both_schemes_without_an_error(browser, page, tmp_path, name):
    if name == "check":
        write_arm(tmp_path)
        words = ("check", "robot.toml", "log.parquet", "--report", "page.html")
        assert run_simgap(tmp_path, *words).returncode == 0
    for width in WIDTHS:
        for dark in (False, True):
            browser.open(page, width, 900, dark, LOADED)
            assert browser.evaluate("document.documentElement.scrollWidth") == width
            n_traces = browser.evaluate("document.querySelectorAll('.traces path.trace').length")
            assert n_traces == {"check": 10, "diagnosis": 10}[name]
            assert browser.evaluate(TRACKS) == {"check": [], "diagnosis": [1, 1]}[name]
            assert browser.evaluate(CONTRAST) >= LEAST_CONTRAST
    assert not browser.problems
    assert len(browser.requests) == 2 * len(WIDTHS)


def test_a_fast_oscillation_is_an_area_and_a_spike_is_left_out(browser, tmp_path):
    time_s = np.linspace(0.0, 10.0, 2000)
    chirp_rad, spike_rad = np.sin(6.0 * time_s**3), 0.001 * np.sin(time_s)
    spike_rad[900] = 3.0
    for measured_rad, has_area, has_mark in ((chirp_rad, True, False), (spike_rad, False, True)):
        trace = Trace("lift", "simulation", "a", "rad", time_s, measured_rad, 0 * time_s, 0 * time_s)
        save_diagnosis_page(FOUND, [trace], tmp_path / "page.html")
        browser.open((tmp_path / "page.html").as_uri(), 1400, 900, False, LOADED)
        assert browser.evaluate("Boolean(document.querySelector('path.area.measured'))") is has_area
        assert browser.evaluate("Boolean(document.querySelector('path.beyond.measured'))") is has_mark
    ticks = browser.evaluate(
        "Math.max(...[...document.querySelectorAll('.tick[text-anchor=end]')]"
        ".map((one) => Number(one.textContent)).filter(Number.isFinite))"
    )
    assert ticks < 1.0


def test_traces_zoom_and_show_values_at_the_pointer(browser, page):
    browser.open(page, 1400, 900, False, LOADED)
    browser.evaluate("window.box = document.querySelector('.traces'); window.svg = box.querySelector('svg')")

    def pointer(kind, x):
        browser.evaluate(
            "(() => { const r = svg.getBoundingClientRect(); svg.setPointerCapture = () => {};"
            f"svg.dispatchEvent(new PointerEvent('{kind}', {{clientX: r.left + {x}, clientY: r.top + 50,"
            "pointerType: 'mouse', bubbles: true})); })()"
        )

    pointer("pointermove", 300)
    readout = browser.evaluate("box.querySelector('.readout').textContent")
    assert re.match(r"\d+\.\d{3} s; measured -?\d\.\d+, model as it is -?\d", readout)
    whole = browser.evaluate("box.figure.span")
    for kind, x in (("pointerdown", 300), ("pointermove", 500), ("pointerup", 500)):
        pointer(kind, x)
    low, high = browser.evaluate("box.figure.span")
    assert whole[0] < low < high < whole[1]
    browser.evaluate("box.querySelector('button[data-zoom=\"0\"]').click()")
    assert browser.evaluate("box.figure.span") == whole
    browser.evaluate("box.querySelector('button[data-series=nominal]').click()")
    assert browser.evaluate("box.querySelectorAll('path.trace').length") == 3
    browser.evaluate("window.list = box.querySelector('select'); list.value = 1")
    browser.evaluate("list.dispatchEvent(new Event('change'))")
    assert browser.evaluate("box.figure.motion === box.figure.motions[1]")
    assert not browser.problems
