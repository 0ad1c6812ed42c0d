"""Reports: no horizontal scroll, light or dark, figures that are no bitmaps, colours that are told apart."""

import re
from importlib.resources import files

import numpy as np
import pytest

from helpers.marks import slow_but
from marsarm.accuracy.budget import run_budget
from marsarm.accuracy.budget_report import FRAME_COLOURS, budget_page
from marsarm.accuracy.monte_carlo import run_monte_carlo
from marsarm.accuracy.monte_carlo_report import monte_carlo_page
from marsarm.accuracy.request import BudgetRequest, MonteCarloRequest
from marsarm.calibration.campaign_data import save_campaign
from marsarm.calibration.execution import run_calibration
from marsarm.calibration.report import calibration_page
from marsarm.common.options import CalibrateRequest
from marsarm.view.scene import CURVE_COLOURS, DARK_CURVE_COLOURS
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


SIGHT = {
    "all cones": np.eye(3),
    "protanopia": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deuteranopia": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "tritanopia": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
"""Matrices for linear RGB: G. Machado, M. Oliveira and L. Fernandes, "A physiologically-based model for
simulation of color vision deficiency", IEEE TVCG 15 (2009), severity 1.
"""
XYZ_OF_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
JUST_NOTICEABLE = 2.3
"""Distance in CIELAB of two large patches side by side that half of the observers tell apart."""
APART = 6 * JUST_NOTICEABLE
"""For small patches and lines that are not side by side."""
SERIES_APART = 20.0
"""For thin lines that lie beside each other."""
TRACES = ("nominal", "explained")
STYLE = "".join(
    files("simgap").joinpath(name).read_text() for name in ("common/page.css", "report/figures.css")
)
SERIES = [
    tuple(re.findall(rf"--{name}: (#\w+)", STYLE)[scheme] for name in ("paper", "ink", "muted", *TRACES))
    for scheme in (0, 1)
]
"""Colours of traces and of what is behind them, in the light and the dark scheme."""


def distances(colours: tuple[str, ...], sight: np.ndarray) -> np.ndarray:
    """Return the distances in CIELAB between colours as seen, shape (n, n)."""
    srgb = np.array([[int(name[k : k + 2], 16) / 255 for k in (1, 3, 5)] for name in colours])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.transpose(sight), 0.0, 1.0) @ XYZ_OF_RGB.T / XYZ_OF_RGB.sum(axis=1)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    lab = np.column_stack([116 * f[:, 1], 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])])
    return np.linalg.norm(lab[:, None] - lab, axis=-1)


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize(
    ("colours", "least"),
    [
        *((one, APART) for one in (FRAME_COLOURS, CURVE_COLOURS, DARK_CURVE_COLOURS)),
        *((one, SERIES_APART) for one in SERIES),
    ],
    ids=["frames", "curves", "dark curves", "traces", "dark traces"],
)
def test_colours_are_told_apart(colours, least, sight):
    apart = distances(colours, SIGHT[sight])
    assert apart[np.triu_indices(len(colours), 1)].min() > least
