"""Outputs and poses that others confirm: sides of the backlash, and outliers."""

import numpy as np
import pytest
from scipy.stats import binom

from helpers.serial_planar import Planar, parameters
from marsarm.calibration.consensus import OutputErrors, TooManyOutliers, find_consensus, reject_outliers

NOISE_RAD = 3e-5
WIDTH_RAD = 2e-4
"""Uncertainty of the backlash width before the campaign; it is common to all outputs of a side."""


def on_one_side(off_rad, width_rad=WIDTH_RAD):
    """Return outputs that were dragged to one side."""
    off = np.array(off_rad)
    return OutputErrors(off, np.full(off.size, NOISE_RAD), np.full((off.size, off.size), width_rad**2))


def test_outputs_that_are_off_by_one_angle_lie_where_they_were_dragged_to():
    rng = np.random.default_rng(0)
    off = 3e-4 + NOISE_RAD * rng.standard_normal(40)
    assert np.mean(find_consensus(on_one_side(off))) > 0.95


def test_one_that_slipped_is_left_out():
    off = np.append(np.full(8, 3e-4), [1e-4, 5e-4])
    assert find_consensus(on_one_side(off)).tolist() == 8 * [True] + 2 * [False]


def test_outputs_that_slipped_each_by_itself_do_not_make_a_narrower_gap():
    """All agree with the uncertain width, but no two agree with each other."""
    assert not find_consensus(on_one_side(np.linspace(-5e-4, 5e-4, 6))).any()


def test_few_outputs_tell_nothing_of_a_gap_whose_width_is_not_known():
    assert not find_consensus(on_one_side(np.zeros(4))).any()


def test_where_others_have_told_the_width_one_output_is_enough():
    assert find_consensus(on_one_side([2e-5], width_rad=1e-5)).all()
    assert not find_consensus(on_one_side([2e-4], width_rad=1e-5)).any()


def test_an_angle_that_no_built_arm_has_is_not_agreed_upon():
    assert not find_consensus(on_one_side(np.full(8, 1e-3))).any()


def test_outliers_are_found_named_and_left_out():
    rng = np.random.default_rng(9)
    truth = 2e-3 * rng.standard_normal(6)
    model = Planar(rng, lengths=truth)
    clean = reject_outliers(parameters(3), model)
    assert clean.outliers == ()
    for pose, off_m in ((7, 2e-3), (8, -2e-3), (30, 1.0), (44, 8e-4)):
        model.tip[:, pose] += off_m
    found = reject_outliers(parameters(3), model)
    assert found.outliers == (7, 8, 30, 44)
    assert np.all(np.abs(found.fit.values - truth) < 4 * found.fit.sigma)


def test_a_campaign_without_outliers_is_seldom_said_to_have_one():
    rng = np.random.default_rng(10)
    alarms = sum(
        bool(reject_outliers(parameters(3), Planar(rng), false_alarm=0.1).outliers) for _ in range(100)
    )
    assert alarms <= binom.ppf(0.999, 100, 0.1)


def test_too_many_outliers_are_none():
    model = Planar(np.random.default_rng(11))
    model.tip[:, ::3] += 0.05 * np.random.default_rng(12).standard_normal((2, 20))
    with pytest.raises(TooManyOutliers, match="60 poses do not agree"):
        reject_outliers(parameters(3), model)
