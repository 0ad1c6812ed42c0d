"""The shared selection of effects on features: in a linear world it finds what is there, and nothing else."""

import numpy as np
import pytest

from diagnosis.effects.effect import Family
from diagnosis.selection.selection import select_effects
from diagnosis.selection.verdict import find_confidence_sets
from ground.diagnosis.detectability import detection_limits
from ground.diagnosis.feature_residuals import FeatureResiduals, list_feature_effects
from ground.diagnosis.normal_equations import form_normal_equations
from ground.diagnosis.problem import Residuals
from tests.ground.diagnosis.worlds import found, world

WORLD = world(alike=0, effects=16)
SENSITIVITIES = found(WORLD)
LIMITS = detection_limits(form_normal_equations(SENSITIVITIES))
EFFECTS = list_feature_effects(SENSITIVITIES, LIMITS, lambda _: Family.FRICTION)


def diagnose(value: np.ndarray) -> list[tuple[tuple[str, str], set[tuple[str, str]]]]:
    model = FeatureResiduals(SENSITIVITIES, Residuals(WORLD.layout, value))
    selection = select_effects(model, (), EFFECTS, seed=1)
    return [
        ((one.effect.name, one.effect.place), {(a.effect.name, a.effect.place) for a in one.alternatives})
        for one in find_confidence_sets(selection)
    ]


def test_without_effect_whitened_features_are_white() -> None:
    values = [WORLD.measured(np.random.default_rng([1, k])) for k in range(40)]
    white = np.array([FeatureResiduals(SENSITIVITIES, Residuals(WORLD.layout, v))._y for v in values])
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.02)


def test_where_nothing_is_there_nothing_is_found() -> None:
    found_in = [diagnose(WORLD.measured(np.random.default_rng([2, k]))) for k in range(6)]
    assert sum(map(bool, found_in)) <= 1  # two of six at 5 % would be a chance of 3 %


def test_an_effect_of_three_limits_is_found_at_its_place() -> None:
    right = 0
    for k in range(5):
        rng = np.random.default_rng([3, k])
        h = int(rng.integers(len(WORLD.hypotheses)))
        t = 3.0 * LIMITS[h].limit * (WORLD.owner == h)
        findings = diagnose(WORLD.measured(rng, t))
        truth = (WORLD.hypotheses[h].effect, WORLD.hypotheses[h].place)
        assert {place for (_, place), _ in findings} == {truth[1]}
        right += any(truth in members for _, members in findings)
    assert right >= 4
