"""`marsarm diagnose`: what it prints and writes of a diagnosis; bad input writes nothing."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from marsarm.cli.app import app
from marsarm.diagnosis.arm.case import CaseDiagnosis
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from simgap import Trace, to_document, verdict_lines

RUN = CliRunner()


@pytest.fixture
def diagnose(tmp_path, monkeypatch):
    """Run the command with a given diagnosis, or an error."""
    monkeypatch.chdir(tmp_path)

    def run(result, *words, traces=()):
        def stand_in(request, progress):
            if isinstance(result, Exception):
                raise result
            return CaseDiagnosis(result, traces)

        monkeypatch.setattr("marsarm.diagnosis.arm.diagnose_logs.diagnose", stand_in)
        return RUN.invoke(app, ["diagnose", "a.mcap", *words])

    return run


def test_four_lines_are_printed_and_the_document_is_the_json_output(diagnose, results):
    for result in (results["undecided"], results["beside"]):
        printed = " ".join(diagnose(result).stdout.split())
        assert printed.startswith(" ".join(" ".join(verdict_lines(result)).split()))
        assert json.loads(diagnose(result, "--json").stdout) == to_document(result)


def test_the_page_has_the_traces_of_features_and_a_patch_without_content_is_not_written(
    diagnose, results, tmp_path
):
    time_s = np.arange(8) / 4.0
    traces = tuple(
        Trace(channel, "features", session, "A", time_s, np.sin(time_s), 0.1 * time_s, 0.01 * time_s)
        for channel in ("elbow current", "wrist current")
        for session in ("warm", "cold")
    )
    done = diagnose(results["unknown"], "--report", "page.html", "--patch", "found.toml", traces=traces)
    assert done.exit_code == 0
    assert "report    page.html" in done.stderr
    assert (tmp_path / "page.html").read_text().count('<figure class="traces"') == 2
    assert "patch found.toml: not written: no effect was found" in done.stderr
    assert not (tmp_path / "found.toml").exists()


def test_a_log_that_cannot_be_diagnosed_ends_with_2_and_writes_nothing(diagnose, tmp_path):
    done = diagnose(NotForDiagnosis("log a.mcap: has no /drive"), "--report", "gap.html")
    assert done.exit_code == 2
    assert done.stderr == "log a.mcap: has no /drive\n"
    assert not (tmp_path / "gap.html").exists()
