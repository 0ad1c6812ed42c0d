"""The page of a report: verdict first, then its origin; the same bytes for the same result."""

import re
from pathlib import Path

import pytest

from marsarm.accuracy.request import BudgetRequest, MonteCarloRequest
from marsarm.common.options import CalibrateRequest
from marsarm.diagnosis.arm.request import DiagnoseRequest
from marsarm.render import svg
from simgap.common.options import command_text
from simgap.common.page import Origin, Requirement, figures, heading, paragraph, save_page, table
from tests.marsarm.command import marsarm

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
