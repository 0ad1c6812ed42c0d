"""Demonstration: what is drawn, and when a diagnosis of it is right."""

from dataclasses import replace

import numpy as np
import pytest

from marsarm.diagnosis.arm.arm_effects import list_families, list_locations
from marsarm.diagnosis.arm.demo import SIZES, DemoTruth, draw_truth, judge
from marsarm.diagnosis.arm.simulator import list_candidates, to_hypothesis
from marsarm.diagnosis.diagnose import Finding
from marsarm.diagnosis.model import build_model
from marsarm.diagnosis.result import DiagnosisResult
from tests.marsarm.diagnosis.worlds import World, found


def truth(kind: str, result: DiagnosisResult, h: int) -> DemoTruth:
    one = result.hypothesis(h)
    return DemoTruth("00", kind, one.effect, one.place, "", 2.0, ())  # type: ignore[arg-type]


def with_findings(result: DiagnosisResult, *findings: Finding) -> DiagnosisResult:
    return replace(result, diagnosis=replace(result.diagnosis, findings=findings, verdict="found"))


def test_the_same_seed_draws_the_same(made: World) -> None:
    hypotheses = tuple(to_hypothesis(one) for one in list_candidates(None))[: len(made.hypotheses)]
    columns = np.concatenate([np.flatnonzero(made.owner == h)[:1] for h in range(len(hypotheses))])
    sizes = [len(one.amplitudes) for one in hypotheses]
    kept = found(made)
    model = build_model(
        replace(
            kept,
            hypotheses=hypotheses,
            owner=np.repeat(np.arange(len(hypotheses)), sizes),
            effect=kept.effect[:, np.repeat(columns, sizes)],
            curve=kept.curve[:, np.repeat(columns, sizes)],
            reach=np.ones(sum(sizes)),
        ),
        list_families(hypotheses),
        list_locations(hypotheses),
    )
    draws = [draw_truth(model, np.random.default_rng(k)) for k in range(16)]
    again = [draw_truth(model, np.random.default_rng(k))[0] for k in range(16)]
    assert [one for one, _ in draws] == again
    assert {one.kind for one in again} == {"none", "known", "left out"}
    for one, effects in draws:
        assert len(effects) == len(one.background) + (one.kind != "none")
        assert one.kind == "none" or 0.9 * SIZES[0] <= one.times_limit <= SIZES[1]
    assert len({one.digest() for one in again}) == 16


def test_nothing_is_right_only_where_nothing_was_on(results: dict[str, DiagnosisResult]) -> None:
    nothing = DemoTruth("00", "none", "", "", "", 0.0, ())
    assert judge(nothing, results["nothing"])[0]
    assert not judge(nothing, results["unknown"])[0]
    assert not judge(nothing, results["named"])[0]


def test_an_effect_is_right_where_its_set_holds_it(results: dict[str, DiagnosisResult]) -> None:
    named = results["named"]
    (finding,) = named.diagnosis.findings
    other = next(h for h in range(40) if named.hypothesis(h).place not in finding.places)
    assert judge(truth("known", named, finding.hypothesis), named)[0]
    assert not judge(truth("known", named, other), named)[0]
    assert not judge(truth("known", named, finding.hypothesis), results["nothing"])[0]
    placed = replace(finding, level="place", effects=(), families=())
    near = next(h for h in range(40) if named.hypothesis(h).place in finding.places)
    assert judge(truth("known", named, near), with_findings(named, placed))[0]


@pytest.mark.parametrize("level", ["place", "size"])
def test_another_name_beside_the_right_one_is_wrong_and_another_place_is_not(
    results: dict[str, DiagnosisResult], level: str
) -> None:
    named = results["named"]
    (finding,) = named.diagnosis.findings
    other = next(h for h in range(40) if named.hypothesis(h).place not in finding.places)
    second = replace(
        finding,
        hypothesis=other,
        level=level,
        places=(named.hypothesis(other).place,),
        families=(),
        effects=(other,) if level == "size" else (),
    )
    is_right, _ = judge(truth("known", named, finding.hypothesis), with_findings(named, finding, second))
    assert is_right == (level == "place")


@pytest.mark.parametrize(("kind", "is_right"), [("named", False), ("unknown", True), ("nothing", False)])
def test_where_the_catalogue_lacks_the_effect_it_must_be_seen_and_not_named(
    results: dict[str, DiagnosisResult], kind: str, is_right: bool
) -> None:
    assert judge(truth("left out", results[kind], 0), results[kind])[0] == is_right


def test_where_the_catalogue_lacks_the_effect_its_place_must_be_right(
    results: dict[str, DiagnosisResult],
) -> None:
    named = results["named"]
    (finding,) = named.diagnosis.findings
    placed = with_findings(named, replace(finding, level="place", effects=(), families=()))
    for result in (placed, results["beside"]):
        places = [one.places for one in result.diagnosis.findings if one.places]
        right = [all(location in of for of in places) for location in result.model.locations[:40]]
        assert any(right)
        assert right == [judge(truth("left out", result, h), result)[0] for h in range(40)]
