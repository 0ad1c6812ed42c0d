"""From a tool target to a joint move: branch choice and compensation."""

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.dictionary.commands import MoveTool
from fsw.dictionary.joints import Tool
from fsw.estimate.joints import JointEstimate, gap_to_move
from fsw.kinematics.answers import Answers, Verdict, at_target, why
from fsw.kinematics.branches import BRANCHES
from fsw.kinematics.ik import inverse_kinematics
from fsw.kinematics.statics import settle
from fsw.motion.paths import joint_path
from fsw.motion.plan import Plan, Refusal, believed_gravity, motor_under

AUTO = "AUTO"


def plan_tool(config: Config, joints: JointEstimate, command: MoveTool) -> Plan | Refusal:
    """A joint move to the quickest valid branch from where the joints are, or to the named one.

    A branch is valid if the target and the end of the straight travel after it are within limits.
    """
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    along = np.array([0.0, command.line_m])
    targets = np.array(command.p_RoTo_R_m)[:, None] + approach[:, None] * along
    gravity = believed_gravity(joints, command.deflection)
    answers = inverse_kinematics(
        config.arm, command.tool, targets, np.tile(approach[:, None], 2), gravity, joints.motor_rad
    )
    valid = np.all(answers.verdict == Verdict.VALID, axis=-1)
    names = [BRANCHES[slot % len(BRANCHES)] for slot in range(len(valid))]
    wanted = np.array([command.branch in (AUTO, name) for name in names])
    if not np.any(valid & wanted):
        return Refusal(_why_none(config, command.tool, answers, wanted))
    output, torque = answers.output_rad[..., 0], answers.torque_Nm[..., 0]
    here = settle(config.arm, joints.motor_rad, joints.gap_rad, gravity)
    gap = gap_to_move(config, torque, joints.gap_rad[:, None], output - here.output_rad[:, None])
    motor = motor_under(config, output, torque, gap)
    travel_s = np.max(np.abs(motor - joints.motor_rad[:, None]) / config.speed_rad_s[:, None], axis=0)
    best = int(np.argmin(np.where(valid & wanted, travel_s, np.inf)))
    path = joint_path(config, joints.motor_rad, motor[:, best])
    return Plan((path,), motor[:, best], gap[:, best], names[best])


def _why_none(config: Config, tool: Tool, answers: Answers, wanted: NDArray[np.bool_]) -> str:
    """Of the branches asked for, the reason of the nearest: at the target, else at the end of the line."""
    for place, name in ((0, "the target"), (1, "the end of the approach")):
        verdict, excess = answers.verdict[:, place], answers.excess[:, place]
        if not np.any(wanted & (verdict == Verdict.VALID)):
            # by verdict first, a limit is nearer than reach, then by how much
            nearest = int(np.lexsort((excess, verdict, ~wanted))[0])
            return f"{tool.name}: {name}: {why(config.arm, at_target(answers, place), nearest)}"
    return f"{tool.name}: no branch asked for reaches the target and the end of the approach alike"
