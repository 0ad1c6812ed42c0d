"""Quadratic surrogate: a parabola within the simulated steps, a line beyond them."""

import numpy as np
import pytest

from ground.diagnosis.nonlinear_fit import QuadraticSurrogate
from ground.diagnosis.sensitivity import fit_parabola
from tests.ground.diagnosis.worlds import found, world


@pytest.fixture(scope="module")
def bent():
    """Return a world with quadratic effects."""
    return world(seed=5, m=120, effects=4, places=2, nuisances=3, blocks=4, alike=1, two=1, bent=0.4)


def _settings(bent, one, times):
    hypothesis = bent.hypotheses[one]
    return {hypothesis: hypothesis.absent + times * np.array([p.typical for p in hypothesis.parameters])}


@pytest.mark.parametrize("times", [-1.0, -0.3, 0.5, 1.0])
def test_within_reach_it_is_the_simulator(bent, times):
    settings = _settings(bent, 3, times)
    predicted = bent.predict(settings, np.zeros(3)) - bent.predict({}, np.zeros(3))
    np.testing.assert_allclose(QuadraticSurrogate(found(bent)).change(settings), predicted, atol=1e-9)


@pytest.mark.parametrize("times", [-2.0, 0.4, 3.0])
def test_slopes_are_the_derivatives_of_the_change(bent, times):
    curved, step = QuadraticSurrogate(found(bent)), 1e-6
    high, low = (curved.change(_settings(bent, 3, times + by)) for by in (step, -step))
    settings = _settings(bent, 3, times)
    slopes = curved.slopes(settings, curved.change(settings))
    np.testing.assert_allclose(slopes.sum(axis=1), (high - low) / (2 * step), rtol=1e-6, atol=1e-9)


def test_effects_add_up(bent):
    curved = QuadraticSurrogate(found(bent))
    one, two = (_settings(bent, h, 0.7) for h in (0, 5))
    np.testing.assert_allclose(curved.change(one | two), curved.change(one) + curved.change(two))


def test_a_parabola_goes_through_what_was_simulated():
    slope, bend = fit_parabola([(np.array([3.0]), 1.0), (np.array([-1.0]), -2.0)])
    assert slope + bend == pytest.approx(3.0)
    assert -2.0 * slope + 4.0 * bend == pytest.approx(-1.0)
    assert fit_parabola([(np.array([3.0]), 1.5)])[0] == pytest.approx(2.0)
