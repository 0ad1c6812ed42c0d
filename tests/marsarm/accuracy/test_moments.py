"""Moments rule: quantiles of the length of a sum of independent errors."""

import numpy as np
import pytest

from helpers.marks import slow_but
from marsarm.accuracy.propagation import pooled_quantile, squared_length
from marsarm.accuracy.sources import CUMULANTS
from marsarm.accuracy.trial import sample_errors

COVERAGE = 0.9973
DRAWS = 400_000


@pytest.mark.parametrize("distribution", CUMULANTS)
def test_cumulants_are_those_of_drawn_errors(distribution):
    e = sample_errors(distribution, 2_000_000, np.random.default_rng(0))
    m2, m4, m6 = (float(np.mean(e**k)) for k in (2, 4, 6))
    found = (m2, m4 - 3 * m2**2, m6 - 15 * m4 * m2 + 30 * m2**3)
    assert found == pytest.approx(CUMULANTS[distribution], abs=0.01)


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_the_length_of_a_normal_vector_stays_within_its_quantile(size, seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((size, size)) * np.exp(2 * rng.standard_normal(size))
    lengths = np.linalg.norm(A @ rng.standard_normal((size, DRAWS)) / 3, axis=0)
    within = squared_length([(A[:, :, None], "normal")]).quantile(COVERAGE)[0]
    assert within == pytest.approx(np.quantile(lengths, COVERAGE), rel=0.02)


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("seed", slow_but(range(6), 0))
def test_the_length_of_a_sum_of_all_kinds_stays_within_its_quantile(size, seed):
    rng = np.random.default_rng([seed, 7])
    errors = [(rng.standard_normal((size, 5, 1)), distribution) for distribution in CUMULANTS]
    total = sum(
        u[:, :, 0] @ sample_errors(distribution, 5 * DRAWS, rng).reshape(5, DRAWS)
        for u, distribution in errors
    )
    within = squared_length(errors).quantile(COVERAGE)[0]
    assert within == pytest.approx(np.quantile(np.linalg.norm(total, axis=0), COVERAGE), rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_a_known_error_is_counted_in(seed):
    rng = np.random.default_rng([seed, 8])
    c, errors = rng.standard_normal((3, 1)), [(rng.standard_normal((3, 4, 1)), s) for s in CUMULANTS]
    total = c + sum(u[:, :, 0] @ sample_errors(s, 4 * DRAWS, rng).reshape(4, DRAWS) for u, s in errors)
    within = squared_length(errors, c).quantile(COVERAGE)[0]
    assert within == pytest.approx(np.quantile(np.linalg.norm(total, axis=0), COVERAGE), rel=0.05)


def test_an_error_on_either_side_is_as_long_as_it_is():
    u = np.array([[3.0], [4.0]])[:, :, None]
    assert squared_length([(u, "either side")]).quantile(COVERAGE)[0] == pytest.approx(5.0)


def test_what_a_share_stays_within_is_what_has_this_probability():
    length = squared_length([(np.random.default_rng(3).standard_normal((3, 6, 1)), "uniform")])
    assert length.probability_within(float(length.quantile(0.9)[0]))[0] == pytest.approx(0.9)


def test_one_pose_after_the_other_is_like_all_at_once():
    u = np.random.default_rng(4).standard_normal((2, 4, 6))
    apart = [squared_length([(u[..., k : k + 1], "normal")]) for k in range(6)]
    together = pooled_quantile([squared_length([(u, "normal")])], COVERAGE)
    assert pooled_quantile(apart, COVERAGE) == pytest.approx(together)
    assert together <= max(float(one.quantile(COVERAGE)[0]) for one in apart)
