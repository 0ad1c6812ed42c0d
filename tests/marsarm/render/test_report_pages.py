"""Every report: no horizontal scroll on a phone or a desk, light or dark, and figures that are no bitmaps."""

import re

import pytest

from helpers.marks import slow_but
from marsarm.accuracy.budget import run_budget
from marsarm.accuracy.budget_report import budget_page
from marsarm.accuracy.monte_carlo import run_monte_carlo
from marsarm.accuracy.monte_carlo_report import monte_carlo_page
from marsarm.accuracy.request import BudgetRequest, MonteCarloRequest
from marsarm.calibration.campaign_data import save_campaign
from marsarm.calibration.execution import run_calibration
from marsarm.calibration.report import calibration_page
from marsarm.common.options import CalibrateRequest
from simgap.common.report import save_report_page
from tests.marsarm.calibration.lab import campaign
from validation.browser import CONTRAST, LEAST_CONTRAST, LOADED

PHONE = 400
WIDTHS = (320, PHONE, 1400)

VERDICTS_SHOWN = (
    "(({scrollWidth, clientWidth}) => scrollWidth <= clientWidth)(document.querySelector('.scroll'))"
)
"""True if the whole table of requirements is seen without scrolling."""


def save_budget(path):
    save_report_page(budget_page(run_budget(BudgetRequest(case="accuracy", poses=100))), path)


def save_monte_carlo(path):
    request = MonteCarloRequest(
        "mars", "calibrated", arms=2, places=2, move_model="statics", seed=1, workers=1
    )
    save_report_page(monte_carlo_page(run_monte_carlo(request)), path)


def save_calibration(path):
    poses = path.with_suffix(".parquet")
    save_campaign(campaign(), poses)
    save_report_page(calibration_page(run_calibration(CalibrateRequest(data=poses))), path)


SAVERS = (save_budget, save_monte_carlo, save_calibration)


@pytest.fixture(scope="module", params=slow_but(SAVERS, save_budget))
def page(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / f"{request.param.__name__}.html"
    request.param(path)
    return path


def test_a_report_fits_every_screen_by_its_structure(page):
    text = page.read_text()
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    assert '<meta name="color-scheme" content="light dark">' in text
    assert "@media (prefers-color-scheme: dark)" in text
    assert "main { max-width:" in text
    assert text.count("<table>") == text.count('<div class="scroll" tabindex="0"><table>') > 1
    assert not re.search(r'<(?:svg|div|table)[^>]*\swidth=|style="[^"]*(?<![-\w])width:', text)


def test_a_report_holds_vector_figures_and_asks_for_nothing(page):
    text = page.read_text()
    assert text.count("<svg ") == text.count("<figure>") > 0
    assert not re.search(r"<img|<image|data:image|<script|<link|url\(['\"]?http|src=", text)


def test_a_report_never_scrolls_sideways_and_is_readable_in_a_browser(browser, page):
    papers = set()
    for width in WIDTHS:
        for dark in (False, True):
            browser.open(page.as_uri(), width, 900, dark, LOADED)
            assert browser.evaluate("innerWidth") == width
            assert browser.evaluate("document.documentElement.scrollWidth") == width
            if width >= PHONE:
                assert browser.evaluate(VERDICTS_SHOWN)
            assert browser.evaluate(CONTRAST) >= LEAST_CONTRAST
            papers.add((dark, browser.evaluate("getComputedStyle(document.body).backgroundColor")))
    assert len(papers) == 2
    assert browser.requests.count(page.as_uri()) == len(browser.requests) == 2 * len(WIDTHS)
    assert not browser.problems
