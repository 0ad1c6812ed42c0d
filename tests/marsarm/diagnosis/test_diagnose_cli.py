"""`marsarm diagnose`: what it prints and writes of a diagnosis; bad input writes nothing."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from marsarm.cli.app import app
from marsarm.diagnosis.arm.case import CaseDiagnosis
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from marsarm.diagnosis.arm.record import PARAMS_FILE
from simgap import Trace, to_document, verdict_lines

RUN = CliRunner()
SCREEN = 30
"""Greatest number of printed lines."""


@pytest.fixture
def diagnose(tmp_path, monkeypatch):
    """Run the command with a given diagnosis, or an error."""
    (tmp_path / "a.mcap").write_text("a")
    monkeypatch.chdir(tmp_path)

    def run(result, *words, traces=()):
        def stand_in(request, progress):
            if isinstance(result, Exception):
                raise result
            return CaseDiagnosis(result, traces)

        monkeypatch.setattr("marsarm.diagnosis.arm.diagnose_logs.diagnose_logs", stand_in)
        return RUN.invoke(app, ["diagnose", "a.mcap", *words])

    return run


def test_four_lines_are_printed(diagnose, results):
    for result in results.values():
        done = diagnose(result)
        assert done.exit_code == 0
        printed = " ".join(done.stdout.split())
        assert printed.startswith(" ".join(" ".join(verdict_lines(result)).split()))
        assert len(done.stdout.splitlines()) <= SCREEN


def test_the_document_is_the_json_output(diagnose, results):
    done = diagnose(results["undecided"], "--json")
    assert json.loads(done.stdout) == to_document(results["undecided"])


def test_the_page_is_one_file_with_the_traces_of_features(diagnose, results, tmp_path):
    (tmp_path / PARAMS_FILE).write_text("")  # parameters of the drawing, as the log has none
    time_s = np.arange(8) / 4.0
    traces = tuple(
        Trace(channel, "features", session, "A", time_s, np.sin(time_s), 0.1 * time_s, 0.01 * time_s)
        for channel in ("elbow current", "wrist current")
        for session in ("warm", "cold")
    )
    done = diagnose(results["beside"], "--report", "page.html", traces=traces)
    assert done.exit_code == 0
    assert "report    page.html" in done.stderr
    page = (tmp_path / "page.html").read_text()
    assert "<code>marsarm diagnose a.mcap</code>" in page
    assert page.count('<figure class="traces"') == 2
    motions = json.loads(re.findall(r'<script type="application/json">(.*?)</script>', page)[0])
    assert [sorted(panel["series"]) for panel in motions[0]["panels"]] == [
        ["explained", "measured", "nominal"],
        ["explained", "nominal"],
    ]


def test_a_patch_without_content_is_not_written(diagnose, results, tmp_path):
    done = diagnose(results["unknown"], "--patch", "found.toml")
    assert done.exit_code == 0
    assert "patch found.toml: not written: no effect was found" in done.stderr
    assert not (tmp_path / "found.toml").exists()


def test_a_log_that_cannot_be_diagnosed_ends_with_2_and_writes_nothing(diagnose, tmp_path):
    done = diagnose(NotForDiagnosis("log a.mcap: has no /drive"), "--report", "gap.html")
    assert done.exit_code == 2
    assert done.stderr == "log a.mcap: has no /drive\n"
    assert not (tmp_path / "gap.html").exists()
