"""Pages of reports: verdict first, the same bytes, no horizontal scroll, figures and colours for all."""

import re
from importlib.resources import files
from pathlib import Path

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
from marsarm.diagnosis.arm.request import DiagnoseRequest
from marsarm.render import svg
from marsarm.view.scene import CURVE_COLOURS, DARK_CURVE_COLOURS
from simgap.common.options import command_text
from simgap.common.page import Origin, Requirement, figures, heading, paragraph, save_page, table
from simgap.common.report import save_report_page
from tests.marsarm.calibration.lab import campaign
from tests.marsarm.command import marsarm
from validation.browser import CONTRAST, LEAST_CONTRAST, LOADED

MET = Requirement("total position", "± 20 mm", "± 10 mm", True)
NOT_MET = Requirement("lateral position", "± 15 mm", "± 21.9 mm", False)
OPEN = Requirement("verified", "-", "-", None)
ORIGIN = Origin("marsarm budget --case mars", {"result": "ab" * 32})


@pytest.fixture
def page(tmp_path, monkeypatch):
    """Return a function that writes a page and returns its text."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")

    def write(*requirements, verdict="", parts=()):
        path = tmp_path / "page.html"
        save_page("A <title>", verdict, requirements, ORIGIN, parts, path)
        return path.read_text()

    return write


def drawn(figure):
    figure.subplots().plot([0, 1], [0, 1], "o-", color=svg.BLUE)


def test_the_verdict_stands_before_everything_else_and_its_origin_follows(page):
    text = page(MET, NOT_MET, OPEN, parts=[heading("More")])
    body = text[text.index("<body>") :]
    found = [
        body.index(words)
        for words in (
            "<h1>A &lt;title&gt;</h1>",
            "Fail: 1 of 3 requirements are not met, 1 is not shown.",
            "± 20 mm",
            "<dt>version</dt>",
            "marsarm budget --case mars",
            "1970-01-02 00:00:00 UTC",
            "ab" * 32,
            "<h2>More</h2>",
        )
    ]
    assert found == sorted(found)


@pytest.mark.parametrize(
    ("requirements", "sentence"),
    [
        ((MET, MET), "Pass: 2 of 2 requirements are met."),
        ((MET, OPEN), "Not shown: 1 of 2 requirements are met, 1 is not shown."),
        ((OPEN,), "Not shown: 0 of 1 requirements are met, 1 is not shown."),
    ],
)
def test_the_verdict_counts_requirements(page, requirements, sentence):
    assert f">{sentence}</p>" in page(*requirements)


def test_words_and_not_colours_alone_say_what_passed(page):
    cells = re.findall(r'<td class="(\w+)">([^<]+)</td></tr>', page(MET, NOT_MET, OPEN))
    assert cells == [("pass", "pass"), ("fail", "FAIL"), ("open", "not shown")]


def test_a_result_gives_the_same_bytes_but_for_the_date(page, monkeypatch):
    def write():
        return page(MET, parts=[figures(svg.render_svg("a line", 2.0, drawn))])

    first = write()
    assert write() == first
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert write() == first.replace("1970-01-02", "1970-01-01")


def test_a_command_refuses_a_wrong_date_before_it_works(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    done = marsarm(tmp_path, "budget", "--report", "page.html")
    assert done.returncode == 2
    assert done.stderr.strip() == (
        "SOURCE_DATE_EPOCH: 'yesterday' is not a date; give whole seconds since 1970, or unset it"
    )
    assert not list(tmp_path.iterdir())


def test_a_figure_takes_every_colour_of_its_text_and_axes_from_the_page():
    text = svg.render_svg("a line & more", 2.0, drawn)
    assert 'aria-label="a line &amp; more"' in text
    assert "var(--blue)" in text
    assert "var(--ink)" in text
    assert set(re.findall(r"#[0-9a-f]{6}\b", text)) == set()
    assert not re.search(r"<g id=|<metadata|<image|<\?xml|<svg[^>]* width=", text)


def test_text_cannot_break_out_of_the_page(page):
    evil = "</main><script>alert(1)</script>"
    text = page(
        Requirement(evil, evil, evil, True), verdict=evil, parts=[paragraph(evil), table((evil,), [(evil,)])]
    )
    assert "<script" not in text


@pytest.mark.parametrize(
    ("verb", "request_", "words"),
    [
        ("budget", BudgetRequest(), ""),
        (
            "budget",
            BudgetRequest(case="mars", mismatch=True, report=Path("a.html")),
            "--case mars --mismatch",
        ),
        (
            "monte-carlo",
            MonteCarloRequest(built="as-built", arms=3, move_model="statics"),
            "--built as-built --arms 3 --move-model statics",
        ),
        (
            "calibrate",
            CalibrateRequest(arm="as-built:7", tracker_um=(1.0, 2.0), out=Path("arm 7.toml")),
            "--arm as-built:7 --tracker 1.0 2.0",
        ),
        (
            "diagnose",
            DiagnoseRequest((Path("my logs"),), (Path("a"), Path("b")), effects=("warming:all",)),
            "'my logs' --held-out a --held-out b --effect warming:all",
        ),
    ],
)
def test_the_command_has_what_differs_from_defaults_but_no_output_files(verb, request_, words):
    assert command_text(f"marsarm {verb}", request_) == f"marsarm {verb} {words}".strip()


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
def report(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / f"{request.param.__name__}.html"
    request.param(path)
    return path


def test_a_report_fits_every_screen_by_its_structure(report):
    text = report.read_text()
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    assert '<meta name="color-scheme" content="light dark">' in text
    assert "@media (prefers-color-scheme: dark)" in text
    assert "main { max-width:" in text
    assert text.count("<table>") == text.count('<div class="scroll" tabindex="0"><table>') > 1
    assert not re.search(r'<(?:svg|div|table)[^>]*\swidth=|style="[^"]*(?<![-\w])width:', text)


def test_a_report_holds_vector_figures_and_asks_for_nothing(report):
    text = report.read_text()
    assert text.count("<svg ") == text.count("<figure>") > 0
    assert not re.search(r"<img|<image|data:image|<script|<link|url\(['\"]?http|src=", text)


def test_a_report_never_scrolls_sideways_and_is_readable_in_a_browser(browser, report):
    papers = set()
    for width in WIDTHS:
        for dark in (False, True):
            browser.open(report.as_uri(), width, 900, dark, LOADED)
            assert browser.evaluate("innerWidth") == width
            assert browser.evaluate("document.documentElement.scrollWidth") == width
            if width >= PHONE:
                assert browser.evaluate(VERDICTS_SHOWN)
            assert browser.evaluate(CONTRAST) >= LEAST_CONTRAST
            papers.add((dark, browser.evaluate("getComputedStyle(document.body).backgroundColor")))
    assert len(papers) == 2
    assert browser.requests.count(report.as_uri()) == len(browser.requests) == 2 * len(WIDTHS)
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
