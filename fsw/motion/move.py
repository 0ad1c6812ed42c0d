"""A move from brake release to brakes on, one phase after the other."""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np

from fsw.config import CYCLE_S, Config
from fsw.dictionary.enums import TOOL_SWITCHES, Joint, Mode, Switch, Tool
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, ContactMade, Evr, ForceFelt, Preloaded
from fsw.dictionary.faults import NoContact, NotSettled
from fsw.estimate.hardstop import HardstopFit
from fsw.estimate.joints import JointEstimate, LoadEstimate
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors
from fsw.motion import seek as seeking
from fsw.motion.paths import LinePath, Path, Setpoint, stop_path
from fsw.motion.plan import Refusal, joints_at
from fsw.motion.plan_press import SURE, Press, Pressing, firm_N, plan_press, press_limit_A, touched
from fsw.motion.seek import Seek, limit_A
from fsw.motion.trim import PressFit, corrected, felt_share, fitted

NEAR_N: Final = 3.0
"""A press is not trimmed by less."""


class Phase(IntEnum):
    """What a move is doing."""

    RELEASE = 0
    RUN = 1
    SETTLE = 2
    BRAKE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """A move under way: paths one after the other, each from rest to rest, or a joint that seeks its stop."""

    command: str
    end_mode: Mode
    active: Flags
    """The joints that are released; the others stay on their brakes, without power."""
    limit_A: Array
    paths: tuple[Path, ...]
    hold: Setpoint
    """The set-point of this cycle."""
    guarded: Tool | None = None
    """Whose contact ends the move; None for a move that is not to touch."""
    contact_at: float | None = None
    """How far a guarded move had come when a switch closed."""
    seek: Seek | None = None
    press: Press | None = None
    fit: PressFit | None = None
    """What the currents tell of a press; None once it has been trimmed by it."""
    vibrate: bool = False
    stopped: bool = False
    """A command or a fault stopped it: the move ends early and is reported as aborted."""
    phase: Phase = Phase.RELEASE
    ticks: int = 0
    """Cycles in this phase, and for RUN in this path."""
    calm_ticks: int = 0
    travelled: float = 0.0
    """Along the paths over knots that are done."""


@dataclass(frozen=True, slots=True, eq=False)
class Advance:
    """A move one cycle on: the move or None when it is over, what happened, and what it ends in."""

    move: Move | None
    evrs: tuple[Evr, ...] = ()
    end_mode: Mode | None = None
    stop: tuple[Joint, HardstopFit] | None = None
    """The hardstop that was found, and whose."""
    gap_rad: Array | None = None
    """The backlash that new paths allow for at their end; None without new paths."""


def advance(
    config: Config, move: Move, joints: JointEstimate, load: LoadEstimate, sensors: Sensors
) -> Advance:
    """The move in this cycle."""
    match move.phase:
        case Phase.RELEASE:
            if move.ticks < config.brake_ticks:
                return Advance(_on(move, move.hold))
            return Advance(_enter(move, Phase.RUN))
        case Phase.RUN:
            if move.seek is not None:
                return _seek(config, move, move.seek, joints, load.torque_Nm, sensors)
            if move.press is not None:
                return _press(config, move, move.press, joints, load, sensors)
            return _run(config, move, joints, sensors)
        case Phase.SETTLE:
            return _settle(config, move, joints)
        case Phase.BRAKE:
            if move.ticks < config.brake_ticks:
                return Advance(_on(move, move.hold))
            if move.stopped:
                return Advance(None, (CommandAborted(move.command),), move.end_mode)
            return Advance(
                None, (*_pressed(move), CommandCompleted(move.command)), move.end_mode, _found(move)
            )


def _pressed(move: Move) -> tuple[Evr, ...]:
    if move.press is None or move.guarded is not None:
        return ()
    pressing = move.press.after(gone(move))
    return (Preloaded(pressing.tool, pressing.force_N),)


def _found(move: Move) -> tuple[Joint, HardstopFit] | None:
    if move.seek is None or move.seek.found is None:
        return None
    return move.seek.joint, move.seek.found


def stop(config: Config, move: Move, end_mode: Mode) -> Move:
    """The move brought to rest early; a joint that seeks its hardstop is slow, and may be stalled: brakes."""
    stopped = replace(move, stopped=True, end_mode=end_mode, guarded=None)
    if move.phase is Phase.RELEASE:
        return _enter(stopped, Phase.BRAKE)
    if move.phase is Phase.RUN and move.seek is not None:
        held = Setpoint(move.hold.motor_rad, np.zeros_like(move.hold.rate_rad_s))
        return _enter(replace(stopped, hold=held), Phase.BRAKE)
    if move.phase is Phase.RUN:
        return replace(stopped, paths=(stop_path(config, move.hold),), ticks=0, travelled=gone(move))
    return stopped


def closed_switch(tool: Tool, closed: Flags) -> Switch | None:
    """The first closed contact switch of a tool."""
    return next((switch for switch in TOOL_SWITCHES[tool] if closed[switch]), None)


def _seek(
    config: Config, move: Move, seek: Seek, joints: JointEstimate, load_Nm: Array, sensors: Sensors
) -> Advance:
    sought = seeking.advance(config, seek, move.hold, joints, load_Nm, sensors)
    j, limit = seek.joint, limit_A(config, sought.seek)
    limits = move.limit_A
    if limits[j] != limit:  # an unchanged limit is the same array, see drive.py
        limits = np.where(move.active, limit, limits)
    move = replace(move, seek=sought.seek, hold=sought.hold, limit_A=limits, ticks=move.ticks + 1)
    return Advance(move if sought.seek.found is None else _enter(move, Phase.SETTLE), sought.evrs)


def _run(config: Config, move: Move, joints: JointEstimate, sensors: Sensors) -> Advance:
    if move.guarded is not None and move.contact_at is None:
        switch = closed_switch(move.guarded, sensors.switch_closed)
        if switch is not None:
            return _firmed(config, move, move.guarded, joints, ContactMade(switch, gone(move)))
    path, time_s = move.paths[0], (move.ticks + 1) * CYCLE_S
    running = _on(move, path.at(time_s))
    if time_s < path.duration_s:
        return Advance(running)
    running = replace(running, travelled=_travel(move, path.duration_s))
    if len(move.paths) > 1:
        return Advance(replace(running, paths=move.paths[1:], ticks=0))
    if move.guarded is not None and move.contact_at is None:
        return Advance(move, (NoContact(_travel(move, time_s)),))
    return Advance(_enter(running, Phase.SETTLE))


def _firmed(config: Config, move: Move, tool: Tool, joints: JointEstimate, made: ContactMade) -> Advance:
    """A guarded move whose tool has touched: it stops, and presses just enough to stay in contact.

    A tool that touched before it moved is pressed already. One whose press is refused stays where its switch
    closed.
    """
    still = Setpoint(move.hold.motor_rad, np.zeros_like(move.hold.rate_rad_s))
    move = replace(move, hold=still, contact_at=made.travel_m)
    settling = Advance(_enter(move, Phase.SETTLE), (made,))
    if made.travel_m == 0:
        return settling
    here = replace(joints, motor_rad=still.motor_rad)
    touch = touched(config, here, tool)
    # as if its stiffness were sure: of so little it cannot be too much
    planned = plan_press(config, here, replace(touch, share_unsure=SURE), firm_N(config))
    if isinstance(planned, Refusal):
        return settling
    plan, press = planned
    on = replace(
        move,
        limit_A=press_limit_A(config, here, press),
        paths=plan.paths,
        press=replace(press, start=touch),
        ticks=0,
        travelled=0.0,
    )
    return Advance(on, (made,), gap_rad=plan.gap_rad)


def _press(
    config: Config, move: Move, press: Press, joints: JointEstimate, load: LoadEstimate, sensors: Sensors
) -> Advance:
    """A press runs along its overdrive, and once more by what the currents told on the way."""
    fit = move.fit
    if fit is not None and not move.stopped:
        pressing, rate_N_s = press.after(gone(move)), _travel_rate(move)
        fit = fitted(config, fit, pressing, rate_N_s, move.hold, joints, load, sensors)
        move = replace(move, fit=fit)
    done = _run(config, move, joints, sensors)
    if done.move is None or done.move.phase is not Phase.SETTLE or fit is None or move.stopped:
        return done
    return _trimmed(config, done.move, press, fit, joints) or done


def _trimmed(
    config: Config, move: Move, press: Press, fit: PressFit, joints: JointEstimate
) -> Advance | None:
    """The press as it was felt, with another leg to go if it is not near enough; None on the way back."""
    if press.change_N <= 0:
        return None
    heard: tuple[Evr, ...] = ()
    planned_for = press.after(gone(move))
    felt = felt_share(config, fit, joints, planned_for)
    pressing = replace(planned_for, share_unsure=SURE)
    if felt is not None:
        pressing = corrected(press, felt)
        heard = (ForceFelt(press.start.tool, felt.along, felt.across),)
    settled = replace(press, start=pressing, end_model_N=pressing.model_N)
    near = abs(press.wanted_N - pressing.force_N) < NEAR_N
    # from where the plan left off: a gap by which an estimate differs from it would be crossed to and fro;
    # its gears are wound up by the force as it is believed to be now
    wound = press.torque_per_N * (pressing.force_N - planned_for.force_N)
    end = replace(press.end, gear_rad=press.end.gear_rad + wound / config.arm.gear_stiffness_Nm_rad)
    stands = joints_at(joints, end)
    planned = None if near else plan_press(config, stands, pressing, press.wanted_N)
    if planned is None or isinstance(planned, Refusal):
        return Advance(replace(move, press=settled, fit=None), heard)
    plan, rest = planned
    again = PressFit(fit.legs - 1) if fit.legs > 0 else None
    on = replace(move, phase=Phase.RUN, paths=plan.paths, press=rest, fit=again, ticks=0, travelled=0.0)
    return Advance(on, heard, gap_rad=plan.gap_rad)


def gone(move: Move) -> float:
    """How far a move has come on its paths over knots."""
    running = move.phase is Phase.RUN and bool(move.paths)
    return _travel(move, move.ticks * CYCLE_S) if running else move.travelled


def pressing_in(move: Move) -> Pressing | None:
    """What a move presses with by now."""
    return None if move.press is None else move.press.after(gone(move))


def _travel(move: Move, time_s: float) -> float:
    path = move.paths[0]
    return move.travelled + (path.travel_at(time_s)[0] if isinstance(path, LinePath) else 0.0)


def _travel_rate(move: Move) -> float:
    path = move.paths[0]
    return path.travel_at(move.ticks * CYCLE_S)[1] if isinstance(path, LinePath) else 0.0


def _settle(config: Config, move: Move, joints: JointEstimate) -> Advance:
    motion = config.params.motion
    error = np.abs(joints.motor_rad - move.hold.motor_rad)
    calm = (
        error.max() < motion.settle_error_rad
        and np.abs(joints.motor_rate_rad_s).max() < motion.settle_rate_rad_s
    )
    calm_ticks = move.calm_ticks + 1 if calm else 0
    if calm_ticks >= config.settle_ticks:
        return Advance(_enter(move, Phase.BRAKE))
    if move.ticks >= config.settle_timeout_ticks:
        joint = Joint(int(error.argmax()))
        return Advance(move, (NotSettled(joint, float(error[joint])),))
    return Advance(replace(move, calm_ticks=calm_ticks, ticks=move.ticks + 1))


def _enter(move: Move, phase: Phase) -> Move:
    return replace(move, phase=phase, ticks=0, calm_ticks=0)


def _on(move: Move, hold: Setpoint) -> Move:
    """The move one cycle on in its phase; not by `replace`, which looks at every field first."""
    return Move(
        move.command,
        move.end_mode,
        move.active,
        move.limit_A,
        move.paths,
        hold,
        move.guarded,
        move.contact_at,
        move.seek,
        move.press,
        move.fit,
        move.vibrate,
        move.stopped,
        move.phase,
        move.ticks + 1,
        move.calm_ticks,
        move.travelled,
    )
