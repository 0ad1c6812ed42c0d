"""Seeking a hardstop: off it, on it until the joint stalls, back, on it slowly, and slowly off it again."""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, CYCLE_S, Config
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import (
    CurrentImplausible,
    HardstopMissed,
    HardstopMoved,
    HardstopUnclear,
    MotorStuck,
    NoHardstop,
    StalledEarly,
)
from fsw.dictionary.params import JointParams
from fsw.estimate.hardstop import (
    NO_READINGS,
    ContactLine,
    HardstopFit,
    Readings,
    fit_contact_line,
    locate_hardstop,
    measure_backlash,
    series_compliance,
)
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.motion.paths import JointPath, Setpoint, joint_path

AT_LIMIT: Final = 0.85
"""Share of its limit above which a current is at it, noise apart."""
STUCK_TIMES: Final = 4
"""A motor that has not turned for so many times the stall time will not."""
READ_SHARE, READ_A = 1.2, 0.15
"""No current can be read above this share of its limit and noise, nor so much against the motion."""
SLOWER: Final = 0.2
"""A sensor is held against the motion only at a speed above this share."""
FREE_RAD: Final = 0.012
"""A joint goes back this far first: beyond what a hardstop that it was left on gives."""
TURNED_RAD: Final = 3e-4
"""A motor that turned this far has broken away."""
STEADY_S: Final = 1.0
"""After so long at a new speed readings count."""
RUNNING_READINGS: Final = 64
"""The first readings of the slow run, whose mean current is that of running."""
BEYOND_GAP: Final = 4
"""How many half widths of the gap a joint goes back beyond its hardstop."""


class Stage(IntEnum):
    """What a seeking joint is doing."""

    FREE = 0
    """Off whatever it may have been left on; the current limit rises until it turns."""
    COARSE = 1
    """Towards the hardstop, until it stalls."""
    RETREAT = 2
    FINE = 3
    """Against it slowly, until it stalls."""
    RELEASE = 4
    """Off it again, as slowly, through the gap."""


RUNNING_FILTER_S: Final = {Stage.FREE: 0.25, Stage.COARSE: 5.0}
"""Towards a hardstop too slow to follow its rise, and quick enough for a load that turns with the joint."""
RUNNING_GAIN: Final = {stage: 1.0 / (time_s * CYCLE_HZ) for stage, time_s in RUNNING_FILTER_S.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Seek:
    """A joint on its way to, on, and from its hardstop."""

    joint: Joint
    known: bool
    """Whether its hardstop has to be where it was before."""
    stage: Stage
    ticks: int
    """Cycles in this stage."""
    running_A: float
    """Current of running; while the motor breaks away, how far it was raised."""
    turned: bool
    """Whether the motor has turned in this stage."""
    start_rad: float
    """Where the motor was when this stage began."""
    anchor_rad: float
    """Where it was when it last turned noticeably ..."""
    anchor_ticks: int
    """... and for how many cycles it has not."""
    relief_Nm: float = 0.0
    """Of the load, what pushes the joint on its hardstop."""
    retreat: JointPath | None = None
    towards: Readings = NO_READINGS
    press: ContactLine | None = None
    away: Readings = NO_READINGS
    found: HardstopFit | None = None
    """Set when all is done."""


@dataclass(frozen=True, slots=True, eq=False)
class Sought:
    """A seeking joint one cycle on, the set-points of all joints, and what went wrong."""

    seek: Seek
    hold: Setpoint
    evrs: tuple[Evr, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Now:
    """What a seeking joint sees in this cycle."""

    config: Config
    params: JointParams
    motor_rad: float
    rate_rad_s: float
    load_Nm: float
    current_A: float
    resolver_rad: float
    hold: Setpoint


def begin(joint: Joint, joints: JointEstimate, anew: bool) -> Seek:
    """A joint about to look for its hardstop."""
    known, at = bool(joints.reference.known[joint]) and not anew, float(joints.motor_rad[joint])
    return Seek(joint, known, Stage.FREE, 0, 0.0, False, at, at, 0)


def limit_A(config: Config, seek: Seek) -> float:
    """The current limit of the joint that seeks: what running takes today, and a fixed margin.

    Until it has broken away there is no margin. On its way back, once it turns, it lifts the load that helped
    it on its way there.
    """
    limit = seek.running_A
    if seek.stage is not Stage.FREE or seek.turned:
        params = config.params.joints.in_order()[seek.joint]
        limit += params.hardstop_press_Nm / params.torque_constant_Nm_A
    if seek.stage in (Stage.RETREAT, Stage.RELEASE) and seek.turned:
        limit += _lift_A(config, seek)
    return min(float(config.current_limit_A[seek.joint]), limit)


def advance(
    config: Config, seek: Seek, hold: Setpoint, joints: JointEstimate, load_Nm: Array, sensors: Sensors
) -> Sought:
    """The seek in this cycle; it is over when `found` is set or an event is reported."""
    j = seek.joint
    now = Now(
        config=config,
        params=config.params.joints.in_order()[j],
        motor_rad=float(joints.motor_rad[j]),
        rate_rad_s=float(joints.motor_rate_rad_s[j]),
        load_Nm=float(load_Nm[j]),
        current_A=float(sensors.current_A[j]),
        resolver_rad=float(sensors.resolver_rad[j]),
        hold=hold,
    )
    seek = _watched(now, replace(seek, relief_Nm=max(0.0, -now.load_Nm)))
    wrong = _missed(now, seek) or _implausible(now, seek) or _stuck(now, seek)
    if wrong is not None:
        return _failed(now, seek, wrong)
    match seek.stage:
        case Stage.FREE:
            return _free(now, seek)
        case Stage.COARSE:
            return _coarse(now, seek)
        case Stage.RETREAT:
            return _retreat(now, seek)
        case Stage.FINE:
            return _fine(now, seek)
        case Stage.RELEASE:
            return _release(now, seek)


def _watched(now: Now, seek: Seek) -> Seek:
    """How long the motor has not turned, and what current running takes."""
    params, speed = now.config.params.hardstop, _speed(now, seek)
    way = abs(now.motor_rad - seek.anchor_rad)
    turned = seek.turned or way > TURNED_RAD
    seek = replace(seek, ticks=seek.ticks + 1, turned=turned, anchor_ticks=seek.anchor_ticks + 1)
    if turned and way > params.stall_speed_share * speed * params.stall_time_s:
        seek = replace(seek, anchor_rad=now.motor_rad, anchor_ticks=0)
    at_speed = abs(now.rate_rad_s) > 0.5 * speed
    if seek.stage is Stage.FREE and not at_speed:
        most = float(now.config.current_limit_A[seek.joint])
        return replace(seek, running_A=min(seek.running_A + params.breakaway_A_s * CYCLE_S, most))
    if seek.stage in RUNNING_GAIN and at_speed:
        more = abs(now.current_A) - seek.running_A
        return replace(seek, running_A=seek.running_A + RUNNING_GAIN[seek.stage] * more)
    return seek


def _missed(now: Now, seek: Seek) -> Evr | None:
    """A joint that should have met its hardstop by now."""
    stop = now.params.hardstop_rad
    if now.resolver_rad >= stop - now.config.params.hardstop.window_rad:
        return None
    return HardstopMissed(seek.joint, now.resolver_rad, stop)


def _implausible(now: Now, seek: Seek) -> Evr | None:
    """A current above its limit, or one against the motion: by such a sensor no limit can be set."""
    limit = limit_A(now.config, seek)
    too_much = seek.turned and abs(now.current_A) > READ_SHARE * limit + READ_A
    steady = seek.turned and seek.ticks * CYCLE_S > STEADY_S and seek.stage in (Stage.COARSE, Stage.FINE)
    moving = steady and now.rate_rad_s < -SLOWER * _speed(now, seek)
    if not too_much and not (moving and now.current_A > READ_A + _lift_A(now.config, seek)):
        return None
    return CurrentImplausible(seek.joint, now.current_A, limit)


def _stuck(now: Now, seek: Seek) -> Evr | None:
    """A motor that does not turn although it should, and has not stalled at its limit either."""
    limit = limit_A(now.config, seek)
    rising = seek.stage is Stage.FREE and limit < now.config.current_limit_A[seek.joint]
    waited = seek.anchor_ticks * CYCLE_S > STUCK_TIMES * now.config.params.hardstop.stall_time_s
    if rising or not waited or seek.stage is Stage.RETREAT:
        return None
    return MotorStuck(seek.joint, now.current_A, limit)


def _free(now: Now, seek: Seek) -> Sought:
    if now.motor_rad - seek.start_rad < FREE_RAD:
        return _run(now, seek, _speed(now, seek))
    # the load that was lifted on the way back helps on the way there
    running_A = max(0.0, seek.running_A - _lift_A(now.config, seek))
    return Sought(replace(_entered(now, seek, Stage.COARSE), running_A=running_A), _still(now.hold))


def _coarse(now: Now, seek: Seek) -> Sought:
    if not _stalled(now, seek):
        return _run(now, seek, -_speed(now, seek))
    stop = now.params.hardstop_rad
    if now.resolver_rad > stop + now.config.params.hardstop.window_rad:
        return _failed(now, seek, StalledEarly(seek.joint, now.resolver_rad, stop))
    goal = now.hold.motor_rad.copy()
    goal[seek.joint] = now.motor_rad + now.config.params.hardstop.retreat_rad
    back = joint_path(now.config, now.hold.motor_rad, goal)
    return _retreat(now, replace(_entered(now, seek, Stage.RETREAT), retreat=back))


def _retreat(now: Now, seek: Seek) -> Sought:
    path, time_s = seek.retreat, seek.ticks * CYCLE_S
    assert path is not None  # it is what this stage begins with
    if time_s >= path.duration_s + STEADY_S:
        return Sought(_entered(now, seek, Stage.FINE), _still(now.hold))
    return Sought(seek, path.at(time_s))


def _fine(now: Now, seek: Seek) -> Sought:
    fine = now.config.params.hardstop.fine_speed_rad_s
    if not _stalled(now, seek):
        if seek.ticks * CYCLE_S > STEADY_S:
            seek = replace(seek, towards=_read(now, seek.towards))
        if seek.towards.motor_rad.size == RUNNING_READINGS:
            torque_Nm = float(np.abs(seek.towards.torque_Nm).mean())
            seek = replace(seek, running_A=torque_Nm / now.params.torque_constant_Nm_A)
        return _run(now, seek, -fine)
    press = fit_contact_line(now.config, seek.joint, now.load_Nm, seek.towards)
    ratio = now.config.params.hardstop.stiffness_ratio
    drawn = series_compliance(now.config, seek.joint)
    if press is None:
        return _failed(now, seek, HardstopUnclear(seek.joint))
    if not 1 / ratio < press.compliance_rad_Nm / drawn < ratio:
        return _failed(now, seek, NoHardstop(seek.joint, 1e6 * press.compliance_rad_Nm, 1e6 * drawn))
    return _run(now, replace(_entered(now, seek, Stage.RELEASE), press=press), fine)


def _release(now: Now, seek: Seek) -> Sought:
    if seek.turned:
        seek = replace(seek, away=_read(now, seek.away))
    j, press = seek.joint, seek.press
    assert press is not None  # it is what this stage begins with
    enough = (
        press.contact_rad
        + seek.relief_Nm * press.compliance_rad_Nm
        + BEYOND_GAP * float(now.config.half_gap_rad[j])
    )
    if now.motor_rad < enough:
        return _run(now, seek, now.config.params.hardstop.fine_speed_rad_s)
    result = locate_hardstop(
        now.config, j, now.load_Nm, press, measure_backlash(now.config, j, now.load_Nm, press, seek.away)
    )
    moved, bound = result.stop_rad - now.params.hardstop_rad, now.config.params.hardstop.moved_rad
    if seek.known and abs(moved) > bound:
        return _failed(now, seek, HardstopMoved(j, moved, bound))
    return Sought(replace(seek, found=result), _still(now.hold))


def _stalled(now: Now, seek: Seek) -> bool:
    """Whether the motor has not turned for a while although its current is at the limit."""
    waited = seek.anchor_ticks * CYCLE_S >= now.config.params.hardstop.stall_time_s
    limit = limit_A(now.config, seek)
    return waited and abs(now.current_A) >= AT_LIMIT * limit


def _run(now: Now, seek: Seek, rate_rad_s: float) -> Sought:
    """The set-point at a steady speed, never far ahead of the motor."""
    j, lead = seek.joint, now.config.params.hardstop.lead_rad
    motor, rate = now.hold.motor_rad.copy(), np.zeros_like(now.hold.rate_rad_s)
    wanted = motor[j] + rate_rad_s * CYCLE_S
    motor[j] = max(wanted, now.motor_rad - lead) if rate_rad_s < 0 else min(wanted, now.motor_rad + lead)
    held_up = motor[j] != wanted
    rate[j] = 0.0 if held_up else rate_rad_s
    return Sought(seek, Setpoint(motor, rate))


def _failed(now: Now, seek: Seek, evr: Evr) -> Sought:
    return Sought(seek, _still(now.hold), (evr,))


def _still(hold: Setpoint) -> Setpoint:
    return Setpoint(hold.motor_rad, np.zeros_like(hold.rate_rad_s))


def _entered(now: Now, seek: Seek, stage: Stage) -> Seek:
    at = now.motor_rad
    return replace(seek, stage=stage, ticks=0, turned=False, start_rad=at, anchor_rad=at, anchor_ticks=0)


def _read(now: Now, readings: Readings) -> Readings:
    return readings.append(now.motor_rad, now.current_A * now.params.torque_constant_Nm_A)


def _speed(now: Now, seek: Seek) -> float:
    params = now.config.params.hardstop
    coarse = params.coarse_speed_share * now.params.speed_rad_s
    return coarse if seek.stage in (Stage.FREE, Stage.COARSE) else params.fine_speed_rad_s


def _lift_A(config: Config, seek: Seek) -> float:
    """By how much more current running takes away from the hardstop than towards it."""
    return 2 * seek.relief_Nm / float(config.torque_constant_Nm_A[seek.joint])
