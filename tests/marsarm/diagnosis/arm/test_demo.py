"""Demonstration: what is drawn, and when a diagnosis of it is right."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.diagnosis.arm import demo
from marsarm.diagnosis.arm.demo import SIZES, DemoTruth, draw_truth, judge
from marsarm.diagnosis.model import DiagnosisModel
from sim.effects.joints import GearStiffness
from simgap import Diagnosis, Finding
from simgap.report.sentences import level
from tests.marsarm.diagnosis.worlds import indices

Cases = dict[str, Diagnosis]


def truth(kind: str, model: DiagnosisModel, h: int) -> DemoTruth:
    one = model.sensitivities.hypotheses[h]
    return DemoTruth("00", kind, one.effect, one.place, "", 2.0, ())  # type: ignore[arg-type]


def other_place(model: DiagnosisModel, finding: Finding) -> int:
    return next(h for h in range(40) if model.locations[h] not in finding.places)


def test_the_same_seed_draws_the_same(campaign: DiagnosisModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "catalogue_effect", lambda *_: GearStiffness(Joint.ELBOW, 0.9))
    draws = [draw_truth(campaign, np.random.default_rng(k)) for k in range(16)]
    again = [draw_truth(campaign, np.random.default_rng(k))[0] for k in range(16)]
    assert [one for one, _ in draws] == again
    assert {one.kind for one in again} == {"none", "known", "left out"}
    for one, effects in draws:
        assert len(effects) == len(one.background) + (one.kind != "none")
        assert one.kind == "none" or 0.9 * SIZES[0] <= one.times_limit <= SIZES[1]
    assert len({one.digest() for one in again}) == 16


def test_nothing_is_right_only_where_nothing_was_on(results: Cases, campaign: DiagnosisModel) -> None:
    nothing = DemoTruth("00", "none", "", "", "", 0.0, ())
    right = [judge(nothing, campaign, results[name])[0] for name in ("nothing", "unknown", "named")]
    assert right == [True, False, False]


def test_an_effect_is_right_where_its_set_holds_it(results: Cases, campaign: DiagnosisModel) -> None:
    named = results["named"]
    (finding,) = named.findings
    (true,) = indices(campaign, named)
    assert judge(truth("known", campaign, true), campaign, named)[0]
    assert not judge(truth("known", campaign, other_place(campaign, finding)), campaign, named)[0]
    assert not judge(truth("known", campaign, true), campaign, results["nothing"])[0]
    placed = replace(named, findings=(replace(finding, effects=(), families=()),))
    near = campaign.locations.index(finding.place)
    assert judge(truth("known", campaign, near), campaign, placed)[0]


@pytest.mark.parametrize("is_named", [False, True])
def test_another_name_beside_the_right_one_is_wrong_and_another_place_is_not(
    results: Cases, campaign: DiagnosisModel, is_named: bool
) -> None:
    named = results["named"]
    (finding,) = named.findings
    other = campaign.sensitivities.hypotheses[other_place(campaign, finding)]
    effects = (other.key,) if is_named else ()
    second = replace(
        finding, place=other.place, effect=other.effect, places=(other.place,), families=(), effects=effects
    )
    both = replace(named, findings=(finding, second))
    is_right, _ = judge(truth("known", campaign, *indices(campaign, named)), campaign, both)
    assert is_right is not is_named


@pytest.mark.parametrize(("kind", "is_right"), [("named", False), ("unknown", True), ("nothing", False)])
def test_where_the_catalogue_lacks_the_effect_it_must_be_seen_and_not_named(
    results: Cases, campaign: DiagnosisModel, kind: str, is_right: bool
) -> None:
    assert judge(truth("left out", campaign, 0), campaign, results[kind])[0] == is_right


def test_where_the_catalogue_lacks_the_effect_its_place_must_be_right(
    results: Cases, campaign: DiagnosisModel
) -> None:
    (finding,) = results["named"].findings
    placed = replace(results["named"], findings=(replace(finding, effects=(), families=()),))
    for one in (placed, results["beside"]):
        places = [finding.places for finding in one.findings if level(finding) != "none"]
        right = [all(location in of for of in places) for location in campaign.locations[:40]]
        assert any(right)
        assert right == [judge(truth("left out", campaign, h), campaign, one)[0] for h in range(40)]
