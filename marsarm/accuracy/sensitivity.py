"""Sensitivity of the tool to errors at the frames: paper equations 7 to 9.

Errors at the tool are screws (6, ...) in tool axes, rotation first. The x axis is the approach, so the
translation along x is normal, and translations along y and z are lateral.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Frame
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, frame_jacobian, tool_pose
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, adjoint, rotate
from marsarm.accuracy.sources import ErrorSource
from sim.frames import approach_from, p_R_from_N, random_targets

BRANCHES_A_TARGET: Final = 3
"""Assumed number of valid branches of a target; below the mean, so that one draw usually suffices."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Joint angles that bring a tool to targets of the workspace."""

    tool: str
    output_rad: Array
    """Joint angles of the deflected arm, shape (5, n)."""
    p_NoTo_N_m: Array
    """Positions of the tool in RNAV, shape (3, n)."""


def workspace_poses(arm: Arm, tool: str, gravity_R_m_s2: Array, count: int, seed: int) -> Poses:
    """Draw poses of a tool over the workspace; the result depends only on the arguments.

    Args:
        arm: Arm that deflects under gravity.
        tool: Tool to place.
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
        count: Number of poses.
        seed: Seed of the targets.

    Returns:
        The poses.
    """
    rng = np.random.default_rng([seed, list(arm.X_FT).index(tool)])
    outputs, targets = np.zeros((5, 0)), np.zeros((3, 0))
    while outputs.shape[1] < count:
        p_N_m, angles = random_targets(rng, -(-count // BRANCHES_A_TARGET))
        results = inverse_kinematics(arm, tool, p_R_from_N(p_N_m.T).T, approach_from(angles), gravity_R_m_s2)
        valid = results.verdict.T == BranchVerdict.VALID  # target by target, then branch by branch
        found = np.moveaxis(results.output_rad, 1, -1)[:, valid]
        outputs = np.concatenate([outputs, found], axis=1)
        targets = np.concatenate([targets, p_N_m[:, np.nonzero(valid)[0]]], axis=1)
    return Poses(tool, outputs[:, :count], targets[:, :count])


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Derivatives of the tool pose at each pose, in tool axes."""

    J: Array
    """Derivatives by a small screw of each frame in its own axes, shape (6, 6, 7, n)."""
    deflection: Array
    """Tool motion by the full load deflection of each link with its gear, shape (6, 7, n)."""
    expansion_1_K: Array
    """Tool motion by thermal expansion of each link per kelvin, shape (6, 7, n)."""
    side: Array
    """Side of the backlash where load holds each output, +1 or -1; 0 if friction may hold it; (5, n)."""

    def errors(self, source: ErrorSource) -> Array:
        """Compute the signed independent errors of a source at its magnitude, shape (6, k, n)."""
        match source.relative_to:
            case "frames":
                theta = source.theta
                where = np.nonzero(theta)
                return self.J[:, where[0], where[1]] * theta[where][:, None]
            case "load":
                return source.share_by_frame[:, None] * self.deflection
            case "temperature":
                return source.share_by_frame[:, None] * source.warming_K * self.expansion_1_K

    def errors_by_frame(self, source: ErrorSource) -> Array:
        """Compute the absolute errors |J| theta of a source at each frame, shape (6, 7, n)."""
        if source.relative_to == "frames":
            return np.asarray(np.einsum("ikjn,kj->ijn", np.abs(self.J), source.theta))
        return np.abs(self.errors(source))


def compute_sensitivity(config: Config, poses: Poses, gravity_R_m_s2: Array) -> Sensitivity:
    """Compute the sensitivity of the tool of the deflected arm.

    Args:
        config: Configuration with the arm.
        poses: Poses of one tool.
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).

    Returns:
        The sensitivity.
    """
    arm = config.arm
    deflected = settle_output(arm, poses.output_rad, gravity_R_m_s2)
    X_RT = tool_pose(arm, deflected.frames, poses.tool)
    J = frame_jacobian(deflected.frames, X_RT)
    expansion = np.concatenate(
        [arm.expansion_F, arm.expansion_T[:, [list(arm.X_FT).index(poses.tool)]]], axis=1
    )
    growth = np.einsum("ikjn,kj->ijn", J, expansion)
    deflection = np.zeros((6, len(Frame), poses.output_rad.shape[1]))
    deflection[:, :-1] = np.einsum(
        "ikjn,kjn->ijn", _spring_jacobian(deflected.frames, X_RT), deflected.strain
    )
    # the joint of link j + 1 rotates about the z axis of frame j
    deflection[:, :5] += J[:, 2, :5] * (deflected.torque_Nm / arm.gear_stiffness_Nm_rad[:, None])
    turn = X_RT.R.swapaxes(0, 1)
    held = np.abs(deflected.torque_Nm) > config.output_friction_Nm[:, None]
    return Sensitivity(
        _rotate_screws(turn[:, :, None, None], J),
        _rotate_screws(turn[:, :, None], deflection),
        _rotate_screws(turn[:, :, None], growth),
        np.sign(deflected.torque_Nm) * held,
    )


def _spring_jacobian(frames: Frames, X_RT: Pose) -> Array:
    """Compute the screws of the tool by the strain of each link spring, (6, 6, 6, n), in rover axes."""
    spring = rotate(frames.X_RL.R, frames.X_LD.p) + frames.X_RL.p
    return adjoint(Pose(frames.X_RL.R, spring - X_RT.p[:, None]))


def _rotate_screws(R: Array, screw: Array) -> Array:
    """Rotate screws (6, ...) into other axes."""
    return np.concatenate([rotate(R, screw[:3]), rotate(R, screw[3:])])
