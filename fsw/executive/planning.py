"""From a command to the plan of its move."""

from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import GuardedMove, MoveJoint, MoveJoints, MoveTool, Retract, Unstow
from fsw.dictionary.joints import Joint, Tool
from fsw.estimate.joints import JointEstimate
from fsw.motion.compensation import Compensation
from fsw.motion.plan import Plan, Refusal, plan_joint, plan_poses
from fsw.motion.plan_line import plan_guarded, plan_retract
from fsw.motion.plan_tool import plan_tool

PlannedMove = Unstow | MoveJoint | MoveJoints | MoveTool | GuardedMove | Retract


def plan_for(
    config: Config,
    joints: JointEstimate,
    tool: Tool,
    command: PlannedMove,
) -> Plan | Refusal:
    """The plan of a move from where the joints are; `tool` is that of the last tool command."""
    match command:
        case Unstow():
            poses = config.params.poses
            way = [np.array(pose) for pose in (*poses.unstow_via_rad, poses.ready_rad)]
            return plan_poses(config, joints, way, Compensation())
        case MoveJoint():
            compensation = Compensation(command.backlash)
            return plan_joint(config, joints, Joint(command.joint), command.angle_rad, compensation)
        case MoveJoints():
            return plan_poses(config, joints, [np.array(command.angle_rad)], Compensation(command.backlash))
        case MoveTool():
            return plan_tool(config, joints, command, tool)
        case GuardedMove():
            return plan_guarded(config, joints, command)
        case Retract():
            return plan_retract(config, joints, command)
        case _:
            assert_never(command)
