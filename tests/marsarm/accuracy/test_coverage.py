"""Coverage of bounds with exact confidence intervals."""

import numpy as np
import pytest

from marsarm.accuracy.confidence import estimate_coverage, min_sample_size, quantile_interval


def test_a_quantile_lies_in_its_interval_as_often_as_it_says():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(400):
        low, high = quantile_interval(rng.random(2000), 0.99, 2000)
        inside += low <= 0.99 <= high
    assert inside >= 0.93 * 400


def test_near_the_end_of_the_values_an_interval_is_no_rank_too_short():
    rng = np.random.default_rng(3)
    found = [quantile_interval(rng.random(2000), 0.9973, 2000) for _ in range(2000)]
    # by the ranks 97.3 %; with the upper one rank lower, 94.9 %
    assert np.mean([low <= 0.9973 <= high for low, high in found]) > 0.96


def test_too_few_arms_do_not_tell_how_wide_a_bound_must_be():
    assert quantile_interval(np.arange(100.0), 0.9973, 100)[1] == np.inf


@pytest.mark.parametrize("arms", [1, 3, 50, 2000])
def test_an_interval_holds_the_quantile_of_the_values_themselves(arms):
    values = np.random.default_rng(4).random(20 * arms)
    low, high = quantile_interval(values, 0.9973, arms)
    assert low <= np.quantile(values, 0.9973) <= high


def test_as_many_arms_as_are_said_to_be_enough_just_are():
    enough = min_sample_size(0.9973)
    assert np.isfinite(quantile_interval(np.arange(float(enough)), 0.9973, enough)[1])
    assert quantile_interval(np.arange(enough - 1.0), 0.9973, enough - 1)[1] == np.inf


def test_a_bound_that_is_twice_as_wide_as_needed_says_so():
    error = np.random.default_rng(2).random(20_000)
    found = estimate_coverage(error, np.full(20_000, 2.0), 0.9973, 20_000)
    assert (found.share, found.width) == (1.0, pytest.approx(2.0, rel=0.01))
    assert found.width_interval[0] <= found.width <= found.width_interval[1]
    assert found.holds(0.9973)


def test_a_bound_that_is_too_narrow_does_not_hold():
    assert not estimate_coverage(
        np.random.default_rng(2).random(5000), np.full(5000, 0.99), 0.9973, 5000
    ).holds(0.9973)


def test_many_errors_of_few_arms_count_as_few():
    error = np.random.default_rng(2).random(5000)
    few, many = (
        estimate_coverage(error, np.full(5000, 0.99), 0.9973, arms).share_interval for arms in (50, 5000)
    )
    assert few[0] < many[0]
    assert few[1] > many[1]
