"""Score of results written by hand, level by level and by equivalence class."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from marsarm.common.rates import median_with_interval
from validation.cases.arm_features import EquivalenceClasses, PublishedHypothesis
from validation.cases.arm_score import score
from validation.cases.arm_truth import CaseKind, SealedEffect, TrueCase, list_uncatalogued, locate_outside

CLASSES = EquivalenceClasses({
    ("rub", "knee"): PublishedHypothesis(0, 1.5, "friction", "knee"),
    ("drag", "knee"): PublishedHypothesis(0, 1.5, "friction", "knee"),
    ("rub", "hip"): PublishedHypothesis(1, 1.5, "friction", "hip"),
    ("bend", "shin.x"): PublishedHypothesis(2, 1.5, "structure", "shin"),
})  # fmt: skip


def true(kind: CaseKind, *effects: tuple[str, str], times: float = 2.0) -> TrueCase:
    made = tuple(SealedEffect(name, place, {"size": 1.0}, times, "") for name, place in effects)
    return TrueCase("case-000", kind, made, (), 1)


def finding(effect: str, place: str, level: str = "effect", **more: Any) -> dict[str, Any]:
    known = CLASSES.known[effect, place]
    named = [f"{p}: {n}" for n, p in ((effect, place), *more.get("others", ()))]
    sets = {
        "places": [known.location, *more.get("places", ())],
        "families": [known.family] if level in ("effect", "family") else [],
        "effects": named if level == "effect" else [],
    }
    sizes = [{"name": "size", "low_90": 0.9, "high_90": more.get("most", 1.1)}]
    return {"effect": effect, "place": place, "level": level, "not_excluded": sets, "sizes": sizes}


def said(*findings: dict[str, Any], verdict: str = "set") -> dict[str, Any]:
    return {"verdict": verdict, "findings": list(findings), "seconds": 9.0}


def scored(*solved: Any) -> Any:
    return score(CLASSES, solved)


def test_anything_but_none_is_a_false_alarm_without_effect() -> None:
    cases = [(true("none"), said(verdict=verdict)) for verdict in ("none", "unknown", "none")]
    found = scored(*cases, (true("none"), said(finding("rub", "hip", "none")))).false_alarm
    assert (found.hits, found.of) == (2, 4)


def test_what_is_said_of_an_effect_outside_is_wrong_level_by_level() -> None:
    """Dither at the elbow is of the family actuation; place, family and name count by themselves."""
    outside = true("out-of-catalogue", ("dither", "elbow"))
    found = scored(
        (outside, said(finding("rub", "knee"))),
        (outside, said(finding("rub", "knee", "place"))),
        (outside, said(finding("rub", "knee", "place", places=("elbow",)))),
        (outside, said(finding("rub", "knee", "none"))),
        (outside, said(verdict="unknown")),
    )
    assert [found.wrong[level].hits for level in ("place", "family", "effect")] == [2, 1, 1]
    assert (found.outside_reported.hits, found.wrong["place"].of) == (5, 5)
    assert found.reported.of == 0


def test_every_effect_outside_has_a_family_and_a_location() -> None:
    for effect, place in list_uncatalogued():
        assert locate_outside(effect, place) not in ("x", "y", "z", "")


def test_one_of_the_same_class_is_right() -> None:
    found = scored((true("single", ("rub", "knee")), said(finding("drag", "knee"))))
    assert [found.effect.hits, found.place.hits, found.covered.hits] == [1, 1, 1]
    assert found.interval.of == 0


def test_rates_are_of_what_is_reported_from_the_limit_of_the_selection_on() -> None:
    hip = ("rub", "hip")
    found = scored(
        (true("single", hip), said(finding(*hip))),
        (true("single", hip), said(verdict="unknown")),
        (true("single", hip, times=1.4), said(finding("bend", "shin.x"))),
    )
    assert (found.reported.hits, found.reported.of) == (1, 2)
    assert (found.effect.hits, found.effect.of) == (1, 1)


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
def test_the_set_of_the_level_that_is_reported_holds_the_truth(one: Any, is_covered: bool) -> None:
    found = scored((true("single", ("bend", "shin.x")), said(one)))
    assert (found.covered.hits, found.covered.of) == (int(is_covered), 1)


def test_a_cause_that_is_not_located_claims_no_set() -> None:
    found = scored((true("single", ("bend", "shin.x")), said(finding("rub", "hip", "none"))))
    assert (found.reported.hits, found.covered.of) == (1, 0)


def test_each_of_a_pair_has_its_own_finding() -> None:
    pair = true("pair", ("rub", "hip"), ("bend", "shin.x"))
    alone = scored((pair, said(finding("rub", "hip"))))
    assert (alone.reported.hits, alone.effect.hits, alone.effect.of) == (1, 1, 1)
    both = scored((pair, said(finding("rub", "knee"), finding("rub", "hip"))))
    assert (both.reported.hits, both.effect.hits, both.spurious.hits) == (2, 1, 1)


def test_intervals_are_of_the_very_effect_that_was_named() -> None:
    one = true("single", ("rub", "hip"))
    found = scored(
        (one, said(finding("rub", "hip"))),
        (one, said(finding("rub", "hip", most=0.95))),
        (one, said(finding("rub", "hip", "place"))),
    )
    assert (found.interval.hits, found.interval.of) == (1, 2)


@pytest.mark.parametrize("of", [6, 25, 60])
def test_the_interval_of_a_median_holds_it_as_often_as_it_says(of: int) -> None:
    """By the binomial: it misses if too many of the values are on one side."""
    median = median_with_interval([float(value) for value in range(of)])
    below = round(median.least)
    assert 2.0 * binom.cdf(below, of, 0.5) <= 0.05
    assert 2.0 * binom.cdf(below + 1, of, 0.5) > 0.05
    assert median.most == of - 1 - below
    assert np.isinf(median_with_interval([1.0, 2.0]).least)
