"""Frames, chains, transforms and arms, against the paper, finite differences and each other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Transform6
from fsw.kinematics.arm import heat_arm, pose_to_transform6, transform6_to_pose
from fsw.kinematics.chain import forward, frame_jacobian, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Pose, rotation_x, rotation_y, rotation_z, screw_exp
from helpers.marks import slow_but
from tests.fsw.rig import config_of, in_limits, matrix
from tests.tools import TOOLS, tool_index

STRAIN = 0.03
STEP = 1e-6
ARMS = ["nominal", "calibrated:3"]


def spring(strain) -> np.ndarray:
    """Compute the pose of a spring that translates, then turns about x, y and z in this order."""
    turns = rotation_x(strain[0]) @ rotation_y(strain[1]) @ rotation_z(strain[2])
    return translation(strain[3:]) @ turn(turns)


def differentiate(pose, size):
    """Differentiate a pose by its coordinates at zero: rotation vectors and velocities, (6, size)."""
    X, columns = pose(np.zeros(size)), []
    for e in STEP * np.eye(size):
        up, down = pose(e), pose(-e)
        W = (up.R - down.R) / (2 * STEP) @ X.R.T
        columns.append([W[2, 1], W[0, 2], W[1, 0], *(up.p - down.p) / (2 * STEP)])
    return np.transpose(columns)


def test_the_rigid_arm_is_the_product_of_its_dh_matrices():
    config = config_of()
    for q in in_limits(config, np.random.default_rng(1), 200).T:
        frames = forward(config.arm, q)
        np.testing.assert_allclose(matrix(frames.X_RF[5]), drawn_interface(q), atol=1e-12)
        for tool in TOOLS:
            np.testing.assert_allclose(
                matrix(tool_pose(config.arm, frames, tool)), drawn_interface(q) @ drawn_tool(tool), atol=1e-12
            )


@pytest.mark.parametrize("name", ARMS)
def test_the_strained_arm_is_the_product_of_links_and_springs(name):
    config, rng = config_of(name), np.random.default_rng(2)
    for q in in_limits(config, rng, 20).T:
        strain = rng.normal(0, STRAIN, (6, 6))
        frames = forward(config.arm, q, strain)
        X = np.eye(4)
        for i, link in enumerate(config.params.links.in_order()):
            about_z = turn(rotation_z(np.array(link.transform.theta_rad)))
            centre = np.array(link.elastic_centre_m)
            rest = np.linalg.inv(about_z) @ matrix(transform6_to_pose(link.transform))
            X = X @ turn(rotation_z(np.array(0.0 if i == 0 else q[i - 1]))) @ about_z
            np.testing.assert_allclose(matrix(frames.X_RL[i]), X, atol=1e-12)
            X = X @ translation(centre) @ spring(strain[:, i]) @ translation(-centre) @ rest
            np.testing.assert_allclose(matrix(frames.X_RF[i]), X, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("tool", TOOLS)
def test_the_jacobian_agrees_with_finite_differences(name, tool):
    config, rng = config_of(name), np.random.default_rng(4)
    for q in in_limits(config, rng, 10).T:
        strain = rng.normal(0, STRAIN, (6, 6))

        def pose(step, q=q, strain=strain):
            return tool_pose(config.arm, forward(config.arm, q + step, strain), tool)

        J = joint_jacobian(forward(config.arm, q, strain), pose(0.0).p)
        np.testing.assert_allclose(J, differentiate(pose, 5), atol=1e-8)


def displaced(arm, frame, tool, screw):
    """Move one frame, and all that it carries, by a screw in the frame's own axes."""
    X = screw_exp(screw)
    if frame is Frame.TOOL:
        return replace(arm, X_FT={**arm.X_FT, tool: arm.X_FT[tool] @ X})
    RP_CF, X_CF = arm.RP_CF.copy(), arm.X_CF[int(frame)] @ X
    RP_CF[:, :3, frame], RP_CF[:, 3, frame] = X_CF.R, X_CF.p
    return replace(arm, RP_CF=RP_CF)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("tool", slow_but(TOOLS, "drill"))
@pytest.mark.parametrize("frame", Frame)
def test_the_jacobian_of_every_frame_agrees_with_finite_differences(name, tool, frame):
    config, rng = config_of(name), np.random.default_rng(6)
    for q in in_limits(config, rng, 5).T:
        strain = rng.normal(0, STRAIN, (6, 6))

        def pose(screw, q=q, strain=strain):
            arm = displaced(config.arm, frame, tool, screw)
            return tool_pose(arm, forward(arm, q, strain), tool)

        J = frame_jacobian(forward(config.arm, q, strain), pose(np.zeros(6)))[:, :, frame]
        np.testing.assert_allclose(J, differentiate(pose, 6), atol=1e-8)


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
