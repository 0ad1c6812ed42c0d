"""Variance between and within simulated arms with known variances."""

import numpy as np
import pytest

from fsw.kinematics.transforms import Array
from helpers.marks import slow_but
from marsarm.accuracy.confidence import estimate_accuracy

CASES = {
    "alike": ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
    "one axis between arms": ((3.0, 0.5, 0.2), (0.5, 1.0, 0.2), (0.0, 0.0, 0.0)),
    "one axis within": ((0.3, 0.1, 0.1), (2.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
    "off on the mean": ((2.0, 1.0, 1.0), (0.3, 0.3, 0.3), (1.0, 0.0, 0.0)),
    "a single component": ((1.0,), (2.0,), (0.0,)),
}
SHORT = ("one axis between arms", "a single component")
"""Cases of the short tests."""


def campaign(rng: np.random.Generator, name: str, arms: int = 50, each: int = 20) -> Array:
    between, within, mean = (np.array(part)[:, None, None] for part in CASES[name])
    shape = (len(mean), arms, each)
    return mean + between * rng.standard_normal(shape)[:, :, :1] + within * rng.standard_normal(shape)


def true_sigmas(name: str) -> tuple[float, float]:
    between, within, mean = (np.array(part) for part in CASES[name])
    return 3 * float(np.sqrt(between @ between + within @ within + mean @ mean)), 3 * float(
        np.linalg.norm(within)
    )


@pytest.mark.parametrize("name", slow_but(CASES, *SHORT))
def test_estimates_are_unbiased_and_upper_bounds_hold_as_often_as_they_say(name):
    rng, wanted, runs = np.random.default_rng(11), true_sigmas(name), 600
    found = [estimate_accuracy(campaign(rng, name)) for _ in range(runs)]
    for sigmas, true in zip(
        ([f.accuracy for f in found], [f.repeatability for f in found]), wanted, strict=True
    ):
        assert np.sqrt(np.mean([s.estimate**2 for s in sigmas])) == pytest.approx(true, rel=0.02)
        # 0.95, less three sigma of 600 trials
        assert np.mean([s.upper >= true for s in sigmas]) > 0.92


@pytest.mark.parametrize("arms", slow_but([2, 3], 2))
@pytest.mark.parametrize("name", slow_but(CASES, *SHORT))
def test_upper_bounds_of_few_arms_hold_as_often_as_they_say(name, arms):
    rng, (accuracy, repeatability) = np.random.default_rng(12), true_sigmas(name)
    found = [estimate_accuracy(campaign(rng, name, arms)) for _ in range(600)]
    assert np.mean([f.accuracy.upper >= accuracy for f in found]) > 0.92
    assert np.mean([f.repeatability.upper >= repeatability for f in found]) > 0.92


def test_arms_that_are_all_the_same_differ_by_nothing():
    error = np.zeros((3, 4, 5))
    assert estimate_accuracy(error).accuracy.upper == 0.0


def test_more_arms_bring_the_upper_bound_nearer():
    rng = np.random.default_rng(12)
    few, many = (estimate_accuracy(campaign(rng, "alike", arms)).accuracy for arms in (5, 500))
    assert many.upper / many.estimate < few.upper / few.estimate


@pytest.mark.parametrize("shape", [(3, 1, 20), (3, 50, 1)])
def test_too_few_are_refused(shape):
    with pytest.raises(ValueError, match="two arms and two errors are the least"):
        estimate_accuracy(np.zeros(shape))
