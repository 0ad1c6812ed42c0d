"""The azimuths of the closed form: the lateral condition and the wrist's sine, near its fold as well."""

import numpy as np
import pytest

from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import solve_azimuths, solve_offset_azimuths, to_shoulder_frame
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.rig import config_of, in_limits
from validation.kinematics import skew_tool

N = 1000
DRAWING = config_of().arm
SKEW = skew_tool(3)
ARMS = pytest.mark.parametrize(
    ("arm", "find"), [(DRAWING, solve_azimuths), (SKEW, solve_offset_azimuths)], ids=["radial", "offset"]
)


def feet(arm, q):
    """Compute foot and approach in frame Arm1, with azimuth and wrist sine of the poses."""
    s = arm.orthogonal["drill"]
    frames = forward(arm, q)
    X = tool_pose(arm, frames, "drill")
    p, a = to_shoulder_frame(s, X.p, X.R[:, 0])
    n, z5 = frames.X_RF.R[:, 2, 1], frames.X_RF.R[:, 2, 4]
    sine = np.sum(np.cross(n, X.R[:, 0], axis=0) * z5, axis=0)
    return s, p - s.radius_m * a, a, q[0] + s.theta_rad[0], sine


@pytest.mark.parametrize("sine", [1e-1, 1e-3, 1e-5, 1e-7])
@ARMS
def test_near_the_wrist_s_fold_its_sine_is_that_of_the_pose(arm, find, sine):
    """The square of the sine has lost half its digits there; the azimuth has not."""
    s = arm.orthogonal["drill"]
    q = in_limits(config_of(), np.random.default_rng(4), N)
    lean = np.sqrt(1 - s.boresight_z**2)
    q[4] = np.arccos(sine / lean) - s.clock_rad
    s, foot, a, azimuth, sine_there = feet(arm, q)
    np.testing.assert_allclose(np.abs(sine_there), sine, rtol=1e-6)
    q1, found, missing = find(s, foot, a)
    apart = np.maximum(np.abs(wrap_angle(q1 - azimuth)), np.abs(found - sine_there))
    nearest = np.where(missing == 0, apart, np.inf).min(axis=(0, 1))
    assert np.quantile(nearest, 0.99) < 1e-10
