"""Relative compensation: only the difference of deflection between two poses counts."""

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array, compose, rotate


def relative_target(
    arm: Arm,
    reference_tool: int,
    reference_rad: Array,
    gravity_R_m_s2: Array,
    p_RoTo_R_m: Array,
    approach_R: Array,
) -> tuple[Array, Array]:
    """The target to give to the absolute inverse if only the difference from a reference pose is to count.

    At the reference pose (outputs, 5) the reference tool is known to be in place, whatever the deflection
    there. So that deflection, the displacement of the tool from rigid to deflected, is counted to the world:
    the target (3, ...) moves along with it.
    """
    rigid = tool_pose(arm, forward(arm, reference_rad), reference_tool)
    deflected = tool_pose(arm, rest(arm, reference_rad, gravity_R_m_s2).frames, reference_tool)
    turn = compose(deflected.R, np.swapaxes(rigid.R, 0, 1))
    ones = (1,) * (p_RoTo_R_m.ndim - 1)
    pivot, shifted = rigid.p.reshape(3, *ones), deflected.p.reshape(3, *ones)
    turn = turn.reshape(3, 3, *ones)
    return rotate(turn, p_RoTo_R_m - pivot) + shifted, rotate(turn, approach_R)
