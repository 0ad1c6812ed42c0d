"""The minimum inside bounds is that of the quadratic model, and a bound is met exactly."""

import numpy as np
import pytest

from simgap.arrays import find_bounded_minimum


def draw(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 8))
    root = rng.standard_normal((n + 2, n)) * np.geomspace(1.0, 1e3, n)
    low, high = -rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n)
    return root.T @ root, 1e3 * rng.standard_normal(n), low, high


@pytest.mark.parametrize("seed", range(50))
def test_no_other_place_inside_bounds_is_lower(seed):
    hessian, gradient, low, high = draw(seed)
    unit, at = np.sqrt(np.diag(hessian)), np.random.default_rng(seed).uniform(low, high)
    end = find_bounded_minimum(hessian, gradient, at, (low, high), unit)
    assert np.all((end >= low) & (end <= high))
    slope = (gradient + hessian @ (end - at)) / unit  # the conditions of Karush, Kuhn and Tucker
    small = 1e-6 * np.linalg.norm(gradient / unit)
    assert np.all((slope >= -small) | (end == high))
    assert np.all((slope <= small) | (end == low))


def test_a_direction_that_nothing_shows_stays():
    hessian, bound = np.diag([1.0, 1e-6]), np.full(2, 100.0)
    end = find_bounded_minimum(hessian, np.array([1.0, 1e-3]), np.zeros(2), (-bound, bound), np.ones(2), 1e-3)
    np.testing.assert_allclose(end, [-1.0, 0.0])


def test_a_direction_that_nothing_shows_stays_where_another_meets_a_bound():
    hessian = np.array([[1.0, 0.01], [0.01, 1.01e-4]])
    bounds = np.array([0.0, -10.0]), np.array([1.0, 10.0])
    end = find_bounded_minimum(hessian, np.array([1.0, 0.0]), np.zeros(2), bounds, np.ones(2), 0.0025)
    np.testing.assert_allclose(end, [0.0, 0.0], atol=0.02)


def test_a_size_without_room_stays():
    bounds = np.array([0.0, -1.0]), np.array([0.0, 1.0])
    end = find_bounded_minimum(np.eye(2), np.array([0.5, 0.5]), np.zeros(2), bounds, np.ones(2))
    np.testing.assert_allclose(end, [0.0, -0.5])
