"""The task of the inverse kinematics: a tool's position and approach, as an error with a derivative."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, forward, joint_jacobian, tool_pose
from fsw.kinematics.statics import compute_load
from fsw.kinematics.transforms import Array, Pose, cross, dot, rotate_back

ROOT_TOLERANCE: Final = 5e-10
"""Forward check of a root: position [m] and axis [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseEvaluation:
    """What the hanging arm does at some joint angles, batch (n,)."""

    frames: Frames
    X_RT: Pose
    """The tool once the springs have taken the load that was found, to first order."""
    strain: Array
    """(6, 6, n), under that load."""
    torque_Nm: Array
    """(5, n)."""
    strain_change: Array
    """(n,): by how much the load changed the strain that was assumed."""


def evaluate_pose(
    arm: Arm, tool: int, output_rad: Array, strain: Array | None, gravity_R_m_s2: Array
) -> PoseEvaluation:
    """One pass of load and deflection at angles (5, n), from an assumed strain (6, 6, n) or from none."""
    frames = forward(arm, output_rad, strain)
    X_RT = tool_pose(arm, frames, tool)
    n = output_rad.shape[1]
    if not gravity_R_m_s2.any():
        return PoseEvaluation(frames, X_RT, np.zeros((6, 6, n)), np.zeros_like(output_rad), np.zeros(n))
    new_strain, torque = compute_load(arm, frames, gravity_R_m_s2)
    change = new_strain if strain is None else new_strain - strain
    strain_change = np.abs(change).reshape(36, n).max(axis=0)
    return PoseEvaluation(frames, _deflect_tool(frames, change, X_RT), new_strain, torque, strain_change)


def _deflect_tool(frames: Frames, change: Array, X_RT: Pose) -> Pose:
    """Where the tool will be when the springs have taken a small change of strain (6, 6, n): first order."""
    R_RL = frames.X_RL.R
    lever_L_m = rotate_back(R_RL, X_RT.p[:, None] - frames.X_RL.p) - frames.X_LD.p
    screw_L = change.reshape(2, 3, *change.shape[1:]).copy()
    screw_L[1] += cross(screw_L[0], lever_L_m)
    turn, shift_m = np.einsum("ijl...,kjl...->ki...", R_RL, screw_L)
    return Pose(X_RT.R + cross(turn[:, None], X_RT.R), X_RT.p + shift_m)


def task_error(X_RT: Pose, p_RoTo_R_m: Array, approach_R: Array) -> Array:
    """Position error and the approach's components along the tool's y and z axes, (5, ...)."""
    miss = X_RT.p - p_RoTo_R_m
    along = np.einsum("ij...,i...->j...", X_RT.R, np.broadcast_to(approach_R, miss.shape))
    # pointing the other way has the same zero components: make it large, so that it is never an answer
    away = np.copysign(along[:1] < 0, along[1:2])
    return np.concatenate([miss, along[1:2] + away, along[2:]])


def task_jacobian(frames: Frames, X_RT: Pose, approach_R: Array) -> Array:
    """Derivative of task_error by the joint angles, springs held, (5, 5, ...)."""
    J = joint_jacobian(frames, X_RT.p)
    a = np.broadcast_to(approach_R, X_RT.p.shape)
    # (w x y) . a = w . (y x a)
    turning = [dot(cross(X_RT.R[:, k], a)[:, None], J[:3]) for k in (1, 2)]
    return np.concatenate([J[3:], np.stack(turning)])
