"""From errors at the frames to errors at the tool: paper equations 7 to 9.

Errors at the tool are screws (6, ...) in the tool's own axes, turns first; its x axis is the approach, so the
shift along x is normal and those along y and z are lateral.
"""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Frame
from fsw.kinematics.chain import Frames, frame_jacobian, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, adjoint, rotate
from ground.accuracy.poses import Poses
from ground.accuracy.sources import Source


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """What moves the tool, pose by pose."""

    J: Array
    """By a small screw of each frame in its own axes, (6, 6, 7, n)."""
    sag: Array
    """What each link and gear yields under the load, (6, 7, n): the deflection whole, not a share of it."""
    growth_1_K: Array
    """What each link grows by, a kelvin, (6, 7, n)."""
    side: Array
    """On which flank of its gap its load holds each output, +1 or -1; 0 where friction may; (5, n)."""

    def of(self, source: Source) -> Array:
        """The errors (6, k, n) of a source at its magnitude: of independent kinds, with their signs."""
        match source.of:
            case "frames":
                theta = source.theta
                where = np.nonzero(theta)
                return self.J[:, where[0], where[1]] * theta[where][:, None]
            case "load":
                return source.share * self.sag
            case "temperature":
                return source.share * source.warming_K * self.growth_1_K

    def by_frame(self, source: Source) -> Array:
        """The errors (6, 7, n) of a source at each frame, as absolute components: |J| theta."""
        if source.of == "frames":
            return np.asarray(np.einsum("ikjn,kj->ijn", np.abs(self.J), source.theta))
        return np.abs(self.of(source))


def sensitivity(config: Config, poses: Poses, gravity_R_m_s2: Array) -> Sensitivity:
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
        _turned(turn[:, :, None, None], J),
        _turned(turn[:, :, None], sag),
        _turned(turn[:, :, None], growth),
        np.sign(hanging.torque_Nm) * held,
    )


def _spring_jacobian(frames: Frames, X_RT: Pose) -> Array:
    """Screw of the tool by what each link's spring yields, (6, 6, 6, n), in rover axes."""
    spring = rotate(frames.X_RL.R, frames.X_LD.p) + frames.X_RL.p
    return adjoint(Pose(frames.X_RL.R, spring - X_RT.p[:, None]))


def _turned(R: Array, screw: Array) -> Array:
    """Screws (6, ...) in other axes."""
    return np.concatenate([rotate(R, screw[:3]), rotate(R, screw[3:])])
