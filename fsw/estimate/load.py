"""The load on the joints and the deflected tool pose, at a lower rate than the cycle."""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config
from fsw.dictionary.channels import ToolChannels
from fsw.dictionary.joints import Tool
from fsw.estimate.joints import JointEstimate, gap_after, load_side
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import load
from fsw.kinematics.transforms import Array


@dataclass(frozen=True, slots=True, eq=False)
class LoadEstimate:
    """Spring strains (6, 6), links second, and joint torques (5); they converge over a few refreshes."""

    strain: Array
    torque_Nm: Array


def unloaded(n: int) -> LoadEstimate:
    """No load known yet."""
    return LoadEstimate(np.zeros((6, n + 1)), np.zeros(n))


def refresh(
    config: Config, tick: int, tool: Tool, joints: JointEstimate, last: LoadEstimate
) -> tuple[LoadEstimate, JointEstimate, ToolChannels]:
    """One pass of the statics at the present angles: load, side of the gaps, and the tool channels."""
    arm = config.arm
    output = joints.motor_rad + joints.gap_rad + last.torque_Nm / arm.gear_stiffness_Nm_rad
    frames = forward(arm, output, last.strain)
    strain, torque = load(arm, frames, joints.gravity_R_m_s2)
    X_RT = tool_pose(arm, frames, tool)
    channels = ToolChannels(tick, tool, X_RT.p, X_RT.R, output, torque)
    side = load_side(config, torque)
    gap = gap_after(config, side, joints.gap_rad, np.zeros_like(side))
    return LoadEstimate(strain, torque), replace(joints, load_side=side, gap_rad=gap), channels
