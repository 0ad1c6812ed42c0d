"""`marsarm diagnose`: what it prints and writes of a result; bad input writes nothing."""

import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from marsarm.cli.app import app
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from marsarm.diagnosis.arm.record import PARAMS_FILE
from marsarm.diagnosis.diagnose import Alternative
from marsarm.diagnosis.result import to_json, verdict_lines
from simgap.report.traces import Trace

RUN = CliRunner()
SCREEN = 30
"""Greatest number of printed lines."""


@pytest.fixture
def diagnose(tmp_path, monkeypatch):
    """Run the command with a given result, or an error."""
    (tmp_path / "a.mcap").write_text("a")
    monkeypatch.chdir(tmp_path)

    def run(result, *words):
        def stand_in(request, progress):
            if isinstance(result, Exception):
                raise result
            return result

        monkeypatch.setattr("marsarm.diagnosis.arm.diagnose_logs.diagnose_logs", stand_in)
        return RUN.invoke(app, ["diagnose", "a.mcap", *words])

    return run


def test_four_lines_are_printed(diagnose, results):
    for result in results.values():
        done = diagnose(result)
        assert done.exit_code == 0
        labels = re.findall(r"^(\w[\w ]*):", done.stdout, re.MULTILINE)
        assert labels[:4] == ["Where", "What", "How far", "Next"]
        printed = " ".join(done.stdout.split())
        assert all(" ".join(text.split()) in printed for _, text in verdict_lines(result))
        assert len(done.stdout.splitlines()) <= SCREEN


def test_three_effects_with_many_alternatives_fit_on_a_screen(diagnose, results):
    result = results["alike"]
    (finding,) = result.diagnosis.findings
    many = tuple(Alternative(h, 0.06) for h in range(4, 16))
    coarse = replace(
        finding, alternatives=many, equivalence_class=tuple(range(8)), level="family", effects=()
    )
    said = replace(result.diagnosis, findings=(coarse,) * 3)
    done = diagnose(replace(result, diagnosis=said))
    assert done.exit_code == 0
    assert "the best of 12 effects is" in " ".join(done.stdout.split())
    assert len(done.stdout.splitlines()) <= SCREEN


@pytest.mark.parametrize(
    ("level", "said"),
    [
        ("size", "All other effects in it are excluded at 95 %"),
        ("family", "it is of the family"),
        ("place", "may be outside the catalogue. In these motions it acts like"),
        ("unlocated", "A cause is not located: "),
    ],
)
def test_each_level_has_its_sentence(diagnose, results, level, said):
    result = results["named"]
    coarse = tuple(replace(one, level=level) for one in result.diagnosis.findings)
    done = diagnose(replace(result, diagnosis=replace(result.diagnosis, findings=coarse)))
    assert said in " ".join(done.stdout.split())


def test_a_motion_is_advised_only_if_it_would_distinguish_effects(diagnose, results):
    result = results["alike"]
    best = replace(result.next_motion[0], separation=3.0)
    for separation, advised in ((3.0, True), (1e-5, False)):
        shown = replace(result, next_motion=(replace(best, separation=separation),))
        printed = " ".join(diagnose(shown).stdout.split())
        assert (f"Next: Record {best.name}: " in printed) == advised
        assert ("No motion of this campaign would distinguish" in printed) != advised


def test_the_document_is_the_json_output(diagnose, results):
    done = diagnose(results["undecided"], "--json")
    assert json.loads(done.stdout) == to_json(results["undecided"])


def test_the_page_is_one_file_with_the_verdict_on_top(diagnose, results, tmp_path):
    (tmp_path / PARAMS_FILE).write_text("")  # parameters of the drawing, as the log has none
    channels = list(dict.fromkeys(cell.channel for cell in results["beside"].diagnosis.residual_map))
    time_s = np.arange(8) / 4.0
    traces = tuple(
        Trace(channel, "features", session, "A", time_s, np.sin(time_s), 0.1 * time_s, 0.01 * time_s)
        for channel in channels
        for session in ("warm", "cold")
    )
    for name, pictures, result in (
        ("beside", 3, replace(results["beside"], traces=traces)),
        ("unknown", 1, results["unknown"]),
    ):
        assert diagnose(result, "--report", f"{name}.html").exit_code == 0
        page = (tmp_path / f"{name}.html").read_text()
        lines = "\n".join(f"{label}: {text}" for label, text in verdict_lines(result))
        assert re.search(rf'</h1>\n<p class="verdict \w+">{re.escape(html.escape(lines))}</p>', page)
        assert page.count("<svg ") == pictures
        assert "<code>marsarm diagnose a.mcap</code>" in page
    page = (tmp_path / "beside.html").read_text()
    assert "may be outside the catalogue" in page
    assert page.count('<figure class="traces"') == 3
    assert all(f"<h3>{channel}</h3>" in page for channel in channels[:3])
    motions = json.loads(re.findall(r'<script type="application/json">(.*?)</script>', page)[0])
    assert [sorted(panel["series"]) for panel in motions[0]["panels"]] == [
        ["explained", "measured", "nominal"],
        ["explained", "nominal"],
    ]


def test_a_patch_without_content_is_not_written(diagnose, results, tmp_path):
    done = diagnose(results["unknown"], "--patch", "found.toml")
    assert done.exit_code == 0
    assert "patch found.toml: not written: the verdict is unknown" in done.stderr
    assert not (tmp_path / "found.toml").exists()


def test_a_log_that_cannot_be_diagnosed_ends_with_2_and_writes_nothing(diagnose, tmp_path):
    done = diagnose(NotForDiagnosis("log a.mcap: has no /drive"), "--report", "gap.html")
    assert done.exit_code == 2
    assert done.stderr == "log a.mcap: has no /drive\n"
    assert not (tmp_path / "gap.html").exists()
