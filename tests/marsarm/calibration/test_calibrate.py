"""Calibration of as-built arms: the checks of the campaign, groups, and outliers."""

from dataclasses import replace

import numpy as np
import pytest

import validation.calibration
from fsw.kinematics.transforms import Pose
from marsarm.calibration.calibrate import calibrate, rms_m
from marsarm.calibration.campaign_data import MeasuredPoses
from marsarm.calibration.execution import check_fit
from simgap.common.errors import UserError
from tests.marsarm.calibration.lab import NOMINAL, calibration, campaign
from validation.campaigns import Context

pytestmark = pytest.mark.slow


def test_as_built_arms_are_calibrated_and_lie_where_the_covariance_says():
    """Held-out poses, intervals, rank, and poses without the state of the backlash, as in the campaign."""
    found = validation.calibration.campaign(Context(1), arms=2)
    assert all(found["checks"].values()), found["checks"]


def test_the_frames_have_rank_26_of_42_and_what_is_one_is_named_as_one():
    found = calibration()
    assert found.frame_identifiability.rank == 26
    # deflection makes other combinations visible, but far less
    s = found.frame_identifiability.singular_values
    assert s[25] > 10 * s[26]
    unseen = found.frame_identifiability.unidentifiable_groups()
    groups = {frozenset(group.names): group.identified for group in unseen}
    assert groups[frozenset({"arm2.tz", "arm3.tz", "arm4.tz", "arm5.ty"})] == 1
    assert groups[frozenset({"arm1.rz", "arm2.ry"})] == 1
    assert sum(len(names) - identified for names, identified in groups.items()) == 42 - 26


def test_without_backlash_state_the_fit_is_refused():
    with pytest.raises(UserError, match=r"times the noise|no arm explains them"):
        check_fit(calibrate(NOMINAL, campaign().at(np.arange(0, 160, 4)), with_backlash=False))


def test_wrong_poses_are_left_out_and_named():
    clean = campaign()
    X = Pose(clean.measured.X_RT.R, clean.measured.X_RT.p.copy())
    for pose, axis, off_m in ((20, 0, 2e-3), (77, 1, -3e-3), (140, 2, 5e-3)):
        X.p[axis, pose] += off_m
    found = calibrate(NOMINAL, replace(clean, measured=MeasuredPoses(X, clean.measured.covariance)))
    assert set(found.outliers) == {20, 77, 140}
    np.testing.assert_allclose(rms_m(found.after[:, found.best.used]), rms_m(calibration().after), rtol=0.5)
