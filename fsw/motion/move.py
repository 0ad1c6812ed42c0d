"""A move from brake release to brakes on: its record, one cycle of it, a stop, and actuator commands.

A move follows paths, homes a joint, or changes a preload. A guarded move and a preload plan further paths
while they run: a contact is preloaded, and a preload is corrected by the motor currents. While they plan, the
motors hold the arm where it is.
"""

from dataclasses import replace
from enum import IntEnum
from typing import Final

import numpy as np

from fsw.config import CYCLE_S, Config
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, ContactMade, Evr, ForceEstimated, Preloaded
from fsw.dictionary.faults import ContactLost, NoContact, NotSettled
from fsw.dictionary.types import cycle_record
from fsw.estimate.joints import JointEstimate, LoadEstimate
from fsw.estimate.reference import HardstopFit
from fsw.kinematics.transforms import Array
from fsw.messages import ActuatorCommand, Flags, Sensors
from fsw.motion.force_fit import (
    ForceFit,
    correct_preload,
    estimate_force_ratio,
    plan_correction,
    report_miss,
    update_force_fit,
)
from fsw.motion.homing import Homing, advance_homing, homing_limit_A
from fsw.motion.paths import LinePath, Path, Setpoint, stop_path
from fsw.motion.plan import Refusal
from fsw.motion.preload import (
    ESTIMATED_RATIO_STD,
    PRIOR_RATIO_STD,
    PreloadChange,
    PreloadState,
    PressPlan,
    model_contact,
    plan_preload,
    preload_limit_A,
)
from fsw.motion.work import Work

NO_JOINTS: Final[Flags] = np.zeros(len(Joint), bool)
ALL_JOINTS: Final[Flags] = ~NO_JOINTS
NO_JOINTS.flags.writeable = ALL_JOINTS.flags.writeable = False


class Phase(IntEnum):
    """Phases of a move."""

    RELEASE = 0
    RUN = 1
    SETTLE = 2
    BRAKE = 3
    PLAN = 4
    """The next leg of a press is being planned."""


@cycle_record
class MovePlan:
    """Plan of a move; only an event changes it: the end of a path, a contact, a leg of a press, a stop."""

    command: str
    end_mode: Mode
    active: Flags
    """Joints that are released; the others stay on their brakes, without power."""
    paths: tuple[Path, ...] = ()
    """Paths that are left, in sequence, each from rest to rest; none where a joint is homed."""
    travelled: float = 0.0
    """Travel along the completed paths over knots, in metres, or in newtons of a preload."""
    guarded_tool: str | None = None
    """Tool that is to touch, which then presses; None for a move that is not to touch."""
    touched: bool = False
    """True once a switch of the guarded tool has closed."""
    preload_change: PreloadChange | None = None
    vibrate: bool = False
    stopped: bool = False
    """True if a command or a fault stopped the move: it ends early and is reported as aborted."""


@cycle_record
class Move:
    """Move under way: its plan, and how far it has come in this cycle."""

    plan: MovePlan
    setpoint: Setpoint
    current_limit_A: Array
    phase: Phase = Phase.RELEASE
    ticks: int = 0
    """Cycles in this phase; in RUN, cycles in this path."""
    homing: Homing | None = None
    force_fit: ForceFit | None = None
    """Fit of the motor currents in a commanded press; None in a touch, and once the force is corrected."""
    next_leg: Work[PressPlan | Refusal] | None = None
    """Work of planning the next leg of a press, in PLAN."""
    settled_ticks: int = 0
    """Cycles in a row in which the motors were at rest at their set-points."""


@cycle_record
class MoveUpdate:
    """Move after a cycle, None if it has ended, with its events and its final mode."""

    move: Move | None
    evrs: tuple[Evr, ...] = ()
    end_mode: Mode | None = None
    found_hardstop: tuple[Joint, HardstopFit] | None = None
    """Joint of a completed homing and its hardstop."""
    backlash_rad: Array | None = None
    """Backlash that the set-points allow for at the end of new paths, (5,); None without new paths."""


def advance_move(
    config: Config, move: Move, joints: JointEstimate, load: LoadEstimate, sensors: Sensors
) -> MoveUpdate:
    """Advance a move by one cycle."""
    match move.phase:
        case Phase.RELEASE:
            if move.ticks < config.brake_ticks:
                return MoveUpdate(_next_cycle(move, move.setpoint))
            return MoveUpdate(_enter_phase(move, Phase.RUN))
        case Phase.RUN:
            if move.homing is not None:
                return _advance_homing(config, move, move.homing, joints, load.torque_Nm, sensors)
            if move.plan.preload_change is not None:
                return _advance_preload(config, move, move.plan.preload_change, joints, load, sensors)
            return _follow_paths(config, move, joints, sensors)
        case Phase.PLAN:
            return _plan_leg(config, move, joints)
        case Phase.SETTLE:
            return _settle(config, move, joints, sensors)
        case Phase.BRAKE:
            if move.ticks < config.brake_ticks:
                return MoveUpdate(_next_cycle(move, move.setpoint))
            return _end(move)


def _end(move: Move) -> MoveUpdate:
    plan, found = move.plan, None
    if plan.stopped:
        return MoveUpdate(None, (CommandAborted(plan.command),), plan.end_mode)
    evrs: tuple[Evr, ...] = (CommandCompleted(plan.command),)
    if plan.preload_change is not None and plan.guarded_tool is None:
        preload = plan.preload_change.state_after(distance_travelled(move))
        evrs = (Preloaded(preload.tool, preload.force_N), *evrs)
    if move.homing is not None and move.homing.found is not None:
        found = move.homing.joint, move.homing.found
    return MoveUpdate(None, evrs, plan.end_mode, found)


def stop_early(config: Config, move: Move, end_mode: Mode) -> Move:
    """Bring a move to rest early.

    A joint in homing is slow and may be stalled, so it is braked at once.
    """
    plan = replace(move.plan, stopped=True, end_mode=end_mode, guarded_tool=None)
    stopped = replace(move, plan=plan)
    if move.phase is Phase.RELEASE:
        return _enter_phase(stopped, Phase.BRAKE)
    if move.phase is Phase.RUN and move.homing is not None:
        return _enter_phase(replace(stopped, setpoint=move.setpoint.at_rest()), Phase.BRAKE)
    if move.phase is Phase.RUN:
        path = stop_path(config, move.setpoint)
        return replace(
            stopped, plan=replace(plan, paths=(path,), travelled=distance_travelled(move)), ticks=0
        )
    if move.phase is Phase.PLAN:
        return _enter_phase(replace(stopped, next_leg=None), Phase.SETTLE)
    return stopped


def _advance_homing(
    config: Config, move: Move, homing: Homing, joints: JointEstimate, load_Nm: Array, sensors: Sensors
) -> MoveUpdate:
    update = advance_homing(config, homing, move.setpoint, joints, load_Nm, sensors)
    j, limit = homing.joint, homing_limit_A(config, update.homing)
    limits = move.current_limit_A
    if limits[j] != limit:  # an unchanged limit is the same array, see command_actuators
        limits = np.where(move.plan.active, limit, limits)
    move = replace(
        move, homing=update.homing, setpoint=update.setpoint, current_limit_A=limits, ticks=move.ticks + 1
    )
    return MoveUpdate(move if update.homing.found is None else _enter_phase(move, Phase.SETTLE), update.evrs)


def _follow_paths(config: Config, move: Move, joints: JointEstimate, sensors: Sensors) -> MoveUpdate:
    plan = move.plan
    awaited = None if plan.touched else plan.guarded_tool
    if awaited is not None:
        switches = config.protection.tool_switches[awaited]
        first = next((k for k in switches if sensors.switch_closed[k]), None)
        if first is not None:
            made = ContactMade(config.protection.switch_names[first], distance_travelled(move))
            return _press_on_contact(config, move, awaited, joints, made)
    path, time_s = plan.paths[0], (move.ticks + 1) * CYCLE_S
    running = _next_cycle(move, path.at(time_s))
    if time_s < path.duration_s:
        return MoveUpdate(running)
    done = replace(plan, travelled=_travel(move, path.duration_s))
    if len(plan.paths) > 1:
        return MoveUpdate(replace(running, plan=replace(done, paths=plan.paths[1:]), ticks=0))
    if awaited is not None:
        return MoveUpdate(move, (NoContact(_travel(move, time_s)),))
    return MoveUpdate(_enter_phase(replace(running, plan=done), Phase.SETTLE))


def _press_on_contact(
    config: Config, move: Move, tool: str, joints: JointEstimate, made: ContactMade
) -> MoveUpdate:
    """Stop a guarded move whose tool has touched, and plan to preload it just enough to stay in contact.

    A tool that touched before it moved is not preloaded further. If no preload can be planned, the tool stays
    where its switch closed.
    """
    at_rest = move.setpoint.at_rest()
    move = replace(move, plan=replace(move.plan, touched=True), setpoint=at_rest)
    settling = MoveUpdate(_enter_phase(move, Phase.SETTLE), (made,))
    if made.travel_m == 0:
        return settling
    touch = model_contact(config, replace(joints, motor_rad=at_rest.motor_rad), tool)
    pressing = _press_touch(config, move, touch, joints, config.params.holding_force_N[tool])
    return MoveUpdate(pressing, (made,))


def _press_touch(
    config: Config, move: Move, touch: PreloadState, joints: JointEstimate, force_N: float
) -> Move:
    """Plan to press a touching tool at rest with a force."""
    stopped_joints = replace(joints, motor_rad=move.setpoint.motor_rad)
    # in one leg, as if the stiffness were known: even on a stiffer arm the holding force stays small
    sure = replace(touch, force_ratio_std=ESTIMATED_RATIO_STD)
    work = plan_preload(config, stopped_joints, sure, force_N)
    return _enter_phase(replace(move, next_leg=work), Phase.PLAN)


def _press_farther(config: Config, move: Move, joints: JointEstimate) -> Move | None:
    """Plan to press a touch with a step more, for its switches are all open; None if that is all it may."""
    change, params = move.plan.preload_change, config.params
    if change is None:
        return None
    touch = change.state_after(distance_travelled(move))
    force_N = min(touch.force_N + params.preload.step_N, params.monitors.guarded_force_N)
    return _press_touch(config, move, touch, joints, force_N) if force_N > touch.force_N else None


def _plan_leg(config: Config, move: Move, joints: JointEstimate) -> MoveUpdate:
    """Do the next piece of planning a leg; begin the leg, or settle where the motors are if there is none."""
    assert move.next_leg is not None  # the phase begins with one
    planned = move.next_leg.advance(config)
    if isinstance(planned, Work):
        return MoveUpdate(replace(move, next_leg=planned, ticks=move.ticks + 1))
    move = replace(move, next_leg=None)
    if isinstance(planned, Refusal):
        return _end_press(move, planned)
    pressing = _begin_leg(move, planned)
    if move.force_fit is None:
        limit_A = preload_limit_A(config, joints, planned.change)
        pressing = replace(pressing, current_limit_A=limit_A)
    return MoveUpdate(pressing, backlash_rad=planned.backlash_rad)


def _end_press(move: Move, refused: Refusal | None) -> MoveUpdate:
    """Settle at the present force; report a press whose force is not near its target, and why.

    A touch whose first press is refused stays where its switch closed. If it must press on, because no switch
    is closed any more, and cannot, its contact is lost.
    """
    settling, change = _enter_phase(replace(move, force_fit=None), Phase.SETTLE), move.plan.preload_change
    if change is None:
        return MoveUpdate(settling)
    if move.plan.guarded_tool is not None:
        return MoveUpdate(settling, (ContactLost(move.plan.guarded_tool),))
    return MoveUpdate(settling, report_miss(change.target_N, change.start, refused))


def _begin_leg(move: Move, planned: PressPlan) -> Move:
    change = planned.change
    if move.force_fit is None:  # the leg after a touch was planned as if the stiffness were known
        change = replace(change, start=replace(change.start, force_ratio_std=PRIOR_RATIO_STD))
    leg = replace(move.plan, paths=planned.paths, preload_change=change, travelled=0.0)
    return replace(move, plan=leg, phase=Phase.RUN, ticks=0)


def _advance_preload(
    config: Config,
    move: Move,
    preload_change: PreloadChange,
    joints: JointEstimate,
    load: LoadEstimate,
    sensors: Sensors,
) -> MoveUpdate:
    """Advance a change of preload; when a leg ends, correct the force by the motor currents."""
    fit = move.force_fit
    if fit is not None and not move.plan.stopped:
        preload, path = preload_change.state_after(distance_travelled(move)), move.plan.paths[0]
        rate_N_s = path.travel_at(move.ticks * CYCLE_S)[1] if isinstance(path, LinePath) else 0.0
        fit = update_force_fit(config, fit, preload, rate_N_s, move.setpoint, joints, load, sensors)
        move = replace(move, force_fit=fit)
    done = _follow_paths(config, move, joints, sensors)
    if done.move is None or done.move.phase is not Phase.SETTLE or fit is None or move.plan.stopped:
        return done
    return _correct_force(config, done.move, preload_change, fit, joints)


def _correct_force(
    config: Config, move: Move, change: PreloadChange, fit: ForceFit, joints: JointEstimate
) -> MoveUpdate:
    """Correct the estimated force by the fit of a leg, and plan another leg if the target is not near."""
    evrs: tuple[Evr, ...] = ()
    planned_for = change.state_after(distance_travelled(move))
    # on the way down motors turn against the friction of the press: its ratio stays
    ratio = estimate_force_ratio(config, fit, joints, planned_for) if change.change_N > 0 else None
    preload = planned_for
    if ratio is not None:
        preload = correct_preload(change, fit.start, ratio)
        evrs = (ForceEstimated(change.start.tool, ratio.along, ratio.across),)
    completed = replace(change, start=preload, end_model_N=preload.model_N)
    move = replace(move, plan=replace(move.plan, preload_change=completed))
    work = plan_correction(config, change, fit, joints, preload, planned_for)
    if work is None or isinstance(work, Refusal):
        ended = _end_press(move, work)
        return replace(ended, evrs=evrs + ended.evrs)
    return MoveUpdate(_enter_phase(replace(move, next_leg=work, force_fit=fit.next_leg()), Phase.PLAN), evrs)


def distance_travelled(move: Move) -> float:
    """Compute the travel of a move on its paths over knots, in metres, or in newtons of a preload."""
    running = move.phase is Phase.RUN and bool(move.plan.paths)
    return _travel(move, move.ticks * CYCLE_S) if running else move.plan.travelled


def move_preload(move: Move) -> PreloadState | None:
    """Return the preload that a move has reached, or None if it changes none."""
    change = move.plan.preload_change
    return None if change is None else change.state_after(distance_travelled(move))


def _travel(move: Move, time_s: float) -> float:
    path = move.plan.paths[0]
    return move.plan.travelled + (path.travel_at(time_s)[0] if isinstance(path, LinePath) else 0.0)


def _settle(config: Config, move: Move, joints: JointEstimate, sensors: Sensors) -> MoveUpdate:
    """Wait until the motors rest at their set-points; press a guarded tool until a switch is closed.

    On a soft rock, or with more friction than is modelled, that takes more than the holding force.
    """
    motion, tool = config.params.motion, move.plan.guarded_tool
    error = np.abs(joints.motor_rad - move.setpoint.motor_rad)
    still = np.abs(joints.motor_rate_rad_s).max() < motion.settle_rate_rad_s
    settled_ticks = move.settled_ticks + 1 if still and error.max() < motion.settle_error_rad else 0
    if settled_ticks >= config.settle_ticks:
        if tool is None or any(sensors.switch_closed[k] for k in config.protection.tool_switches[tool]):
            return MoveUpdate(_enter_phase(move, Phase.BRAKE))
        farther = _press_farther(config, move, joints)
        return MoveUpdate(move, (ContactLost(tool),)) if farther is None else MoveUpdate(farther)
    if move.ticks >= config.settle_timeout_ticks:
        joint = Joint(int(error.argmax()))
        return MoveUpdate(move, (NotSettled(joint, float(error[joint])),))
    return MoveUpdate(replace(move, settled_ticks=settled_ticks, ticks=move.ticks + 1))


def _enter_phase(move: Move, phase: Phase) -> Move:
    return replace(move, phase=phase, ticks=0, settled_ticks=0)


def _next_cycle(move: Move, setpoint: Setpoint) -> Move:
    """Advance a move by one cycle in its phase; a constructor is faster than `replace`."""
    return Move(
        plan=move.plan,
        setpoint=setpoint,
        current_limit_A=move.current_limit_A,
        phase=move.phase,
        ticks=move.ticks + 1,
        homing=move.homing,
        force_fit=move.force_fit,
    )


def command_actuators(
    config: Config, move: Move | None, joints: JointEstimate, last: ActuatorCommand
) -> ActuatorCommand:
    """Command the actuators: power during a move, brakes off until its brake phase.

    Without a move, all brakes are on and all power is off; the command is `last` itself while nothing moves.
    """
    if move is None:
        if not (last.power_on.any() or last.vibrate):
            return last
        return ActuatorCommand(
            last.setpoint_count,
            np.zeros(NO_JOINTS.size),
            config.current_limit_A,
            NO_JOINTS,
            NO_JOINTS,
            vibrate=False,
        )
    # unchanged flags and limits are the same arrays, so no reader needs to compare them
    release = NO_JOINTS if move.phase is Phase.BRAKE else move.plan.active
    count = np.rint((move.setpoint.motor_rad - joints.reference.zero_rad) / config.rad_per_count).astype(
        np.int64
    )
    vibrate = move.plan.vibrate and move.phase is Phase.RUN
    return ActuatorCommand(
        count, move.setpoint.rate_rad_s, move.current_limit_A, move.plan.active, release, vibrate
    )
