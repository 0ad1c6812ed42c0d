"""Planning of single moves: the plan of one command, and a check that all steps of a sequence have one."""

from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import GuardedMove, MoveJoint, MoveJoints, MoveTool, Retract, Stow, Unstow
from fsw.dictionary.enums import Joint
from fsw.estimate.joints import JointEstimate
from fsw.executive.checks import check_arguments
from fsw.motion.compensation import Compensation
from fsw.motion.path_check import check_paths
from fsw.motion.plan import Plan, Refusal, estimate_at, plan_joint, plan_poses
from fsw.motion.plan_tool import plan_guarded, plan_retract, plan_tool
from fsw.state import SequenceStep, State

SingleMoveCommand = Unstow | Stow | MoveJoint | MoveJoints | MoveTool | GuardedMove | Retract


def plan_command(
    config: Config,
    joints: JointEstimate,
    tool: str,
    command: SingleMoveCommand,
) -> Plan | Refusal:
    """Plan the move of a command, and check its paths for collisions with rover and ground.

    Args:
        config: Configuration of flight software.
        joints: Estimate of the joints, from which the move starts.
        tool: Tool of the last tool command.
        command: Command of a single move.

    Returns:
        The plan, or the reason for a refusal.
    """
    plan = _plan_motion(config, joints, tool, command)
    # the paths of a MoveTool are checked while its branch is chosen
    if isinstance(plan, Refusal) or isinstance(command, MoveTool):
        return plan
    touching = command.tool if isinstance(command, GuardedMove | Retract) else None
    collision = check_paths(config, joints, plan.paths, config.params.collision.padding_m, touching)
    return plan if collision is None else Refusal(collision)


def _plan_motion(
    config: Config, joints: JointEstimate, tool: str, command: SingleMoveCommand
) -> Plan | Refusal:
    match command:
        case Unstow():
            poses = config.params.poses
            forth = [np.array(pose) for pose in (*poses.unstow_via_rad, poses.ready_rad)]
            return plan_poses(config, joints, forth, Compensation())
        case Stow():
            poses = config.params.poses
            back = (poses.ready_rad, *reversed(poses.unstow_via_rad), poses.stowed_rad)
            return plan_poses(config, joints, [np.array(pose) for pose in back], Compensation())
        case MoveJoint():
            compensation = Compensation(command.backlash)
            return plan_joint(config, joints, Joint(command.joint), command.angle_rad, compensation)
        case MoveJoints():
            pose = np.array(command.angle_rad) + (joints.output_rad if command.relative else 0.0)
            return plan_poses(config, joints, [pose], Compensation(command.backlash, command.deflection))
        case MoveTool():
            return plan_tool(config, joints, command, tool)
        case GuardedMove():
            return plan_guarded(config, joints, command)
        case Retract():
            return plan_retract(config, joints, command)
        case _:
            assert_never(command)


def check_steps(config: Config, state: State, steps: tuple[SequenceStep, ...]) -> str | None:
    """Return the reason that a step cannot be planned from the end of the step before it, or None."""
    ended = plan_steps(config, state.joints, state.tool, steps)
    return ended.reason if isinstance(ended, Refusal) else None


def plan_steps(
    config: Config, joints: JointEstimate, tool: str, steps: tuple[SequenceStep, ...]
) -> tuple[JointEstimate, str] | Refusal:
    """Plan each step from the end of the step before it.

    Args:
        config: Configuration of flight software.
        joints: Estimate of the joints, from which the first step starts.
        tool: Tool of the last tool command.
        steps: Steps, of which those that are no single move are left out.

    Returns:
        The joints at the end and the tool of the last tool command, or the reason for a refusal.
    """
    for step in steps:
        if not isinstance(step, SingleMoveCommand):
            continue
        problem = check_arguments(config.params, step)
        if problem is not None:
            return Refusal(f"{type(step).__name__}: {problem}")
        plan = plan_command(config, joints, tool, step)
        if isinstance(plan, Refusal):
            return Refusal(f"{type(step).__name__}: {plan.reason}")
        joints = estimate_at(joints, plan.end)
        tool = step.tool if isinstance(step, MoveTool | GuardedMove | Retract) else tool
    return joints, tool
