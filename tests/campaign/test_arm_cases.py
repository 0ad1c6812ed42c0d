"""Sealed cases of this arm: their score level by level, results, and cases without their effect."""

import json
from dataclasses import replace
from typing import Any

import pytest

from marsarm.common.pool import run_here
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from validation.campaigns import Context
from validation.cases import arm_score, sealed
from validation.cases.arm import CAMPAIGN_FOLDER, ArmCases, campaign, leave_out
from validation.cases.arm_truth import SealedEffect, TrueCase, list_uncatalogued, locate_outside

CLASSES = arm_score.EquivalenceClasses({
    (effect, place): arm_score.PublishedHypothesis(effect, place, label, 1.0, 1.5, *known)
    for effect, place, label, *known in (
        ("rub", "knee", 0, "friction", "knee"),
        ("drag", "knee", 0, "friction", "knee"),
        ("rub", "hip", 1, "friction", "hip"),
        ("bend", "shin.x", 2, "structure", "shin"),
    )
})  # fmt: skip


def true(kind, *effects, times=2.0, number=0):
    made = tuple(SealedEffect(name, place, {"size": 1.0}, times, "") for name, place in effects)
    return TrueCase(f"case-00{number}", kind, made, (), 1)


def finding(effect, place, level="effect", **more):
    known = CLASSES.known[effect, place]
    named = [f"{p}: {n}" for n, p in ((effect, place), *more.get("others", ()))]
    sets = {
        "places": [known.location, *more.get("places", ())],
        "families": [known.family] if level in ("effect", "family") else [],
        "effects": named if level == "effect" else [],
    }
    sizes = [{"name": "size", "low_90": 0.9, "high_90": more.get("most", 1.1)}]
    return {"effect": effect, "place": place, "level": level, "not_excluded": sets, "sizes": sizes}


def said(*findings, verdict="set"):
    return {"verdict": verdict, "findings": list(findings), "seconds": 9.0}


def scored(*solved):
    """Return hits and cases of each bar and rate."""
    document = arm_score.score(CLASSES, solved).document
    rates = {**document["bars"], **{name: one for name, one in document.items() if name != "bars"}}
    return {name: (one["hits"], one["of"]) for name, one in rates.items() if isinstance(one, dict)}


def test_anything_but_none_is_a_false_alarm_without_effect():
    cases = [(true("none"), said(verdict=verdict)) for verdict in ("none", "unknown", "none")]
    found = scored(*cases, (true("none"), said(finding("rub", "hip", "none"))))
    assert found["false alarms"] == (2, 4)


def test_what_is_said_of_an_effect_outside_is_wrong_level_by_level():
    """Dither at the elbow is of the family actuation; place, family and name count by themselves."""
    outside = true("out-of-catalogue", ("dither", "elbow"))
    found = scored(
        (outside, said(finding("rub", "knee"))),
        (outside, said(finding("rub", "knee", "place"))),
        (outside, said(finding("rub", "knee", "place", places=("elbow",)))),
        (outside, said(finding("rub", "knee", "none"))),
        (outside, said(verdict="unknown")),
    )
    wrong = [found[f"outside, wrong {level}"] for level in ("place", "family", "effect")]
    assert wrong == [(2, 5), (1, 5), (1, 5)]
    assert found["outside, reported"] == (5, 5)
    assert found["reported"] == (0, 0)


def test_every_effect_outside_has_a_family_and_a_location():
    for effect, place in list_uncatalogued():
        assert locate_outside(effect, place) not in ("x", "y", "z", "")


def test_one_of_the_same_class_is_right():
    found = scored((true("single", ("rub", "knee")), said(finding("drag", "knee"))))
    assert found["right effect"] == found["right place"] == found["set coverage"] == (1, 1)
    assert found["90 % intervals that cover"] == (0, 0)


def test_rates_are_of_what_is_reported_from_the_limit_of_the_selection_on():
    hip = ("rub", "hip")
    found = scored(
        (true("single", hip), said(finding(*hip))),
        (true("single", hip), said(verdict="unknown")),
        (true("single", hip, times=1.4), said(finding("bend", "shin.x"))),
    )
    assert found["reported"] == (1, 2)
    assert found["right effect"] == (1, 1)


@pytest.mark.parametrize(
    ("one", "is_covered"),
    [
        (finding("rub", "hip", "effect", others=(("bend", "shin.x"),)), True),
        (finding("rub", "hip"), False),
        (finding("rub", "hip", "family", places=("shin",)), False),
        (finding("rub", "hip", "place", places=("shin",)), True),
        (finding("rub", "hip", "place"), False),
    ],
)
def test_the_set_of_the_level_that_is_reported_holds_the_truth(one, is_covered):
    found = scored((true("single", ("bend", "shin.x")), said(one)))
    assert found["set coverage"] == (int(is_covered), 1)


def test_a_cause_that_is_not_located_claims_no_set():
    found = scored((true("single", ("bend", "shin.x")), said(finding("rub", "hip", "none"))))
    assert (found["reported"], found["set coverage"]) == ((1, 1), (0, 0))


def test_each_of_a_pair_has_its_own_finding():
    pair = true("pair", ("rub", "hip"), ("bend", "shin.x"))
    alone = scored((pair, said(finding("rub", "hip"))))
    assert (alone["reported"], alone["right effect"]) == ((1, 2), (1, 1))
    both = scored((pair, said(finding("rub", "knee"), finding("rub", "hip"))))
    assert (both["reported"], both["right effect"]) == ((2, 2), (1, 2))
    assert both["named, but not of the case"] == (1, 2)


def test_intervals_are_of_the_very_effect_that_was_named():
    one = true("single", ("rub", "hip"))
    found = scored(
        (one, said(finding("rub", "hip"))),
        (one, said(finding("rub", "hip", most=0.95))),
        (one, said(finding("rub", "hip", "place"))),
    )
    assert found["90 % intervals that cover"] == (1, 2)


HIP, SHIN = ("rub", "hip"), ("bend", "shin.x")
TRUTH = sealed.SealedTruth(
    "aa",
    (
        true("none"),
        true("single", HIP, number=1),
        true("single", SHIN, times=3.0, number=2),
        true("single", HIP, times=1.4, number=3),
        true("pair", HIP, SHIN, number=4),
        true("out-of-catalogue", ("dither", "elbow"), number=5),
    ),
)


class WrittenCases(ArmCases):
    """Cases whose logs are their results; without its effect, a case names another."""

    def prepare(self, *_):
        pass

    def load(self, *_):
        pass

    def diagnose(self, folder, case, without=""):
        if without:
            return said(finding("drag", "knee", others=((case.name, "knee"),)))
        document: dict[str, Any] = json.loads((case / "log").read_bytes())
        return document


@pytest.fixture
def folder(tmp_path):
    """Return a folder of cases of which none is solved."""
    for case in TRUTH.cases:
        found = [finding(one.name, one.place) for one in case.effects if case.kind in ("single", "pair")]
        verdict = "named" if found else "unknown" if case.effects else "none"
        sealed.write_json(tmp_path / sealed.CASES_FOLDER / case.name / "log", said(*found, verdict=verdict))
    rows = [
        {"name": name, "place": place, "class": one.label, "limit": 1.0, "family_wise_limit": 1.5}
        | {"family": one.family, "location": one.location}
        for (name, place), one in CLASSES.known.items()
    ]
    sealed.write_json(tmp_path / CAMPAIGN_FOLDER / arm_score.CLASSES_FILE, rows)
    sealed.seal(tmp_path, TRUTH)
    return tmp_path


@pytest.fixture
def solved(folder):
    """Return a folder whose cases are solved."""
    sealed.solve_cases(folder, WrittenCases(), run_here, no_progress)
    return folder


def test_solved_cases_are_scored_and_what_was_interrupted_goes_on(solved):
    found = sealed.score_cases(solved, WrittenCases(), False)
    assert found.document["digest"] == TRUTH.digest()
    bars = found.document["bars"]
    rates = [bars[name] for name in ("false alarms", "reported", "right effect", "set coverage")]
    assert [(one["hits"], one["of"]) for one in rates] == [(0, 1), (4, 4), (4, 4), (4, 4)]
    assert "| reported | at least 0.85 | 4 of 4 | met |" in found.markdown()
    for number in (2, 4):
        sealed.result_path(solved, f"case-00{number}").unlink()
    with pytest.raises(BadRequest, match="2 of 6 cases are not solved, case-002 first"):
        sealed.score_cases(solved, WrittenCases(), False)
    assert sealed.score_cases(solved, WrittenCases(), True).document["cases"] == 4
    assert sealed.solve_cases(solved, WrittenCases(), run_here, no_progress) == (2, 6)


def test_a_case_that_cannot_be_diagnosed_does_not_stop_the_others(folder, monkeypatch):
    def mute(_, folder, case, without=""):
        raise NotForDiagnosis(f"{case.name} has no logs")

    monkeypatch.setattr(WrittenCases, "diagnose", mute)
    assert sealed.solve_cases(folder, WrittenCases(), run_here, no_progress) == (6, 6)
    result = sealed.load_results(folder)["case-003"]
    assert (result["verdict"], result["refused"]) == ("unknown", "case-003 has no logs")
    found = leave_out(Context(out=folder), WrittenCases(), 60)
    assert (found["named"]["hits"], found["reported"]["hits"]) == (0, found["reported"]["of"])


def test_what_is_named_without_the_true_effect_is_counted_in_any_order(solved):
    context = Context(run=lambda work, jobs: map(work, reversed(jobs)), out=solved)
    found = leave_out(context, WrittenCases(), 60)
    assert found["wrong"] == ["case-002: bend at shin.x: drag at knee", "case-001: rub at hip: drag at knee"]
    assert (found["named"]["hits"], found["named"]["of"], found["right_place"]["hits"]) == (2, 2, 0)


GOOD = said(finding(*HIP))


@pytest.mark.parametrize(("text", "why"), [("[]", "object"), ('{"verdict": "none"', "JSON")])
def test_what_is_no_solved_case_is_refused(tmp_path, text, why):
    sealed.write_json(tmp_path / sealed.SOLVED_FOLDER / "case-000.json", GOOD)
    assert sealed.load_results(tmp_path) == {"case-000": GOOD}
    (tmp_path / sealed.SOLVED_FOLDER / "case-004.json").write_text(text)
    with pytest.raises(BadRequest, match=rf"case-004\.json: is no solved case \(.*{why}"):
        sealed.load_results(tmp_path)


def test_a_size_or_an_effect_of_another_version_is_refused(solved):
    document = json.loads(sealed.result_path(solved, "case-001").read_bytes())
    document["findings"][0]["sizes"][0]["name"] = "size_of_another"
    sealed.write_json(sealed.result_path(solved, "case-001"), document)
    with pytest.raises(BadRequest, match="case-001: rub has no size_of_another"):
        sealed.score_cases(solved, WrittenCases(), False)
    old = true("out-of-catalogue", ("old-wobble", "elbow"))
    sealed.seal(solved, replace(TRUTH, cases=(old, *TRUTH.cases[1:])))
    with pytest.raises(BadRequest, match="case-000: old-wobble is none of today's effects"):
        sealed.score_cases(solved, WrittenCases(), False)


@pytest.mark.parametrize("text", ["{}", "[]", '[{"name": 1}]', "[" * 200_000])
def test_classes_that_are_none_are_refused(tmp_path, text):
    (tmp_path / arm_score.CLASSES_FILE).write_text(text)
    with pytest.raises(BadRequest, match=r"classes\.json: holds no classes \("):
        arm_score.load_classes(tmp_path)


@pytest.mark.parametrize(
    ("out", "sizes", "said"),
    [
        ("b", {"cases": 0}, "cases: 0 is not within 1 .. 1000"),
        ("b", {"step": "dance"}, "step: dance is none of all, make, solve, score"),
        ("no/b", {}, "there is no folder .*no"),
        ("nothing", {}, "a link to nowhere/x, which is not there"),
        ("other", {}, "holds something else"),
        ("other/file", {}, "this is a file"),
        ("other", {"step": "solve"}, "no folder of cases"),
        ("other", {"step": "score"}, "no folder of cases"),
    ],
)
def test_cases_that_cannot_be_made_are_refused_and_nothing_is_written(tmp_path, out, sizes, said):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("")
    (tmp_path / "nothing").symlink_to("nowhere/x")
    with pytest.raises(BadRequest, match=said):
        campaign(Context(out=tmp_path / out), **sizes)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "nothing", "other"]
