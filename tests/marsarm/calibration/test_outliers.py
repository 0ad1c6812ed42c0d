"""Rejection of outliers on a planar arm."""

import numpy as np
import pytest
from scipy.stats import binom

from helpers.serial_planar import Planar, parameters
from marsarm.calibration.consensus import TooManyOutliers, reject_outliers


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
