"""`marsarm diagnose`: what it prints and writes of a result; bad input writes nothing."""

import json
import re
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from ground.cli.app import app
from ground.diagnosis.arm.logs import NotForDiagnosis
from ground.diagnosis.arm.record import PARAMS_FILE
from ground.diagnosis.bootstrap import Alternatives
from ground.diagnosis.result import to_json
from ground.diagnosis.sentences import verdict_sentences

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

        monkeypatch.setattr("ground.diagnosis.arm.diagnose_logs.diagnose_logs", stand_in)
        return RUN.invoke(app, ["diagnose", "a.mcap", *words])

    return run


def test_every_verdict_is_printed_on_a_screen(diagnose, results):
    for result in results.values():
        done = diagnose(result)
        assert done.exit_code == 0
        assert done.stdout.startswith(f"{result.diagnosis.verdict}: ")
        printed = " ".join(done.stdout.split())
        assert all(sentence in printed for sentence in verdict_sentences(result))
        assert len(done.stdout.splitlines()) <= SCREEN


def test_three_effects_with_many_alternatives_fit_on_a_screen(diagnose, results):
    result = results["alike"]
    (finding,) = result.diagnosis.findings
    many = Alternatives(tuple(range(4, 16)), (0.2, *(0.06,) * 11))
    findings = (replace(finding, alternatives=many, equivalence_class=tuple(range(8))),) * 3
    said = replace(result.diagnosis, findings=findings, verdict="set")
    done = diagnose(replace(result, diagnosis=said))
    assert done.exit_code == 0
    assert "7 aliases, 11 alternatives" in " ".join(done.stdout.split())
    assert len(done.stdout.splitlines()) <= SCREEN


def test_a_significant_effect_that_predicts_nothing_is_reported_as_that(diagnose, results):
    result = results["unknown"]
    near = replace(result, diagnosis=replace(result.diagnosis, neg_log10_p=50.0))
    assert "is not in the catalogue" in " ".join(diagnose(result).stdout.split())
    printed = " ".join(diagnose(near).stdout.split())
    assert "is not in the catalogue" not in printed
    assert "does not predict motions that it was not fitted to" in printed
    assert "Next: Record more motions that would show effect" in printed


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
    for name, pictures in (("alike", 4), ("undecided", 4), ("beside", 4), ("nothing", 1), ("unknown", 1)):
        assert diagnose(results[name], "--report", f"{name}.html").exit_code == 0
        page = (tmp_path / f"{name}.html").read_text()
        first, second = verdict_sentences(results[name])
        assert re.search(rf'</h1>\n<p class="verdict \w+">{re.escape(f"{first} {second}")}</p>', page)
        assert page.count("<svg ") == pictures
        assert "<code>marsarm diagnose a.mcap</code>" in page
    assert "no cause is named" in (tmp_path / "beside.html").read_text()


def test_a_patch_without_content_is_not_written(diagnose, results, tmp_path):
    done = diagnose(results["unknown"], "--patch", "found.toml")
    assert done.exit_code == 0
    assert "patch found.toml: not written: the verdict is unknown" in done.stderr
    assert not (tmp_path / "found.toml").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--catalogue", "gear-stifness"], "did you mean gear-stiffness"),
        (["--held-out", "a.mcap"], "is log a.mcap too"),
        (["--report", "gap.pdf"], "must end in .html"),
        (["--patch", "one.toml", "--new-params", "one.toml"], "this is the file of patch too"),
        (["--params", "none.toml"], "none.toml: cannot be read"),
    ],
)
def test_bad_input_ends_with_2_and_writes_nothing(diagnose, results, tmp_path, words, said):
    done = diagnose(results["named"], *words, "--json")
    assert done.exit_code == 2
    assert said in json.loads(done.stdout)["error"]
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_log_that_cannot_be_diagnosed_ends_with_2_and_writes_nothing(diagnose, tmp_path):
    done = diagnose(NotForDiagnosis("log a.mcap: has no /drive"), "--report", "gap.html")
    assert done.exit_code == 2
    assert done.stderr == "log a.mcap: has no /drive\n"
    assert not (tmp_path / "gap.html").exists()
