"""The general link transform, the arm of the drawing, and its thermal expansion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Transform6
from fsw.kinematics.arm import heat_arm, pose_to_transform6, transform6_to_pose
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.transforms import Pose, rotation_x, rotation_y, rotation_z
from tests.fsw.rig import config_of, in_limits, matrix
from tests.tools import tool_index

# standard DH of the drawing: a [m], d [m], alpha [deg]; MSL-476-1303
DH = {
    Joint.AZIMUTH: (0.156, 0.0, 90.0),
    Joint.ELEVATION: (0.827, 0.0, 0.0),
    Joint.ELBOW: (0.785, 0.0, 0.0),
    Joint.WRIST: (-0.144, -0.1664, -90.0),
    Joint.TURRET: (0.0, -0.1697, 0.0),
}
SHOULDER_R_M = (1.11285, -0.4515, 0.2660)
# angle [deg], radius [m], z [m]
TOOLS = {
    "drill": (0.0, 0.360, -0.0718),
    "drt": (70.25, 0.299, -0.0868),
    "mahli": (122.5, 0.2973, -0.0798),
    "apxs": (-133.0, 0.2983, -0.0771),
    "portion": (-89.79, 0.2761, -0.1105),
}
MAHLI_CLOCK_DEG = 120.0
SOFT_LIMITS_DEG = [(-180.2, 91.2), (-187.2, 7.2), (-164.2, 164.2), (-190.2, 210.2), (-20.2, 330.0)]

lengths = st.floats(-2, 2)
turns = st.floats(-3.1, 3.1)


def dh(theta: float, a_m: float, d_m: float, alpha_deg: float) -> np.ndarray:
    """Compute Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    c, s = np.cos(theta), np.sin(theta)
    ca, sa = np.cos(np.radians(alpha_deg)), np.sin(np.radians(alpha_deg))
    return np.array(
        [[c, -s * ca, s * sa, a_m * c], [s, c * ca, -c * sa, a_m * s], [0, sa, ca, d_m], [0, 0, 0, 1]]
    )


def turn(R: np.ndarray) -> np.ndarray:
    return matrix(Pose(R, np.zeros(3)))


def translation(p_m) -> np.ndarray:
    return matrix(Pose(np.eye(3), np.array(p_m)))


def drawn_interface(output_rad) -> np.ndarray:
    """Compute X_RF of the turret interface from the drawing."""
    X = translation(SHOULDER_R_M)
    for joint, angle in zip(Joint, output_rad, strict=True):
        X = X @ dh(angle, *DH[joint])
    return X


def drawn_tool(tool: str) -> np.ndarray:
    angle_deg, radius_m, z_m = TOOLS[tool]
    X = turn(rotation_z(np.radians(angle_deg))) @ translation([radius_m, 0, z_m])
    clock = MAHLI_CLOCK_DEG if tool == "mahli" else 0.0
    return X @ turn(rotation_x(np.radians(clock)))


@given(turns, lengths, st.floats(-1.5, 1.5), lengths, turns, lengths)
def test_the_link_transform_is_equation_1_of_the_paper_and_its_numbers_come_back(theta, d, beta, b, alpha, a):
    link = Transform6(theta, d, beta, b, alpha, a)
    expected = (
        turn(rotation_z(np.array(theta)))
        @ translation([0, 0, d])
        @ turn(rotation_y(np.array(beta)))
        @ translation([0, b, 0])
        @ turn(rotation_x(np.array(alpha)))
        @ translation([a, 0, 0])
    )
    np.testing.assert_allclose(matrix(transform6_to_pose(link)), expected, atol=1e-12)
    back = pose_to_transform6(transform6_to_pose(link))
    for name in Transform6.__slots__:
        assert getattr(back, name) == pytest.approx(getattr(link, name), abs=1e-11 / np.cos(beta))


def test_the_nominal_soft_limits_are_those_of_the_table():
    arm = config_of().arm
    np.testing.assert_allclose(
        np.degrees(np.stack([arm.soft_min_rad, arm.soft_max_rad], axis=1)), SOFT_LIMITS_DEG, atol=1e-9
    )


def test_the_calibrated_arm_uses_all_six_numbers_of_its_links():
    links = config_of("calibrated:3").params.links.in_order()
    for link in links:
        assert all(getattr(link.transform, name) != 0 for name in Transform6.__slots__)


TITANIUM_1_K = 8.6e-6
ALUMINIUM_1_K = 23e-6


def tool_position(arm, q, tool):
    return tool_pose(arm, forward(arm, q), tool).p


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("warming_K", [100.0, -130.0])
def test_warming_scales_the_titanium_about_the_shoulder_and_the_body_about_the_rover(tool, warming_K):
    arm = config_of().arm
    warm = heat_arm(arm, warming_K)
    shoulder = np.array(SHOULDER_R_M)[:, None]
    q = in_limits(config_of(), np.random.default_rng(6), 50)
    cold = tool_position(arm, q, tool)
    expected = cold + warming_K * (ALUMINIUM_1_K * shoulder + TITANIUM_1_K * (cold - shoulder))
    np.testing.assert_allclose(tool_position(warm, q, tool), expected, atol=1e-13)


def test_a_warm_tool_turns_as_its_screw_says():
    """The expansion has a rotation, which the drawing has not: a finite turn about the tool's z axis."""
    arm = config_of().arm
    expansion = np.zeros((6, 5))
    expansion[2, tool_index("apxs")] = 1e-3
    warm = heat_arm(replace(arm, expansion_T=expansion), 100.0)
    X, Y = arm.X_FT["apxs"], warm.X_FT["apxs"]
    np.testing.assert_allclose(X.R.T @ Y.R, rotation_z(np.array(0.1)), atol=1e-15)
    np.testing.assert_array_equal(Y.p, X.p)
    np.testing.assert_array_equal(warm.X_FT["drt"].R, arm.X_FT["drt"].R)
