"""From errors at the frames to errors at the tool: paper equations 7 to 9.

Errors at the tool are screws (6, ...) in the tool's own axes, turns first; its x axis is the approach, so the
shift along x is normal and those along y and z are lateral.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Frame, Tool
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, frame_jacobian, tool_pose
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, adjoint, rotate
from ground.accuracy.sources import ErrorSource
from sim.frames import p_R_from_N
from sim.workspace import approach_from, random_targets

BRANCHES_A_TARGET: Final = 3
"""Fewer than the valid ones of a target on average, so that one draw is nearly always enough."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Joint angles that bring a tool to targets of the workspace."""

    tool: Tool
    output_rad: Array
    """(5, n), of the arm as it hangs."""
    p_NoTo_N_m: Array
    """(3, n)."""


def workspace_poses(arm: Arm, tool: Tool, gravity_R_m_s2: Array, count: int, seed: int) -> Poses:
    """So many poses of a tool; the same for the same seed."""
    rng = np.random.default_rng([seed, tool])
    outputs, targets = np.zeros((5, 0)), np.zeros((3, 0))
    while outputs.shape[1] < count:
        p_N_m, angles = random_targets(rng, -(-count // BRANCHES_A_TARGET))
        answers = inverse_kinematics(arm, tool, p_R_from_N(p_N_m.T).T, approach_from(angles), gravity_R_m_s2)
        valid = answers.verdict.T == BranchVerdict.VALID  # target by target
        found = np.moveaxis(answers.output_rad, 1, -1)[:, valid]
        outputs = np.concatenate([outputs, found], axis=1)
        targets = np.concatenate([targets, p_N_m[:, np.nonzero(valid)[0]]], axis=1)
    return Poses(tool, outputs[:, :count], targets[:, :count])


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """What moves the tool, pose by pose."""

    J: Array
    """By a small screw of each frame in its own axes, (6, 6, 7, n)."""
    deflection: Array
    """What each link and gear yields under the load, (6, 7, n): the deflection whole, not a share of it."""
    expansion_1_K: Array
    """What each link grows by, a kelvin, (6, 7, n)."""
    side: Array
    """On which flank of its gap its load holds each output, +1 or -1; 0 where friction may; (5, n)."""

    def errors(self, source: ErrorSource) -> Array:
        """The errors (6, k, n) of a source at its magnitude: of independent kinds, with their signs."""
        match source.relative_to:
            case "frames":
                theta = source.theta
                where = np.nonzero(theta)
                return self.J[:, where[0], where[1]] * theta[where][:, None]
            case "load":
                return source.share * self.deflection
            case "temperature":
                return source.share * source.warming_K * self.expansion_1_K

    def errors_by_frame(self, source: ErrorSource) -> Array:
        """The errors (6, 7, n) of a source at each frame, as absolute components: |J| theta."""
        if source.relative_to == "frames":
            return np.asarray(np.einsum("ikjn,kj->ijn", np.abs(self.J), source.theta))
        return np.abs(self.errors(source))


def compute_sensitivity(config: Config, poses: Poses, gravity_R_m_s2: Array) -> Sensitivity:
    """What moves the tool of the hanging arm at these poses."""
    arm = config.arm
    hanging = settle_output(arm, poses.output_rad, gravity_R_m_s2)
    X_RT = tool_pose(arm, hanging.frames, poses.tool)
    J = frame_jacobian(hanging.frames, X_RT)
    expansion = np.concatenate([arm.expansion_F, arm.expansion_T[:, [poses.tool]]], axis=1)
    growth = np.einsum("ikjn,kj->ijn", J, expansion)
    sag = np.zeros((6, len(Frame), poses.output_rad.shape[1]))
    sag[:, :-1] = np.einsum("ikjn,kjn->ijn", _spring_jacobian(hanging.frames, X_RT), hanging.strain)
    # the joint that moves link j + 1 turns about the z axis of frame j
    sag[:, :5] += J[:, 2, :5] * (hanging.torque_Nm / arm.gear_stiffness_Nm_rad[:, None])
    turn = X_RT.R.swapaxes(0, 1)
    held = np.abs(hanging.torque_Nm) > config.output_friction_Nm[:, None]
    return Sensitivity(
        _rotate_screws(turn[:, :, None, None], J),
        _rotate_screws(turn[:, :, None], sag),
        _rotate_screws(turn[:, :, None], growth),
        np.sign(hanging.torque_Nm) * held,
    )


def _spring_jacobian(frames: Frames, X_RT: Pose) -> Array:
    """Screw of the tool by what each link's spring yields, (6, 6, 6, n), in rover axes."""
    spring = rotate(frames.X_RL.R, frames.X_LD.p) + frames.X_RL.p
    return adjoint(Pose(frames.X_RL.R, spring - X_RT.p[:, None]))


def _rotate_screws(R: Array, screw: Array) -> Array:
    """Screws (6, ...) in other axes."""
    return np.concatenate([rotate(R, screw[:3]), rotate(R, screw[3:])])
