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

AT_LIMIT_SHARE: Final = 0.85
"""Share of its limit above which a current is at it, noise apart."""
STUCK_FACTOR: Final = 4
"""A motor that has not turned for so many times the stall time will not."""
MAX_READ_SHARE, READ_NOISE_A = 1.2, 0.15
"""No current can be read above this share of its limit and noise, nor so much against the motion."""
MIN_SPEED_SHARE: Final = 0.2
"""A sensor is held against the motion only at a speed above this share."""
FREE_RAD: Final = 0.012
"""A joint goes back this far first: beyond what a hardstop that it was left on gives."""
BREAKAWAY_RAD: Final = 3e-4
"""A motor that turned this far has broken away."""
STEADY_S: Final = 1.0
"""After so long at a new speed readings count."""
RUNNING_READINGS: Final = 64
"""The first readings of the slow run, whose mean current is that of running."""
RETURN_HALF_WIDTHS: Final = 4
"""How many half widths of the gap a joint goes back beyond its hardstop."""


class HomingStage(IntEnum):
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


RUNNING_FILTER_S: Final = {HomingStage.FREE: 0.25, HomingStage.COARSE: 5.0}
"""Towards a hardstop too slow to follow its rise, and quick enough for a load that turns with the joint."""
RUNNING_GAIN: Final = {stage: 1.0 / (time_s * CYCLE_HZ) for stage, time_s in RUNNING_FILTER_S.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Homing:
    """A joint on its way to, on, and from its hardstop."""

    joint: Joint
    known: bool
    """Whether its hardstop has to be where it was before."""
    stage: HomingStage
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
    assisting_load_Nm: float = 0.0
    """Of the load, what pushes the joint on its hardstop."""
    retreat: JointPath | None = None
    readings_towards: Readings = NO_READINGS
    contact_line: ContactLine | None = None
    readings_away: Readings = NO_READINGS
    found: HardstopFit | None = None
    """Set when all is done."""


@dataclass(frozen=True, slots=True, eq=False)
class HomingUpdate:
    """A seeking joint one cycle on, the set-points of all joints, and what went wrong."""

    homing: Homing
    setpoint: Setpoint
    evrs: tuple[Evr, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class HomingInputs:
    """What a seeking joint sees in this cycle."""

    config: Config
    params: JointParams
    motor_rad: float
    rate_rad_s: float
    load_Nm: float
    current_A: float
    resolver_rad: float
    setpoint: Setpoint


def begin_homing(joint: Joint, joints: JointEstimate, anew: bool) -> Homing:
    """A joint about to look for its hardstop."""
    known, at = bool(joints.reference.known[joint]) and not anew, float(joints.motor_rad[joint])
    return Homing(joint, known, HomingStage.FREE, 0, 0.0, False, at, at, 0)


def homing_limit_A(config: Config, homing: Homing) -> float:
    """The current limit of the joint that seeks: what running takes today, and a fixed margin.

    Until it has broken away there is no margin. On its way back, once it turns, it lifts the load that helped
    it on its way there.
    """
    limit = homing.running_A
    if homing.stage is not HomingStage.FREE or homing.turned:
        params = config.params.joints.in_order()[homing.joint]
        limit += params.hardstop_press_Nm / params.torque_constant_Nm_A
    if homing.stage in (HomingStage.RETREAT, HomingStage.RELEASE) and homing.turned:
        limit += _load_current_A(config, homing)
    return min(float(config.current_limit_A[homing.joint]), limit)


def advance_homing(
    config: Config,
    homing: Homing,
    setpoint: Setpoint,
    joints: JointEstimate,
    load_Nm: Array,
    sensors: Sensors,
) -> HomingUpdate:
    """The homing in this cycle; it is over when `found` is set or an event is reported."""
    j = homing.joint
    inputs = HomingInputs(
        config=config,
        params=config.params.joints.in_order()[j],
        motor_rad=float(joints.motor_rad[j]),
        rate_rad_s=float(joints.motor_rate_rad_s[j]),
        load_Nm=float(load_Nm[j]),
        current_A=float(sensors.current_A[j]),
        resolver_rad=float(sensors.resolver_rad[j]),
        setpoint=setpoint,
    )
    homing = _track_motion(inputs, replace(homing, assisting_load_Nm=max(0.0, -inputs.load_Nm)))
    wrong = _check_missed(inputs, homing) or _check_current(inputs, homing) or _check_stuck(inputs, homing)
    if wrong is not None:
        return _fail(inputs, homing, wrong)
    match homing.stage:
        case HomingStage.FREE:
            return _free(inputs, homing)
        case HomingStage.COARSE:
            return _search_coarse(inputs, homing)
        case HomingStage.RETREAT:
            return _retreat(inputs, homing)
        case HomingStage.FINE:
            return _search_fine(inputs, homing)
        case HomingStage.RELEASE:
            return _release(inputs, homing)


def _track_motion(inputs: HomingInputs, homing: Homing) -> Homing:
    """How long the motor has not turned, and what current running takes."""
    params, speed = inputs.config.params.hardstop, _speed(inputs, homing)
    way = abs(inputs.motor_rad - homing.anchor_rad)
    turned = homing.turned or way > BREAKAWAY_RAD
    homing = replace(homing, ticks=homing.ticks + 1, turned=turned, anchor_ticks=homing.anchor_ticks + 1)
    if turned and way > params.stall_speed_share * speed * params.stall_time_s:
        homing = replace(homing, anchor_rad=inputs.motor_rad, anchor_ticks=0)
    at_speed = abs(inputs.rate_rad_s) > 0.5 * speed
    if homing.stage is HomingStage.FREE and not at_speed:
        most = float(inputs.config.current_limit_A[homing.joint])
        return replace(homing, running_A=min(homing.running_A + params.breakaway_A_s * CYCLE_S, most))
    if homing.stage in RUNNING_GAIN and at_speed:
        more = abs(inputs.current_A) - homing.running_A
        return replace(homing, running_A=homing.running_A + RUNNING_GAIN[homing.stage] * more)
    return homing


def _check_missed(inputs: HomingInputs, homing: Homing) -> Evr | None:
    """A joint that should have met its hardstop by now."""
    stop = inputs.params.hardstop_rad
    if inputs.resolver_rad >= stop - inputs.config.params.hardstop.window_rad:
        return None
    return HardstopMissed(homing.joint, inputs.resolver_rad, stop)


def _check_current(inputs: HomingInputs, homing: Homing) -> Evr | None:
    """A current above its limit, or one against the motion: by such a sensor no limit can be set."""
    limit = homing_limit_A(inputs.config, homing)
    too_much = homing.turned and abs(inputs.current_A) > MAX_READ_SHARE * limit + READ_NOISE_A
    steady = (
        homing.turned
        and homing.ticks * CYCLE_S > STEADY_S
        and homing.stage in (HomingStage.COARSE, HomingStage.FINE)
    )
    moving = steady and inputs.rate_rad_s < -MIN_SPEED_SHARE * _speed(inputs, homing)
    if not too_much and not (
        moving and inputs.current_A > READ_NOISE_A + _load_current_A(inputs.config, homing)
    ):
        return None
    return CurrentImplausible(homing.joint, inputs.current_A, limit)


def _check_stuck(inputs: HomingInputs, homing: Homing) -> Evr | None:
    """A motor that does not turn although it should, and has not stalled at its limit either."""
    limit = homing_limit_A(inputs.config, homing)
    rising = homing.stage is HomingStage.FREE and limit < inputs.config.current_limit_A[homing.joint]
    waited = homing.anchor_ticks * CYCLE_S > STUCK_FACTOR * inputs.config.params.hardstop.stall_time_s
    if rising or not waited or homing.stage is HomingStage.RETREAT:
        return None
    return MotorStuck(homing.joint, inputs.current_A, limit)


def _free(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    if inputs.motor_rad - homing.start_rad < FREE_RAD:
        return _run(inputs, homing, _speed(inputs, homing))
    # the load that was lifted on the way back helps on the way there
    running_A = max(0.0, homing.running_A - _load_current_A(inputs.config, homing))
    return HomingUpdate(
        replace(_enter_stage(inputs, homing, HomingStage.COARSE), running_A=running_A),
        _zero_rate(inputs.setpoint),
    )


def _search_coarse(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    if not _is_stalled(inputs, homing):
        return _run(inputs, homing, -_speed(inputs, homing))
    stop = inputs.params.hardstop_rad
    if inputs.resolver_rad > stop + inputs.config.params.hardstop.window_rad:
        return _fail(inputs, homing, StalledEarly(homing.joint, inputs.resolver_rad, stop))
    goal = inputs.setpoint.motor_rad.copy()
    goal[homing.joint] = inputs.motor_rad + inputs.config.params.hardstop.retreat_rad
    back = joint_path(inputs.config, inputs.setpoint.motor_rad, goal)
    return _retreat(inputs, replace(_enter_stage(inputs, homing, HomingStage.RETREAT), retreat=back))


def _retreat(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    path, time_s = homing.retreat, homing.ticks * CYCLE_S
    assert path is not None  # it is what this stage begins with
    if time_s >= path.duration_s + STEADY_S:
        return HomingUpdate(_enter_stage(inputs, homing, HomingStage.FINE), _zero_rate(inputs.setpoint))
    return HomingUpdate(homing, path.at(time_s))


def _search_fine(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    fine = inputs.config.params.hardstop.fine_speed_rad_s
    if not _is_stalled(inputs, homing):
        if homing.ticks * CYCLE_S > STEADY_S:
            homing = replace(homing, readings_towards=_add_reading(inputs, homing.readings_towards))
        if homing.readings_towards.motor_rad.size == RUNNING_READINGS:
            torque_Nm = float(np.abs(homing.readings_towards.torque_Nm).mean())
            homing = replace(homing, running_A=torque_Nm / inputs.params.torque_constant_Nm_A)
        return _run(inputs, homing, -fine)
    contact_line = fit_contact_line(inputs.config, homing.joint, inputs.load_Nm, homing.readings_towards)
    ratio = inputs.config.params.hardstop.stiffness_ratio
    drawn = series_compliance(inputs.config, homing.joint)
    if contact_line is None:
        return _fail(inputs, homing, HardstopUnclear(homing.joint))
    if not 1 / ratio < contact_line.compliance_rad_Nm / drawn < ratio:
        return _fail(
            inputs, homing, NoHardstop(homing.joint, 1e6 * contact_line.compliance_rad_Nm, 1e6 * drawn)
        )
    return _run(
        inputs, replace(_enter_stage(inputs, homing, HomingStage.RELEASE), contact_line=contact_line), fine
    )


def _release(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    if homing.turned:
        homing = replace(homing, readings_away=_add_reading(inputs, homing.readings_away))
    j, contact_line = homing.joint, homing.contact_line
    assert contact_line is not None  # it is what this stage begins with
    enough = (
        contact_line.contact_rad
        + homing.assisting_load_Nm * contact_line.compliance_rad_Nm
        + RETURN_HALF_WIDTHS * float(inputs.config.half_gap_rad[j])
    )
    if inputs.motor_rad < enough:
        return _run(inputs, homing, inputs.config.params.hardstop.fine_speed_rad_s)
    result = locate_hardstop(
        inputs.config,
        j,
        inputs.load_Nm,
        contact_line,
        measure_backlash(inputs.config, j, inputs.load_Nm, contact_line, homing.readings_away),
    )
    moved, bound = result.stop_rad - inputs.params.hardstop_rad, inputs.config.params.hardstop.moved_rad
    if homing.known and abs(moved) > bound:
        return _fail(inputs, homing, HardstopMoved(j, moved, bound))
    return HomingUpdate(replace(homing, found=result), _zero_rate(inputs.setpoint))


def _is_stalled(inputs: HomingInputs, homing: Homing) -> bool:
    """Whether the motor has not turned for a while although its current is at the limit."""
    waited = homing.anchor_ticks * CYCLE_S >= inputs.config.params.hardstop.stall_time_s
    limit = homing_limit_A(inputs.config, homing)
    return waited and abs(inputs.current_A) >= AT_LIMIT_SHARE * limit


def _run(inputs: HomingInputs, homing: Homing, rate_rad_s: float) -> HomingUpdate:
    """The set-point at a steady speed, never far ahead of the motor."""
    j, lead = homing.joint, inputs.config.params.hardstop.lead_rad
    motor, rate = inputs.setpoint.motor_rad.copy(), np.zeros_like(inputs.setpoint.rate_rad_s)
    wanted = motor[j] + rate_rad_s * CYCLE_S
    motor[j] = (
        max(wanted, inputs.motor_rad - lead) if rate_rad_s < 0 else min(wanted, inputs.motor_rad + lead)
    )
    held_up = motor[j] != wanted
    rate[j] = 0.0 if held_up else rate_rad_s
    return HomingUpdate(homing, Setpoint(motor, rate))


def _fail(inputs: HomingInputs, homing: Homing, evr: Evr) -> HomingUpdate:
    return HomingUpdate(homing, _zero_rate(inputs.setpoint), (evr,))


def _zero_rate(setpoint: Setpoint) -> Setpoint:
    return Setpoint(setpoint.motor_rad, np.zeros_like(setpoint.rate_rad_s))


def _enter_stage(inputs: HomingInputs, homing: Homing, stage: HomingStage) -> Homing:
    at = inputs.motor_rad
    return replace(homing, stage=stage, ticks=0, turned=False, start_rad=at, anchor_rad=at, anchor_ticks=0)


def _add_reading(inputs: HomingInputs, readings: Readings) -> Readings:
    return readings.append(inputs.motor_rad, inputs.current_A * inputs.params.torque_constant_Nm_A)


def _speed(inputs: HomingInputs, homing: Homing) -> float:
    params = inputs.config.params.hardstop
    coarse = params.coarse_speed_share * inputs.params.speed_rad_s
    return coarse if homing.stage in (HomingStage.FREE, HomingStage.COARSE) else params.fine_speed_rad_s


def _load_current_A(config: Config, homing: Homing) -> float:
    """By how much more current running takes away from the hardstop than towards it."""
    return 2 * homing.assisting_load_Nm / float(config.torque_constant_Nm_A[homing.joint])
