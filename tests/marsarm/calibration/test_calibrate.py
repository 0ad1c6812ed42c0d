"""Calibration of as-built arms: held-out poses, intervals, rank, groups, outliers, and the true optimum."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from fsw.kinematics.transforms import Pose
from marsarm.calibration.calibrate import calibrate, rms_m
from marsarm.calibration.campaign_data import MeasuredPoses
from marsarm.calibration.execution import check_data, check_fit
from marsarm.calibration.residual_model import residual_model
from marsarm.calibration.verify import compare_with_truth, hardstop_errors_rad
from sim.arms import arm_named
from tests.marsarm.calibration.lab import NOMINAL, calibration, campaign

pytestmark = pytest.mark.slow
SEEDS = (1, 2)


@pytest.mark.parametrize("seed", SEEDS)
def test_an_as_built_arm_is_calibrated(seed):
    check_data(NOMINAL, campaign(seed))
    found = calibration(seed)
    check_fit(found)
    known = ~found.unknown.any(axis=0)[found.held_out_poses]
    held_out = found.held_out_error[:, known]
    before = found.before[:, found.held_out_poses][:, known]
    assert rms_m(before) > 5 * rms_m(held_out)
    assert np.linalg.norm(held_out[3:], axis=0).max() < 5e-3
    assert found.hold_out.ratio < 1.3


def test_the_frames_have_rank_26_of_42_and_what_is_one_is_named_as_one():
    found = calibration()
    assert found.frame_identifiability.rank == 26
    # deflection makes other combinations visible, but far less
    s = found.frame_identifiability.singular_values
    assert s[25] > 10 * s[26]
    groups = {
        frozenset(group.names): group.identified
        for group in found.frame_identifiability.unidentifiable_groups()
    }
    assert groups[frozenset({"arm2.tz", "arm3.tz", "arm4.tz", "arm5.ty"})] == 1
    assert groups[frozenset({"arm1.rz", "arm2.ry"})] == 1
    assert sum(len(names) - identified for names, identified in groups.items()) == 42 - 26


@pytest.mark.parametrize("seed", SEEDS)
def test_the_true_arm_lies_where_the_covariance_says(seed):
    """Nine of ten 90 % intervals contain the truth, for the combinations that the data determine."""
    arm = arm_named(f"as-built:{seed}")
    sigmas = compare_with_truth(arm, calibration(seed), hardstop_errors_rad(arm)).sigmas
    low, high = binom.interval(0.999, sigmas.size, 0.9)
    assert sigmas.size >= 26
    assert low <= np.sum(np.abs(sigmas) < 1.645) <= high


def test_with_the_backlash_state_left_out_shoulder_in_poses_stand_apart():
    found = calibration()
    model = residual_model(NOMINAL, found.campaign, with_backlash=False)
    off = np.linalg.norm(model.errors(found.best.values)[3:], axis=0)
    inside = np.array([branch.startswith("shoulder-in") for branch in found.campaign.branch])
    assert np.median(off[inside]) > 2 * np.median(off[~inside])
    assert np.median(off[inside]) > 2e-3


def test_without_backlash_state_the_fit_is_refused():
    with pytest.raises(ValueError, match=r"times the noise|no arm explains them"):
        check_fit(calibrate(NOMINAL, campaign().at(np.arange(0, 160, 4)), with_backlash=False))


def test_wrong_poses_are_left_out_and_named():
    clean = campaign()
    X = Pose(clean.measured.X_RT.R, clean.measured.X_RT.p.copy())
    for pose, axis, off_m in ((20, 0, 2e-3), (77, 1, -3e-3), (140, 2, 5e-3)):
        X.p[axis, pose] += off_m
    found = calibrate(NOMINAL, replace(clean, measured=MeasuredPoses(X, clean.measured.covariance)))
    assert set(found.outliers) == {20, 77, 140}
    np.testing.assert_allclose(rms_m(found.after[:, found.best.used]), rms_m(calibration().after), rtol=0.5)
