"""Rehearsal of a scenario before a run: the first command that flight software would refuse.

Flight software itself takes every command, and nothing moves. Every command starts where the one before it
ends. A tool that is to touch a surface ends on it, without the overtravel. A taught point is where the
scenario has it.
"""

from dataclasses import replace

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
    Command,
    Dock,
    GuardedMove,
    PlaceTool,
    Stow,
    ToolChange,
)
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandRefused
from fsw.dictionary.params import TeachPoint
from fsw.dictionary.types import vector3
from fsw.executive.commands import handle
from fsw.executive.context import EVENT_OF, TRANSITIONS, CommandContext, ModeEvent, check_mode
from fsw.executive.expansion import CompoundCommand, locate_surface
from fsw.executive.planning import MotionCommand, PlannedSequence, Start, plan_command
from fsw.kinematics.transforms import normalize
from fsw.motion.plan import Refusal
from fsw.motion.preload import PressPlan
from fsw.motion.work import complete
from fsw.state import Hold, State, boot
from sim.arms import BuiltArm
from sim.frames import p_R_from_N
from sim.placement import first_estimate, joints_at
from sim.scenario.data import Scenario, TaughtPoint
from sim.scenario.records import upper_snake
from sim.setting import Surface
from sim.world import params_in_world


def find_impossible(scenario: Scenario, arm: BuiltArm) -> str | None:
    """Return the first command of a scenario that flight software would refuse and the reason, or None."""
    taught = tuple(_nominal_point(point) for point in scenario.taught)
    params = params_in_world(scenario.world, replace(arm.params, teach=(*arm.params.teach, *taught)))
    config, poses = configure(params), params.poses
    is_stowed = scenario.start == "stowed"
    start_rad = np.array(poses.stowed_rad if is_stowed else poses.ready_rad)
    joints = first_estimate(config, start_rad, scenario.world.gravity_N_m_s2)
    found = replace(joints.reference, calibrated=np.ones(len(Joint), bool))
    state = boot(config, Mode.STOWED if is_stowed else Mode.DEPLOYED)
    state = replace(state, joints=replace(joints, reference=found))
    for number, command in enumerate(scenario.commands, 1):
        if isinstance(command, ClearFault):
            return None  # where a fault stops the arm is not known before
        ended = _rehearse(state.changed_config or config, state, command, scenario.world.surface)
        if isinstance(ended, Refusal):
            return f"command {number}, {upper_snake(type(command))}: {ended.reason}"
        state = ended
    return None


def _rehearse(config: Config, state: State, command: Command, surface: Surface | None) -> State | Refusal:
    """Return the state at the end of a command, or the reason that it is refused."""
    touching = state.mode in (Mode.GUARDED, Mode.PRELOAD)
    switches = config.protection.tool_switches[state.tool] if touching else ()
    before = CommandContext(state, True, np.isin(range(len(config.protection.switch_names)), switches))
    if isinstance(command, Calibrate | CalibrateAll):
        problem = check_mode(before, ModeEvent.MOVE_FREE)
        return _end_homing(config, state, command) if problem is None else Refusal(problem)
    begun = handle(config, before, command)
    refused = next((evr for evr in begun.evrs if isinstance(evr, CommandRefused)), None)
    if refused is not None:
        return Refusal(refused.reason)
    planning = begun.state.planning
    if planning is None:
        return begun.state
    planned: PlannedSequence | PressPlan | Refusal = complete(config, planning.work)
    if isinstance(planned, Refusal):
        return planned
    if isinstance(planned, PressPlan):
        done = ModeEvent.DONE_RELEASED if planned.change.target_N == 0 else ModeEvent.DONE
        pressed = replace(planned.change.start, model_N=planned.change.target_N)
        return replace(state, mode=TRANSITIONS[Mode.PRELOAD, done], preload=pressed)
    assert isinstance(command, MotionCommand)  # a press is the only other command that is planned
    on_surface = _end_on_surface(command, surface)
    if on_surface is not command:
        planned = _plan_again(config, state, on_surface)
    return planned if isinstance(planned, Refusal) else _end_motion(state, command, planned)


def _end_homing(config: Config, state: State, command: Calibrate | CalibrateAll) -> State:
    """Return the state after a joint, or each one, has found its hardstop."""
    if isinstance(command, CalibrateAll):
        homed, end_rad = np.ones(len(Joint), bool), np.array(config.params.hardstop.park_rad)
    else:
        homed = np.arange(len(Joint)) == command.joint
        at_stop = np.array([joint.hardstop_rad for joint in config.params.joints.in_order()])
        end_rad = np.where(homed, at_stop, state.joints.output_rad)
    joints = joints_at(state.joints, end_rad)
    reference = replace(joints.reference, calibrated=joints.reference.calibrated | homed)
    return replace(state, joints=replace(joints, reference=reference))


def _plan_again(config: Config, state: State, command: MotionCommand) -> PlannedSequence | Refusal:
    """Plan a motion that ends on the surface."""
    surface = locate_surface(config, state.joints, state.tool, command, state.surface)
    return complete(config, plan_command(Start(state.joints, state.tool, surface), command))


def _end_motion(state: State, command: MotionCommand, planned: PlannedSequence) -> State:
    """Return the state at the end of a motion."""
    mode, end = state.mode, planned.end
    for step in planned.commands if isinstance(command, CompoundCommand) else (command,):
        begin = ModeEvent.MOVE_FREE if isinstance(step, Hold) else EVENT_OF[type(step)]
        done = ModeEvent.DONE_STOWED if isinstance(step, Stow) else ModeEvent.DONE
        mode = TRANSITIONS[TRANSITIONS[mode, begin], done]
    return replace(state, mode=mode, tool=end.tool, joints=end.joints, surface=end.surface, preload=None)


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
