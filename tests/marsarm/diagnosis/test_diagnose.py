"""Verdicts on synthetic cases: levels, sets and what remains; what `marsarm diagnose` prints and writes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from helpers.marks import slow_but
from marsarm.cli.app import app
from marsarm.diagnosis.arm.case import CaseDiagnosis, count_shown
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from marsarm.diagnosis.model import build_model
from simgap import Trace, to_document, verdict_lines
from simgap.report.sentences import level, verdict_word
from tests.marsarm.diagnosis.worlds import indices, select_and_diagnose, sized, strange, world


def test_every_case_has_its_verdict_and_level_and_what_remains_is_told_where_it_is(results):
    assert {name: verdict_word(one) for name, one in results.items()} == {
        "named": "named", "alike": "named", "undecided": "set", "nothing": "none", "unknown": "unknown",
        "beside": "unknown",
    }  # fmt: skip
    levels = [{level(finding) for finding in results[name].findings} for name in ("named", "beside")]
    assert levels == [{"effect"}, {"place"}]
    assert [name for name, one in results.items() if one.remaining] == ["unknown", "beside"]
    assert results["unknown"].remaining[0].joint == "place 2.a"


def test_an_effect_has_its_interval_and_says_what_is_the_same(results):
    (finding,), (aliased,) = results["named"].findings, results["alike"].findings
    ((low, high),) = finding.interval
    assert low < finding.size[0] < high
    assert finding.places == (finding.place,)
    assert "; or effect " in aliased.text


def test_the_document_has_sizes_in_the_units_of_their_names(results):
    document = to_document(results["named"])
    ((name, value),) = document["effects"][0]["size"].items()
    (size,) = document["findings"][0]["sizes"]
    assert (name, value) == (size["name"], size["value"])


def test_agreement_of_motions_that_show_no_effect_is_refused(made, results):
    weak = build_model(replace(made, effect=1e-6 * made.effect, curve=0.0 * made.curve))
    with pytest.raises(NotForDiagnosis, match="would show 0 of"):
        count_shown(weak, results["nothing"])
    assert "would show 0 of" in count_shown(weak, results["named"])


def test_effects_at_one_place_may_be_a_single_unknown_one(made, campaign, rng):
    """They have the place, and no name."""
    first, second = (h for h in (10, 15) if made.hypotheses[h].place == made.hypotheses[10].place)
    t = sized(made, campaign, first, 6.0) + sized(made, campaign, second, 6.0)
    diagnosis = select_and_diagnose(campaign, made.measured(rng, t))
    assert {*indices(campaign, diagnosis)} == {first, second}
    assert all(level(one) == "place" and not one.effects for one in diagnosis.findings)


def test_what_remains_beside_effects_at_several_places_may_be_at_another(made, campaign, rng):
    first, second = 10, 16
    assert made.hypotheses[first].place != made.hypotheses[second].place
    t = sized(made, campaign, first, 8.0) + sized(made, campaign, second, 8.0)
    diagnosis = select_and_diagnose(campaign, made.measured(rng, t) + 3.0 * strange(made, "place 4.a"))
    assert diagnosis.remaining
    assert len({one.place for one in diagnosis.findings}) > 1
    assert all(level(one) == "none" and len(one.places) == 5 for one in diagnosis.findings)


def test_an_effect_that_is_left_out_and_what_is_the_same_as_it_are_not_named(made, campaign, rng):
    left = replace(campaign, left_out_effect=made.hypotheses[4].name)
    assert {4, *campaign.equivalence_class(4)} <= left.left_out
    diagnosis = select_and_diagnose(left, made.measured(rng, sized(made, campaign, 4, 6.0)))
    assert verdict_word(diagnosis) != "none"
    gone = {made.hypotheses[h].key for h in left.left_out}
    assert not {key for one in diagnosis.findings for key in one.effects} & gone


@pytest.mark.parametrize("times", slow_but([1.0, 2.5], 2.5))
def test_a_nonlinear_effect_is_fitted(rng, times):
    """Within the simulated steps the parabola suffices; beyond them the simulator is needed."""
    bent = world(bent=0.8)
    campaign = build_model(bent)
    y = bent.measured(rng, (bent.owner == 4) * times)
    stepped, curved = (select_and_diagnose(campaign, y, one) for one in (bent.simulate, None))
    truth = times * bent.hypotheses[4].parameters[0].typical
    assert indices(campaign, stepped)[0] == indices(campaign, curved)[0] == 4
    assert stepped.findings[0].size[0] == pytest.approx(truth, rel=0.1)
    assert (curved.findings[0].size[0] == pytest.approx(truth, rel=0.1)) == (times == 1.0)


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
