"""The load on the joints and the deflected tool pose, at a lower rate than the cycle."""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.dictionary.channels import ToolChannels
from fsw.dictionary.joints import Tool
from fsw.estimate.joints import JointEstimate, loaded
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import Push, load, rest
from fsw.kinematics.transforms import Array


@dataclass(frozen=True, slots=True, eq=False)
class LoadEstimate:
    """Spring strains (6, 6), links second, and joint torques (5)."""

    known: bool
    """Whether there was a look at the load; the first one converges, later ones only follow."""
    strain: Array
    torque_Nm: Array
    of_push_Nm: Array
    """The part of it that a press causes."""


def unloaded(n: int) -> LoadEstimate:
    """No load known yet."""
    return LoadEstimate(False, np.zeros((6, n + 1)), np.zeros(n), np.zeros(n))


def refresh(
    config: Config, tick: int, tool: Tool, joints: JointEstimate, last: LoadEstimate, push: Push | None = None
) -> tuple[LoadEstimate, JointEstimate, ToolChannels]:
    """One pass of the statics at the present outputs: load, bounds of the gears, and the tool channels."""
    arm, output = config.arm, joints.output_rad
    strain = last.strain if last.known else rest(arm, output, joints.gravity_R_m_s2).strain
    frames = forward(arm, output, strain)
    strain, torque = load(arm, frames, joints.gravity_R_m_s2, push)
    of_push, unsure = np.zeros_like(torque), None
    if push is not None:
        of_push = torque - load(arm, frames, joints.gravity_R_m_s2)[1]
        unsure = _unsure(config, of_push, push)
    X_RT = tool_pose(arm, frames, tool)
    channels = ToolChannels(tick, tool, X_RT.p, X_RT.R, output, torque)
    return LoadEstimate(True, strain, torque, of_push), loaded(config, joints, torque, unsure), channels


def _unsure(config: Config, of_push_Nm: Array, push: Push) -> Array:
    """By how much the loads (5) of a press may be off: no sensor feels the force."""
    force_N, preload = float(np.linalg.norm(push.force_R_N)), config.params.preload
    unsure: Array = np.abs(of_push_Nm) * (
        max(preload.error_share * force_N, preload.error_N) / max(force_N, 1e-9)
    )
    return unsure
