"""A move from brake release to brakes on: its record, one cycle of it, a stop, and actuator commands.

A move follows paths, homes a joint, or changes a preload. A guarded move and a preload plan further paths
while they run: a contact is preloaded, and a preload is corrected by the motor currents.
"""

from dataclasses import replace
from enum import IntEnum
from typing import Final

import numpy as np

from fsw.config import CYCLE_S, Config
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import (
    CommandAborted,
    CommandCompleted,
    ContactMade,
    Evr,
    ForceEstimated,
    Preloaded,
)
from fsw.dictionary.faults import NoContact, NotSettled
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
    PreloadChange,
    PreloadState,
    holding_force_N,
    model_contact,
    plan_preload,
    preload_limit_A,
)


class Phase(IntEnum):
    """Phases of a move."""

    RELEASE = 0
    RUN = 1
    SETTLE = 2
    BRAKE = 3


@cycle_record
class Move:
    """Move: paths in sequence, each from rest to rest, or the homing of a joint."""

    command: str
    end_mode: Mode
    active: Flags
    """Joints that are released; the others stay on their brakes, without power."""
    current_limit_A: Array
    paths: tuple[Path, ...]
    setpoint: Setpoint
    """Set-point of this cycle."""
    guarded_tool: str | None = None
    """Tool whose contact ends the move; None for a move that is not to touch."""
    contact_travel: float | None = None
    """Travel of a guarded move in metres when a switch closed; None before."""
    homing: Homing | None = None
    preload_change: PreloadChange | None = None
    force_fit: ForceFit | None = None
    """Fit of the motor currents while a preload changes; None once the preload is corrected."""
    vibrate: bool = False
    stopped: bool = False
    """True if a command or a fault stopped the move: it ends early and is reported as aborted."""
    phase: Phase = Phase.RELEASE
    ticks: int = 0
    """Cycles in this phase; in RUN, cycles in this path."""
    settled_ticks: int = 0
    """Cycles in a row in which the motors were at rest at their set-points."""
    travelled: float = 0.0
    """Travel along the completed paths over knots, in metres, or in newtons of a preload."""


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
    """Advance a move by one cycle.

    Returns:
        The update; its move is None if the move has ended.
    """
    match move.phase:
        case Phase.RELEASE:
            if move.ticks < config.brake_ticks:
                return MoveUpdate(_next_cycle(move, move.setpoint))
            return MoveUpdate(_enter_phase(move, Phase.RUN))
        case Phase.RUN:
            if move.homing is not None:
                return _advance_homing(config, move, move.homing, joints, load.torque_Nm, sensors)
            if move.preload_change is not None:
                return _advance_preload(config, move, move.preload_change, joints, load, sensors)
            return _follow_paths(config, move, joints, sensors)
        case Phase.SETTLE:
            return _settle(config, move, joints)
        case Phase.BRAKE:
            if move.ticks < config.brake_ticks:
                return MoveUpdate(_next_cycle(move, move.setpoint))
            if move.stopped:
                return MoveUpdate(None, (CommandAborted(move.command),), move.end_mode)
            return MoveUpdate(
                None,
                (*_preload_events(move), CommandCompleted(move.command)),
                move.end_mode,
                _homing_result(move),
            )


def _preload_events(move: Move) -> tuple[Evr, ...]:
    if move.preload_change is None or move.guarded_tool is not None:
        return ()
    preload = move.preload_change.state_after(distance_travelled(move))
    return (Preloaded(preload.tool, preload.force_N),)


def _homing_result(move: Move) -> tuple[Joint, HardstopFit] | None:
    if move.homing is None or move.homing.found is None:
        return None
    return move.homing.joint, move.homing.found


def stop_early(config: Config, move: Move, end_mode: Mode) -> Move:
    """Bring a move to rest early.

    A joint in homing is slow and may be stalled, so it is braked at once.
    """
    stopped = replace(move, stopped=True, end_mode=end_mode, guarded_tool=None)
    if move.phase is Phase.RELEASE:
        return _enter_phase(stopped, Phase.BRAKE)
    if move.phase is Phase.RUN and move.homing is not None:
        held = Setpoint(move.setpoint.motor_rad, np.zeros_like(move.setpoint.rate_rad_s))
        return _enter_phase(replace(stopped, setpoint=held), Phase.BRAKE)
    if move.phase is Phase.RUN:
        return replace(
            stopped, paths=(stop_path(config, move.setpoint),), ticks=0, travelled=distance_travelled(move)
        )
    return stopped


def find_closed_switch(config: Config, tool: str, closed: Flags) -> str | None:
    """Return the name of the first closed contact switch of a tool, or None."""
    first = next((k for k in config.protection.tool_switches[tool] if closed[k]), None)
    return None if first is None else config.protection.switch_names[first]


def _advance_homing(
    config: Config, move: Move, homing: Homing, joints: JointEstimate, load_Nm: Array, sensors: Sensors
) -> MoveUpdate:
    update = advance_homing(config, homing, move.setpoint, joints, load_Nm, sensors)
    j, limit = homing.joint, homing_limit_A(config, update.homing)
    limits = move.current_limit_A
    if limits[j] != limit:  # an unchanged limit is the same array, see command_actuators
        limits = np.where(move.active, limit, limits)
    move = replace(
        move, homing=update.homing, setpoint=update.setpoint, current_limit_A=limits, ticks=move.ticks + 1
    )
    return MoveUpdate(move if update.homing.found is None else _enter_phase(move, Phase.SETTLE), update.evrs)


def _follow_paths(config: Config, move: Move, joints: JointEstimate, sensors: Sensors) -> MoveUpdate:
    if move.guarded_tool is not None and move.contact_travel is None:
        switch = find_closed_switch(config, move.guarded_tool, sensors.switch_closed)
        if switch is not None:
            return _press_on_contact(
                config, move, move.guarded_tool, joints, ContactMade(switch, distance_travelled(move))
            )
    path, time_s = move.paths[0], (move.ticks + 1) * CYCLE_S
    running = _next_cycle(move, path.at(time_s))
    if time_s < path.duration_s:
        return MoveUpdate(running)
    running = replace(running, travelled=_travel(move, path.duration_s))
    if len(move.paths) > 1:
        return MoveUpdate(replace(running, paths=move.paths[1:], ticks=0))
    if move.guarded_tool is not None and move.contact_travel is None:
        return MoveUpdate(move, (NoContact(_travel(move, time_s)),))
    return MoveUpdate(_enter_phase(running, Phase.SETTLE))


def _press_on_contact(
    config: Config, move: Move, tool: str, joints: JointEstimate, made: ContactMade
) -> MoveUpdate:
    """Stop a guarded move whose tool has touched, and preload the tool just enough to stay in contact.

    A tool that touched before it moved is not preloaded further. If no preload can be planned, the tool stays
    where its switch closed.
    """
    at_rest = Setpoint(move.setpoint.motor_rad, np.zeros_like(move.setpoint.rate_rad_s))
    move = replace(move, setpoint=at_rest, contact_travel=made.travel_m)
    settling = MoveUpdate(_enter_phase(move, Phase.SETTLE), (made,))
    if made.travel_m == 0:
        return settling
    stopped_joints = replace(joints, motor_rad=at_rest.motor_rad)
    touch = model_contact(config, stopped_joints, tool)
    # in one leg, as if the stiffness were known: even on a stiffer arm the holding force stays small
    sure = replace(touch, force_ratio_std=ESTIMATED_RATIO_STD)
    planned = plan_preload(config, stopped_joints, sure, holding_force_N(config))
    if isinstance(planned, Refusal):
        return settling
    plan, change = planned
    pressing = replace(
        move,
        current_limit_A=preload_limit_A(config, stopped_joints, change),
        paths=plan.paths,
        preload_change=replace(change, start=touch),
        ticks=0,
        travelled=0.0,
    )
    return MoveUpdate(pressing, (made,), backlash_rad=plan.backlash_rad)


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
    if fit is not None and not move.stopped:
        preload, rate_N_s = preload_change.state_after(distance_travelled(move)), _travel_rate(move)
        fit = update_force_fit(config, fit, preload, rate_N_s, move.setpoint, joints, load, sensors)
        move = replace(move, force_fit=fit)
    done = _follow_paths(config, move, joints, sensors)
    if done.move is None or done.move.phase is not Phase.SETTLE or fit is None or move.stopped:
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
    planned = plan_correction(config, change, fit, joints, preload, planned_for)
    if planned is None or isinstance(planned, Refusal):
        evrs = (*evrs, *report_miss(change.target_N, preload, planned))
        return MoveUpdate(replace(move, preload_change=completed, force_fit=None), evrs)
    plan, next_change = planned
    next_leg = replace(
        move,
        phase=Phase.RUN,
        paths=plan.paths,
        preload_change=next_change,
        force_fit=fit.next_leg(),
        ticks=0,
        travelled=0.0,
    )
    return MoveUpdate(next_leg, evrs, backlash_rad=plan.backlash_rad)


def distance_travelled(move: Move) -> float:
    """Compute the travel of a move on its paths over knots, in metres, or in newtons of a preload."""
    running = move.phase is Phase.RUN and bool(move.paths)
    return _travel(move, move.ticks * CYCLE_S) if running else move.travelled


def move_preload(move: Move) -> PreloadState | None:
    """Return the preload that a move has reached, or None if it changes none."""
    return None if move.preload_change is None else move.preload_change.state_after(distance_travelled(move))


def _travel(move: Move, time_s: float) -> float:
    path = move.paths[0]
    return move.travelled + (path.travel_at(time_s)[0] if isinstance(path, LinePath) else 0.0)


def _travel_rate(move: Move) -> float:
    path = move.paths[0]
    return path.travel_at(move.ticks * CYCLE_S)[1] if isinstance(path, LinePath) else 0.0


def _settle(config: Config, move: Move, joints: JointEstimate) -> MoveUpdate:
    motion = config.params.motion
    error = np.abs(joints.motor_rad - move.setpoint.motor_rad)
    still = np.abs(joints.motor_rate_rad_s).max() < motion.settle_rate_rad_s
    settled_ticks = move.settled_ticks + 1 if still and error.max() < motion.settle_error_rad else 0
    if settled_ticks >= config.settle_ticks:
        return MoveUpdate(_enter_phase(move, Phase.BRAKE))
    if move.ticks >= config.settle_timeout_ticks:
        joint = Joint(int(error.argmax()))
        return MoveUpdate(move, (NotSettled(joint, float(error[joint])),))
    return MoveUpdate(replace(move, settled_ticks=settled_ticks, ticks=move.ticks + 1))


def _enter_phase(move: Move, phase: Phase) -> Move:
    return replace(move, phase=phase, ticks=0, settled_ticks=0)


def _next_cycle(move: Move, setpoint: Setpoint) -> Move:
    """Advance a move by one cycle in its phase; a constructor is faster than `replace`."""
    return Move(
        move.command,
        move.end_mode,
        move.active,
        move.current_limit_A,
        move.paths,
        setpoint,
        move.guarded_tool,
        move.contact_travel,
        move.homing,
        move.preload_change,
        move.force_fit,
        move.vibrate,
        move.stopped,
        move.phase,
        move.ticks + 1,
        move.settled_ticks,
        move.travelled,
    )


NO_JOINTS: Final[Flags] = np.zeros(len(Joint), bool)
NO_JOINTS.flags.writeable = False


def command_actuators(
    config: Config, move: Move | None, joints: JointEstimate, last: ActuatorCommand
) -> ActuatorCommand:
    """Command the actuators: power during a move, brakes off until its brake phase.

    Args:
        move: Move under way; without one, all brakes are on and all power is off.
        joints: Estimate of the joints, of which the encoder zero is used.
        last: Command of the cycle before.

    Returns:
        The command; it is `last` itself while nothing moves.
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
    release = NO_JOINTS if move.phase is Phase.BRAKE else move.active
    count = np.rint((move.setpoint.motor_rad - joints.reference.zero_rad) / config.rad_per_count).astype(
        np.int64
    )
    vibrate = move.vibrate and move.phase is Phase.RUN
    return ActuatorCommand(
        count, move.setpoint.rate_rad_s, move.current_limit_A, move.active, release, vibrate
    )
