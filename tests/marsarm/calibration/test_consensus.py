"""Outputs and poses that others confirm: sides of the backlash, and outliers."""

import numpy as np
import pytest
from scipy.stats import binom

from helpers.serial_planar import Planar, parameters
from marsarm.calibration.consensus import find_consensus
from simgap.common.errors import RobotError
from simgap.serial_arm.fit import fit_without_outliers

NOISE_RAD = 3e-5
WIDTH_RAD = 2e-4
"""Uncertainty of the backlash width before the campaign; it is common to all outputs of a side."""


def on_one_side(off_rad, width_rad=WIDTH_RAD):
    """Return errors, noise and covariance of outputs that were dragged to one side."""
    off = np.array(off_rad)
    return off, np.full(off.size, NOISE_RAD), np.full((off.size, off.size), width_rad**2)


def test_outputs_that_are_off_by_one_angle_lie_where_they_were_dragged_to():
    rng = np.random.default_rng(0)
    off = 3e-4 + NOISE_RAD * rng.standard_normal(40)
    assert np.mean(find_consensus(*on_one_side(off))) > 0.95


@pytest.mark.parametrize(
    ("off_rad", "width_rad", "agree"),
    [
        ([*np.full(8, 3e-4), 1e-4, 5e-4], WIDTH_RAD, 8 * [True] + 2 * [False]),
        (np.linspace(-5e-4, 5e-4, 6), WIDTH_RAD, 6 * [False]),
        (np.zeros(4), WIDTH_RAD, 4 * [False]),
        ([2e-5], 1e-5, [True]),
        ([2e-4], 1e-5, [False]),
        (np.full(8, 1e-3), WIDTH_RAD, 8 * [False]),
    ],
    ids=["two slipped", "no two agree", "too few", "width known", "width known, off", "no built arm"],
)
def test_outputs_agree_with_the_model_and_with_most_others_of_their_side(off_rad, width_rad, agree):
    assert find_consensus(*on_one_side(off_rad, width_rad)).tolist() == agree


def test_outliers_are_found_named_and_left_out():
    rng = np.random.default_rng(9)
    truth = 2e-3 * rng.standard_normal(6)
    model = Planar(rng, lengths=truth)
    clean = fit_without_outliers(parameters(3), model)
    assert clean.used.all()
    for pose, off_m in ((7, 2e-3), (8, -2e-3), (30, 1.0), (44, 8e-4)):
        model.tip[:, pose] += off_m
    found = fit_without_outliers(parameters(3), model)
    assert np.flatnonzero(~found.used).tolist() == [7, 8, 30, 44]
    assert np.all(np.abs(found.values - truth) < 4 * found.sigma)


def test_a_campaign_without_outliers_is_seldom_said_to_have_one():
    rng = np.random.default_rng(10)
    alarms = sum(
        not fit_without_outliers(parameters(3), Planar(rng), false_alarm=0.1).used.all() for _ in range(100)
    )
    assert alarms <= binom.ppf(0.999, 100, 0.1)


def test_too_many_outliers_are_none():
    model = Planar(np.random.default_rng(11))
    model.tip[:, ::3] += 0.05 * np.random.default_rng(12).standard_normal((2, 20))
    with pytest.raises(RobotError, match="60 poses do not agree"):
        fit_without_outliers(parameters(3), model)
