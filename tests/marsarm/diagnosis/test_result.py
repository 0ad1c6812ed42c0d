"""Records of a diagnosis of features: verdicts, levels, sets, errors, and its document and page."""

import json

import pytest

from simgap import to_document
from simgap.report.page import save_diagnosis_page
from simgap.report.sentences import level, verdict_word


def test_every_case_has_its_verdict_and_level(results):
    assert {name: verdict_word(one) for name, one in results.items()} == {
        "named": "named", "alike": "named", "undecided": "set", "nothing": "none", "unknown": "unknown",
        "beside": "unknown",
    }  # fmt: skip
    levels = {name: {level(finding) for finding in one.findings} for name, one in results.items()}
    assert [levels[name] for name in ("named", "undecided", "beside")] == [{"effect"}, {"effect"}, {"place"}]
    assert results["nothing"].findings == ()


def test_every_diagnosis_is_a_document_and_a_page(results, tmp_path):
    for one in results.values():
        document = to_document(one)
        assert json.loads(json.dumps(document, allow_nan=False)) == document
        save_diagnosis_page(one, (), tmp_path / "page.html")
        assert document["lines"][0].split(": ", 1)[1][1:] in (tmp_path / "page.html").read_text()


def test_an_effect_has_its_interval_and_its_sets(results):
    (finding,) = results["named"].findings
    ((low, high),) = finding.interval
    assert low < finding.size[0] < high
    assert finding.share == pytest.approx(1.0)
    assert finding.places == (finding.place,)
    assert finding.families == (finding.family,)
    assert finding.effects == (f"{finding.place}: {finding.effect}",)
    assert finding.next_motion == ""


def test_an_aliased_effect_says_what_is_the_same(results):
    (finding,) = results["alike"].findings
    assert "; the same here as effect " in finding.text


def test_findings_close_the_gap_on_held_out_motion(results):
    for name in ("named", "alike"):
        assert results[name].closure == pytest.approx(1.0, abs=0.15)


def test_structure_is_reported_where_it_is(results, made):
    for name, expected in (("unknown", True), ("beside", True), ("named", False), ("nothing", False)):
        assert bool(results[name].remaining) is expected
    assert results["unknown"].remaining[0].joint == made.layout.channels[6]
