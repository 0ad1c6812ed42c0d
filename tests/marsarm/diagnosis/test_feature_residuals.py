"""Features as residuals of the shared selection: white without effect, changed as sensitivities say."""

from dataclasses import replace

import numpy as np
import pytest

from marsarm.diagnosis.model import build_full_whitener, build_model
from marsarm.diagnosis.problem import Departures
from marsarm.diagnosis.selection import FeatureResiduals, list_competitors, select_simulated
from tests.marsarm.diagnosis.worlds import world

WORLD = SENSITIVITIES = world(bent=0.3)
MODEL = build_model(SENSITIVITIES)
EFFECTS = list_competitors(MODEL)
WHITEN = build_full_whitener(SENSITIVITIES)


def residuals(value: np.ndarray) -> FeatureResiduals:
    return FeatureResiduals(SENSITIVITIES, WHITEN, value)


def test_without_effect_features_are_white() -> None:
    values = [WORLD.measured(np.random.default_rng([1, k])) for k in range(40)]
    white = np.array([residuals(value).residuals((), np.zeros((1, 0)))[0] for value in values])
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.02)


def test_a_class_competes_once() -> None:
    labels = [MODEL.label[SENSITIVITIES.index(one.key)] for one in EFFECTS]
    assert len(set(labels)) == len(labels) == int(MODEL.label.max()) + 1


def test_the_change_by_effects_is_that_of_the_sensitivities() -> None:
    """Also beyond their reach, and for several effects at once."""
    rng = np.random.default_rng(3)
    value, some = WORLD.measured(rng), EFFECTS[4:12:3]
    sizes = rng.uniform(-2.0, 2.0, sum(len(one.sizes) for one in some))
    parts = np.split(sizes, np.cumsum([len(one.sizes) for one in some])[:-1])
    change = SENSITIVITIES.change(dict(zip(some, parts, strict=True)))
    expected = WHITEN(value - change)
    np.testing.assert_allclose(residuals(value).residuals(some, sizes[None])[0], expected, atol=1e-8)


def test_a_parabola_goes_through_what_was_simulated_and_its_secant_too() -> None:
    rng = np.random.default_rng(4)
    for h in (3, int(np.flatnonzero(np.bincount(WORLD.owner) == 2)[0])):
        hypothesis = SENSITIVITIES.hypotheses[h]
        a = rng.uniform(1.0, 3.0, len(hypothesis.parameters))
        change = rng.normal(size=WORLD.layout.size)
        simulated = SENSITIVITIES.with_simulated(h, a, change)
        for one in (simulated, simulated.linearised(h, a)):
            np.testing.assert_allclose(one.change({hypothesis: a}), change)


def test_a_class_is_represented_by_the_member_with_the_widest_bounds() -> None:
    """The bounds of the first members are one typical size; those of their copies are a thousand."""
    pairs = [of for k in range(len(SENSITIVITIES.hypotheses)) if len(of := MODEL.equivalence_class(k)) == 2]
    assert pairs
    hypotheses = list(SENSITIVITIES.hypotheses)
    for first, _ in pairs:
        narrow = [replace(one, least=-one.typical, most=one.typical) for one in hypotheses[first].parameters]
        hypotheses[first] = replace(hypotheses[first], parameters=tuple(narrow))
    model = replace(MODEL, sensitivities=replace(SENSITIVITIES, hypotheses=tuple(hypotheses)))
    chosen = {SENSITIVITIES.index(one.key) for one in list_competitors(model)}
    assert {second for _, second in pairs} <= chosen
    assert not {first for first, _ in pairs} & chosen


def test_a_nuisance_of_the_same_parameter_bends_with_the_effect() -> None:
    """At the simulated size it has the slope of the parabola; other nuisances stay."""
    h, a = 3, np.array([2.0])
    (column,) = np.flatnonzero(WORLD.owner == h)
    nuisance = SENSITIVITIES.nuisance.copy()
    nuisance[:, 5] = 0.1 * SENSITIVITIES.effect[:, column]
    given = replace(SENSITIVITIES, nuisance=nuisance)
    slope = given.effect[:, column]
    bent = given.with_simulated(h, a, 3.0 * slope)  # 2 a by the slope, and a^2 / 4
    np.testing.assert_allclose(bent.nuisance[:, 5], 0.1 * 2.0 * slope)
    np.testing.assert_array_equal(np.delete(bent.nuisance, 5, 1), np.delete(nuisance, 5, 1))


class Steep:
    """Simulator whose response grows faster than any parabola; it remembers the sizes that it simulated."""

    def __init__(self) -> None:
        self.sizes: list[np.ndarray] = []

    def simulate(self, settings: Departures) -> np.ndarray:
        ((hypothesis, departures),) = settings.items()
        self.sizes.append(departures)
        return self.respond(SENSITIVITIES.hypotheses.index(hypothesis), self.sizes[-1])

    def respond(self, h: int, a: np.ndarray) -> np.ndarray:
        (column,) = np.flatnonzero(SENSITIVITIES.owner == h)
        return SENSITIVITIES.effect[:, column] * float(a[0] + 0.02 * a[0] ** 3)


def test_a_second_simulation_does_not_depend_on_the_first() -> None:
    """A selection that simulates twice begins at the sensitivities of the campaign each time."""
    simulator, h = Steep(), 3
    value = simulator.respond(h, np.array([6.0]))
    found = select_simulated(MODEL, WHITEN, value, 1, simulator.simulate)
    assert found.chosen == (h,)
    assert len(simulator.sizes) > 1
    last = SENSITIVITIES.with_simulated(h, simulator.sizes[-1], simulator.respond(h, simulator.sizes[-1]))
    np.testing.assert_array_equal(found.sensitivities.nuisance, last.nuisance)
    np.testing.assert_array_equal(found.sensitivities.curve, last.curve)
    np.testing.assert_allclose(*found.departures.values(), 6.0, rtol=0.02)
