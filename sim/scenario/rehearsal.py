"""Rehearsal of a scenario: flight software's planner plans every command, and nothing moves.

Every command starts where the one before it ends. A tool that is to touch a surface ends on it, without the
overtravel. A taught point is where the scenario has it.
"""

from dataclasses import dataclass, replace

import numpy as np

from fsw.collision.geometry import TargetSurface
from fsw.config import Config, configure
from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
    Command,
    Dock,
    GuardedMove,
    PlaceTool,
    Preload,
    SetParam,
    SetTilt,
    Stop,
    ToolChange,
)
from fsw.dictionary.params import TeachPoint
from fsw.dictionary.types import vector3
from fsw.estimate.joints import JointEstimate
from fsw.executive.context import check_arguments, check_force
from fsw.executive.expansion import CompoundCommand, locate_surface
from fsw.executive.planning import SingleMoveCommand, plan_sequence, plan_steps
from fsw.executive.settings import replace_param, tilt_joints
from fsw.kinematics.transforms import normalize
from fsw.motion.plan import Refusal
from fsw.motion.preload import model_contact, plan_preload
from sim.arms import BuiltArm
from sim.frames import p_R_from_N
from sim.placement import first_estimate, joints_at
from sim.scenario.data import Scenario, TaughtPoint
from sim.scenario.names import upper_snake
from sim.world import Surface, params_in_world

MotionCommand = CompoundCommand | SingleMoveCommand


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsed:
    """Knowledge of flight software before a command."""

    config: Config
    joints: JointEstimate
    tool: str
    surface: TargetSurface | None


def find_impossible(scenario: Scenario, arm: BuiltArm) -> str | None:
    """Return the first command of a scenario that flight software cannot plan and the reason, or None."""
    taught = tuple(_nominal_point(point) for point in scenario.taught)
    params = params_in_world(scenario.world, replace(arm.params, teach=(*arm.params.teach, *taught)))
    config = configure(params)
    start_rad = params.poses.stowed_rad if scenario.start == "stowed" else params.poses.ready_rad
    joints = first_estimate(config, np.array(start_rad), scenario.world.gravity_N_m_s2)
    before = Rehearsed(config, joints, params.tool_names[0], None)
    for number, command in enumerate(scenario.commands, 1):
        ended = _rehearse(before, command, scenario.world.surface)
        if isinstance(ended, Refusal):
            return f"command {number}, {upper_snake(type(command))}: {ended.reason}"
        if ended is None:
            return None
        before = ended
    return None


def _rehearse(before: Rehearsed, command: Command, surface: Surface | None) -> Rehearsed | Refusal | None:
    """Plan a command, and return what is known after it; None if that is nothing."""
    config, joints = before.config, before.joints
    problem = check_arguments(config.params, command)
    if problem is not None:
        return Refusal(problem)
    match command:
        case Stop():
            return before
        case ClearFault():
            return None  # where a fault stops the arm is not known before
        case SetTilt():
            tilted = tilt_joints(config, joints, command)
            return Refusal(tilted) if isinstance(tilted, str) else replace(before, joints=tilted[0])
        case SetParam():
            changed = replace_param(config.params, command)
            if isinstance(changed, str):
                return Refusal(changed)
            return replace(before, config=configure(changed))
        case CalibrateAll():
            return replace(before, joints=joints_at(joints, np.array(config.params.hardstop.park_rad)))
        case Calibrate():
            at_stop = np.array([joint.hardstop_rad for joint in config.params.joints.in_order()])
            moved = np.arange(at_stop.size) == command.joint
            return replace(before, joints=joints_at(joints, np.where(moved, at_stop, joints.output_rad)))
        case Preload():
            refused = _refuse_preload(before, command)
            return before if refused is None else refused
        case _:
            planned, ending = _plan_motion(before, command), _end_on_surface(command, surface)
            keeps = isinstance(planned, Refusal) or ending is command
            return planned if keeps else _plan_motion(before, ending)


def _plan_motion(before: Rehearsed, command: MotionCommand) -> Rehearsed | Refusal:
    """Plan a motion, and return what is known after it."""
    config, joints, tool = before.config, before.joints, before.tool
    surface = locate_surface(config, joints, tool, command, before.surface)
    if isinstance(command, CompoundCommand):
        planned = plan_sequence(config, joints, tool, command, surface)
    else:
        planned = plan_steps(config, joints, tool, (command,), surface)
    if isinstance(planned, Refusal):
        return planned
    return Rehearsed(config, planned.joints, planned.tool, planned.surface)


def _refuse_preload(before: Rehearsed, command: Preload) -> Refusal | None:
    """Return the reason that the force cannot be reached from a touch; a release is always possible."""
    problem = check_force(before.config.params, command)
    if problem is not None:
        return Refusal(problem)
    touch = model_contact(before.config, before.joints, command.tool)
    if command.force_N <= touch.force_N:
        return None
    planned = plan_preload(before.config, before.joints, touch, command.force_N)
    return planned if isinstance(planned, Refusal) else None


def _end_on_surface(command: MotionCommand, surface: Surface | None) -> MotionCommand:
    """Return a motion that ends where its tool is to touch; without a touch, the motion itself."""
    match command:
        case PlaceTool() | Dock():
            return replace(command, overtravel_m=0.0)
        case ToolChange(hover_m=0.0):
            return replace(command, overtravel_m=0.0)
        case GuardedMove() if surface is not None:
            end, approach = np.array(command.end_p_RoTo_R_m), normalize(np.array(command.approach_R))
            normal = normalize(np.array(surface.normal_N))
            above_m = float((end - p_R_from_N(np.array(surface.p_N_m))) @ normal)
            into = float(approach @ normal)
            if above_m < 0 and into < 0:
                return replace(command, end_p_RoTo_R_m=vector3(end - above_m / into * approach))
    return command


def _nominal_point(point: TaughtPoint) -> TeachPoint:
    return TeachPoint(
        name=point.name,
        tool=point.tool,
        p_RoTo_R_m=vector3(p_R_from_N(np.array(point.p_N_m))),
        approach_R=vector3(normalize(np.array(point.approach_N))),
        branch=point.branch,
    )
