"""The step inside bounds is the least of its quadratic model, and never leads uphill."""

import numpy as np
import pytest

from simgap.arrays import Array, bounded_step


def draw(seed: int) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 8))
    root = rng.standard_normal((n + 2, n)) * np.geomspace(1.0, 1e3, n)
    low, high = -rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n)
    return root.T @ root, 1e3 * rng.standard_normal(n), low, high


@pytest.mark.parametrize("seed", range(50))
def test_no_other_step_inside_bounds_goes_lower(seed: int) -> None:
    hessian, gradient, low, high = draw(seed)
    unit = np.sqrt(np.diag(hessian))
    step = bounded_step(hessian, gradient, low, high, unit)
    assert np.all((step >= low - 1e-12) & (step <= high + 1e-12))
    slope = (gradient + hessian @ step) / unit  # the conditions of Karush, Kuhn and Tucker
    small = 1e-6 * np.linalg.norm(gradient / unit)
    assert np.all((slope >= -small) | (step >= high - 1e-12))
    assert np.all((slope <= small) | (step <= low + 1e-12))


def test_a_direction_that_nothing_shows_stays() -> None:
    hessian, bound = np.diag([1.0, 1e-6]), np.full(2, 100.0)
    step = bounded_step(hessian, np.array([1.0, 1e-3]), -bound, bound, np.ones(2), 1e-3)
    np.testing.assert_allclose(step, [-1.0, 0.0])
