"""Task of the inverse kinematics: position and approach of a tool, as an error with a derivative."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, forward, joint_jacobian, tool_pose
from fsw.kinematics.statics import load_arm
from fsw.kinematics.transforms import Array, Pose, cross, dot, rotate_back

ROOT_TOLERANCE: Final = 5e-10
"""Bound of the forward check of a root: position [m] and axis [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseEvaluation:
    """Tool pose and load of the deflected arm at given joint angles, batch (n,)."""

    frames: Frames
    """Frames under the assumed strain."""
    X_RT: Pose
    """Tool pose under the new strain, to first order."""
    strain: Array
    """Strain under the load of these frames, (6, 6, n)."""
    torque_Nm: Array
    """Torque of the load on each output, (5, n)."""
    strain_change: Array
    """Largest difference between new and assumed strain, (n,)."""


def evaluate_pose(
    arm: Arm, tool: str, output_rad: Array, strain: Array | None, gravity_R_m_s2: Array
) -> PoseEvaluation:
    """Evaluate load and deflection once at given angles.

    Args:
        arm: Arm.
        tool: Name of the tool.
        output_rad: Output angles, shape (5, n).
        strain: Assumed strain in rad and m, shape (6, 6, n); None for the rigid arm.
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).

    Returns:
        Tool pose, new strain and joint torques.
    """
    n = output_rad.shape[1]
    if not gravity_R_m_s2.any():
        frames = forward(arm, output_rad, strain)
        X_RT = tool_pose(arm, frames, tool)
        return PoseEvaluation(frames, X_RT, np.zeros((6, 6, n)), np.zeros_like(output_rad), np.zeros(n))
    frames, new_strain, torque = load_arm(arm, output_rad, strain, gravity_R_m_s2)
    X_RT = tool_pose(arm, frames, tool)
    change = new_strain if strain is None else new_strain - strain
    strain_change = np.abs(change).reshape(36, n).max(axis=0)
    return PoseEvaluation(frames, _deflect_tool(frames, change, X_RT), new_strain, torque, strain_change)


def _deflect_tool(frames: Frames, change: Array, X_RT: Pose) -> Pose:
    """Compute the tool pose after a small change of strain (6, 6, n), to first order."""
    R_RL = frames.X_RL.R
    lever_L_m = rotate_back(R_RL, X_RT.p[:, None] - frames.X_RL.p) - frames.X_LD.p
    screw_L = change.reshape(2, 3, *change.shape[1:]).copy()
    screw_L[1] += cross(screw_L[0], lever_L_m)
    turn, shift_m = np.einsum("ijl...,kjl...->ki...", R_RL, screw_L)
    return Pose(X_RT.R + cross(turn[:, None], X_RT.R), X_RT.p + shift_m)


def task_error(X_RT: Pose, p_RoTo_R_m: Array, approach_R: Array) -> Array:
    """Compute the task error of tool poses.

    Args:
        X_RT: Poses of the tool, batch (...).
        p_RoTo_R_m: Target positions in the rover frame, shape (3, ...).
        approach_R: Approach directions, unit vectors in the rover frame, shape (3, ...).

    Returns:
        Position error in m, then the approach along the y and z axes of the tool in rad, shape (5, ...).
    """
    miss = X_RT.p - p_RoTo_R_m
    along = np.einsum("ij...,i...->j...", X_RT.R, np.broadcast_to(approach_R, miss.shape))
    # the opposite direction has the same zero components: a large error excludes it
    opposite = np.copysign(along[:1] < 0, along[1:2])
    return np.concatenate([miss, along[1:2] + opposite, along[2:]])


def task_jacobian(frames: Frames, X_RT: Pose, approach_R: Array) -> Array:
    """Compute the derivative of task_error by the joint angles, with the springs held.

    Args:
        frames: Frames of the arm.
        X_RT: Poses of the tool, batch (...).
        approach_R: Approach directions, unit vectors in the rover frame, shape (3, ...).

    Returns:
        The derivative, m/rad and rad/rad, shape (5, 5, ...).
    """
    J = joint_jacobian(frames, X_RT.p)
    a = np.broadcast_to(approach_R, X_RT.p.shape)
    # (w x y) . a = w . (y x a)
    turning = [dot(cross(X_RT.R[:, k], a)[:, None], J[:3]) for k in (1, 2)]
    return np.concatenate([J[3:], np.stack(turning)])


def approach_jacobian(frames: Frames, X_RT: Pose) -> Array:
    """Compute the derivative of position and approach of a tool by the joint angles, with the springs held.

    Args:
        frames: Frames of the arm.
        X_RT: Poses of the tool, batch (...).

    Returns:
        The derivative, m/rad and then 1/rad, shape (6, 5, ...).
    """
    J = joint_jacobian(frames, X_RT.p)
    return np.concatenate([J[3:], cross(J[:3], X_RT.R[:, :1])])
