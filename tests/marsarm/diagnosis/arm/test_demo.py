"""Demonstration: what is drawn, and when a diagnosis of it is right."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.diagnosis.arm.demo import SIZES, DemoTruth, draw_truth, judge
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.problem import Hypothesis
from sim.effects.joints import GearStiffness
from simgap import Diagnosis
from simgap.report.sentences import level
from tests.marsarm.diagnosis.worlds import indices

Cases = dict[str, Diagnosis]


def truth(kind: str, model: DiagnosisModel, h: int) -> DemoTruth:
    one = model.sensitivities.hypotheses[h]
    return DemoTruth("00", kind, one.effect, one.place, "", 2.0, ())  # type: ignore[arg-type]


def locations(model: DiagnosisModel) -> list[str]:
    return [one.location for one in model.sensitivities.hypotheses]


def test_the_same_seed_draws_the_same(campaign: DiagnosisModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Hypothesis, "switch_on", lambda *_: GearStiffness(Joint.ELBOW, 0.9))
    draws = [draw_truth(campaign, np.random.default_rng(k)) for k in range(16)]
    again = [draw_truth(campaign, np.random.default_rng(k))[0] for k in range(16)]
    assert [one for one, _ in draws] == again
    assert {one.kind for one in again} == {"none", "known", "left out"}
    for one, effects in draws:
        assert len(effects) == len(one.background) + (one.kind != "none")
        assert one.kind == "none" or 0.9 * SIZES[0] <= one.times_limit <= SIZES[1]
    assert len({one.digest() for one in again}) == 16


def test_a_diagnosis_is_right_where_its_set_holds_what_was_on(
    results: Cases, campaign: DiagnosisModel
) -> None:
    nothing, named = DemoTruth("00", "none", "", "", "", 0.0, ()), results["named"]
    right = [judge(nothing, campaign, results[name])[0] for name in ("nothing", "unknown", "named")]
    assert right == [True, False, False]
    (finding,), (true,) = named.findings, indices(campaign, named)
    other = next(h for h in range(40) if locations(campaign)[h] not in finding.places)
    assert judge(truth("known", campaign, true), campaign, named)[0]
    assert not judge(truth("known", campaign, other), campaign, named)[0]
    assert not judge(truth("known", campaign, true), campaign, results["nothing"])[0]
    placed = replace(named, findings=(replace(finding, effects=(), families=()),))
    near = locations(campaign).index(finding.place)
    assert judge(truth("known", campaign, near), campaign, placed)[0]


@pytest.mark.parametrize("is_named", [False, True])
def test_another_name_beside_the_right_one_is_wrong_and_another_place_is_not(
    results: Cases, campaign: DiagnosisModel, is_named: bool
) -> None:
    (finding,) = results["named"].findings
    h = next(h for h in range(40) if locations(campaign)[h] not in finding.places)
    other = campaign.sensitivities.hypotheses[h]
    effects = (other.key,) if is_named else ()
    second = replace(
        finding, place=other.place, effect=other.effect, places=(other.place,), families=(), effects=effects
    )
    both = replace(results["named"], findings=(finding, second))
    is_right, _ = judge(truth("known", campaign, *indices(campaign, results["named"])), campaign, both)
    assert is_right is not is_named


def test_where_the_catalogue_lacks_the_effect_its_place_must_be_seen_and_no_name_given(
    results: Cases, campaign: DiagnosisModel
) -> None:
    for kind, is_right in (("named", False), ("unknown", True), ("nothing", False)):
        assert judge(truth("left out", campaign, 0), campaign, results[kind])[0] == is_right
    places = [one.places for one in results["beside"].findings if level(one) != "none"]
    right = [all(location in of for of in places) for location in locations(campaign)[:40]]
    assert any(right)
    judged = [judge(truth("left out", campaign, h), campaign, results["beside"])[0] for h in range(40)]
    assert right == judged
