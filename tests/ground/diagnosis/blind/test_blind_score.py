"""Score of results written by hand, by equivalence class."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from ground.diagnosis.blind_case import CaseKind, TrueCase, TrueEffect
from validation.blind.classes import EquivalenceClasses
from validation.blind.score import median_with_interval, score

CLASSES = EquivalenceClasses(
    {("rub", "knee"): 0, ("drag", "knee"): 0, ("rub", "hip"): 1, ("bend", "shin"): 2}
)


def true(kind: CaseKind, *effects: tuple[str, str], times: float = 2.0) -> TrueCase:
    made = tuple(TrueEffect(name, place, {"size": 1.0}, times, "") for name, place in effects)
    return TrueCase("case-000", kind, made, (), 1)


def said(
    verdict: str, *effects: tuple[str, str], ranking: tuple[tuple[str, str], ...] = (), **more: Any
) -> Any:
    findings = [
        {
            "name": name,
            "place": place,
            "alternatives": [{"name": n, "place": p} for n, p in more.get("alternatives", ())],
            "parameters": [
                {"name": "size", "is_amplitude": True, "least": 0.9, "most": more.get("most", 1.1)}
            ],
        }
        for name, place in effects
    ]
    return {
        "verdict": verdict,
        "effects": findings,
        "ranking": [{"name": name, "place": place} for name, place in ranking],
        "closure": None if more.get("share") is None else {"share": more["share"]},
        "seconds": more.get("seconds", 1.0),
        "baselines": {"error": {"place": "knee"}, "free": {"name": "bend", "place": "shin", "closure": 0.2}},
    }


def scored(*solved: Any, achieved: float = 0.9) -> Any:
    return score(CLASSES, solved, lambda _: achieved)


def test_anything_but_none_is_a_false_alarm_without_effect() -> None:
    cases = [(true("none"), said(verdict)) for verdict in ("none", "unknown", "none")]
    found = scored(*cases, (true("none"), said("named", ("rub", "hip")))).false_alarm
    assert (found.hits, found.of) == (2, 4)


def test_a_name_for_what_is_outside_is_wrong_and_unknown_is_not() -> None:
    outside = true("out-of-catalogue", ("odd", "knee"))
    found = scored(
        (outside, said("set", ("rub", "knee"))),
        (outside, said("unknown", ("rub", "knee"))),
        (outside, said("none")),
    )
    assert (found.wrong_name.hits, found.wrong_name.of) == (1, 3)
    assert found.found.effect.of == 0


def test_one_of_the_same_class_is_right_and_has_the_place() -> None:
    found = scored((true("single", ("rub", "knee")), said("named", ("drag", "knee"))))
    assert [found.found.effect.hits, found.found.place.hits, found.found.in_set.hits] == [1, 1, 1]
    assert found.covered.of == 0


def test_the_best_of_the_ranking_stands_where_nothing_was_found() -> None:
    found = scored((true("single", ("rub", "hip")), said("none", ranking=(("rub", "hip"), ("rub", "knee")))))
    assert (found.found.effect.hits, found.found.in_set.hits) == (1, 0)


def test_below_the_limit_only_the_bins_count() -> None:
    found = scored((true("single", ("rub", "hip"), times=0.7), said("named", ("rub", "hip"))))
    assert found.found.effect.of == 0
    assert [one.found.effect.of for one in found.bins] == [1, 0, 0, 0]


def test_a_set_is_as_large_as_its_classes() -> None:
    more = {"alternatives": [("bend", "shin"), ("drag", "knee")]}
    found = scored((true("single", ("bend", "shin")), said("set", ("rub", "knee"), **more)))
    assert (found.set_size, found.found.in_set.hits, found.found.effect.hits) == (2.0, 1, 0)
    assert (found.spurious.hits, found.spurious.of) == (1, 1)


def test_each_of_a_pair_counts() -> None:
    pair = true("pair", ("rub", "hip"), ("bend", "shin"))
    found = scored((pair, said("named", ("rub", "hip"))))
    assert (found.found.effect.hits, found.found.effect.of) == (1, 2)


def test_intervals_are_of_the_very_effect_that_was_named() -> None:
    one = true("single", ("rub", "hip"))
    found = scored(
        (one, said("named", ("rub", "hip"))),
        (one, said("named", ("rub", "hip"), most=0.95)),
        (one, said("unknown", ("rub", "hip"))),
    )
    assert (found.covered.hits, found.covered.of) == (1, 2)


def test_closure_is_held_against_what_the_truth_achieves() -> None:
    one = true("single", ("rub", "hip"))
    cases = [(one, said("named", ("rub", "hip"), share=share, seconds=9.0)) for share in (0.7, 0.8, 0.9)]
    found = scored(*cases, (one, said("none", share=0.1)), achieved=0.95)
    assert found.closure.median == pytest.approx(0.8)
    assert found.closure_lost.median == pytest.approx(0.15)
    assert found.seconds.median == found.max_seconds == 9.0


def test_what_is_withheld_counts_against_all_and_not_against_those_named() -> None:
    one = true("single", ("rub", "hip"))
    found = scored((one, said("named", ("rub", "hip"))), (one, said("unknown", ("bend", "shin"))))
    assert (found.found.effect.hits, found.found.effect.of) == (1, 2)
    assert (found.found_given.effect.hits, found.found_given.effect.of) == (1, 1)


def test_others_are_rated_as_the_diagnosis_is() -> None:
    """A place counts by its class, and a case without a result is a miss."""
    alike = EquivalenceClasses({("rub", "knee"): 0, ("drag", "hip"): 0})
    one, refused = true("single", ("drag", "hip")), {**said("unknown"), "baselines": {}}
    free = {"baselines": {"free": {"name": "rub", "place": "knee", "closure": None}}}
    found = score(alike, [(one, {**said("none"), **free}), (one, refused)], lambda _: 0.9).baselines["free"]
    assert (found.place.hits, found.place.of) == (1, 2)
    assert (found.effect.hits, found.effect.of) == (1, 2)


def test_others_stand_in_the_same_table() -> None:
    one = true("single", ("drag", "knee"))
    found = scored((one, said("named", ("rub", "knee"), share=0.8)))
    assert found.baselines["error"].place.hits == 1
    assert found.baselines["error"].effect.of == 0
    assert found.baselines["free"].effect.hits == 0
    assert found.baselines["free"].closure.median == 0.2
    assert found.verdicts == {"single": {"named": 1}}
    assert found.class_sizes == {1: 2, 2: 1}


@pytest.mark.parametrize("of", [6, 25, 60])
def test_the_interval_of_a_median_holds_it_as_often_as_it_says(of: int) -> None:
    """By the binomial: it misses if too many of the values are on one side."""
    median = median_with_interval([float(value) for value in range(of)])
    below = round(median.least)
    assert 2.0 * binom.cdf(below, of, 0.5) <= 0.05
    assert 2.0 * binom.cdf(below + 1, of, 0.5) > 0.05
    assert median.most == of - 1 - below
    assert np.isinf(median_with_interval([1.0, 2.0]).least)
