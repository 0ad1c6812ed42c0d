"""The azimuths of the closed form: the lateral condition and the wrist's sine, near its fold as well."""

import numpy as np
import pytest

from fsw.kinematics.azimuth import (
    solve_azimuth_near,
    solve_azimuths,
    solve_offset_azimuth_near,
    solve_offset_azimuths,
)
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import to_shoulder_frame
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.rig import config_of, in_limits
from validation.kinematics_samples import draw_vectors
from validation.kinematics_trials import Trial, skew_tool

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


def hard(arm):
    """Draw joint vectors near and far from double roots."""
    return draw_vectors(Trial("", arm, "drill", None), np.random.default_rng(2), N)[0]


def lateral_condition(s, foot, a, q1, sine):
    lateral_m = foot[0] * np.sin(q1) - foot[1] * np.cos(q1) + s.offset_m * sine - s.lateral_m
    a_n = a[0] * np.sin(q1) - a[1] * np.cos(q1)
    return lateral_m, sine**2 + s.boresight_z**2 + a_n**2 - 1


@ARMS
def test_where_nothing_is_missing_both_conditions_are_met(arm, find):
    s, foot, a, *_ = feet(arm, hard(arm))
    q1, sine, missing = find(s, foot, a)
    assert q1.shape == sine.shape == missing.shape == (2, 2, N)
    lateral_m, unit = (np.abs(v) for v in lateral_condition(s, foot, a, q1, sine))
    there = missing == 0
    # beyond, no wrist has this azimuth: its sine is clipped to 0
    real = there & (np.abs(sine) > 0)
    assert lateral_m[there].max() < 2e-12
    assert unit[real].max() < 1e-11
    assert there.mean() > 0.5


@ARMS
def test_the_azimuth_and_the_sine_of_the_pose_are_among_them(arm, find):
    s, foot, a, azimuth, sine_there = feet(arm, in_limits(config_of(), np.random.default_rng(3), N))
    q1, sine, missing = find(s, foot, a)
    apart = np.maximum(np.abs(wrap_angle(q1 - azimuth)), np.abs(sine - sine_there))
    assert np.where(missing == 0, apart, np.inf).min(axis=(0, 1)).max() < 1e-6


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


@pytest.mark.parametrize(
    ("arm", "near"),
    [(DRAWING, solve_azimuth_near), (SKEW, solve_offset_azimuth_near)],
    ids=["radial", "offset"],
)
def test_from_beside_an_azimuth_one_comes_back_to_it(arm, near):
    rng = np.random.default_rng(5)
    s, foot, a, azimuth, sine_there = feet(arm, in_limits(config_of(), rng, N))
    ahead_m = foot[0] * np.cos(azimuth) + foot[1] * np.sin(azimuth)
    clear = (np.abs(sine_there) > 0.2) & (np.abs(ahead_m) > 0.2)
    foot, a, azimuth, sine_there = (v[..., clear] for v in (foot, a, azimuth, sine_there))
    beside = azimuth + rng.uniform(-0.01, 0.01, azimuth.shape)
    q1, sine, missing = near(s, foot, a, np.sign(sine_there), beside)
    assert clear.sum() > N / 3
    assert np.abs(wrap_angle(q1 - azimuth)).max() < 1e-9
    assert np.abs(sine - sine_there).max() < 1e-9
    assert missing.max() < 1e-9


def test_a_foot_nearer_than_the_lateral_offset_is_missing_the_difference():
    s = DRAWING.orthogonal["drill"]
    _, _, missing = solve_azimuths(s, np.array([0.03, 0.04, 0.5]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(missing, abs(s.lateral_m) - 0.05, atol=1e-15)
