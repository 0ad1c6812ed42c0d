"""Homing of a joint at its hardstop, stage by stage, with checks of angle, current and motion.

The joint leaves the hardstop, stalls on it, retreats, stalls on it slowly, and slowly leaves it again. The
readings of the two slow stages give the angle of the hardstop and the backlash.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, CYCLE_S, Config
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import (
    CurrentImplausible,
    HardstopImplausible,
    HardstopMissed,
    HardstopMoved,
    HardstopUnclear,
    MotorStuck,
    StalledEarly,
)
from fsw.dictionary.params import JointParams
from fsw.estimate.joints import JointEstimate
from fsw.estimate.reference import (
    NO_READINGS,
    ContactLine,
    HardstopFit,
    Readings,
    fit_contact_line,
    locate_hardstop,
    measure_backlash,
    series_compliance,
)
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.motion.paths import JointPath, Setpoint, joint_path

AT_LIMIT_SHARE: Final = 0.85
"""Share of the limit above which a current counts as at the limit; the margin covers noise."""
STUCK_FACTOR: Final = 4
"""A motor that has not turned for this many stall times is stuck."""
MAX_READ_SHARE, READ_NOISE_A = 1.2, 0.15
"""Largest plausible current: this share of its limit and noise; against the motion, noise only."""
MIN_SPEED_SHARE: Final = 0.2
"""The sign of a current is checked only above this share of the speed."""
FREE_RAD: Final = 0.012
"""First move away: more than the deflection of a hardstop on which the joint was left."""
BREAKAWAY_RAD: Final = 3e-4
"""Motion after which a motor has overcome its static friction."""
STEADY_S: Final = 1.0
"""Time at a new speed before readings are used."""
RUNNING_READINGS: Final = 64
"""Number of first readings of the slow run that give the running current."""
RETURN_HALF_WIDTHS: Final = 4
"""Half widths of the backlash by which a joint leaves its hardstop at the end."""


class HomingStage(IntEnum):
    """Stages of homing."""

    FREE = 0
    """Away from the hardstop, on which it may have been left; the current limit rises until it turns."""
    COARSE = 1
    """Towards the hardstop, until it stalls."""
    RETREAT = 2
    """Away from it, along a planned path."""
    FINE = 3
    """Towards it slowly, until it stalls."""
    RELEASE = 4
    """Away from it slowly, through the backlash."""


RUNNING_FILTER_S: Final = {HomingStage.FREE: 0.25, HomingStage.COARSE: 5.0}
"""Time constants of the running current.

Towards a hardstop it is too slow to follow the rise of the torque, and fast enough to follow the load.
"""
RUNNING_GAIN: Final = {stage: 1.0 / (time_s * CYCLE_HZ) for stage, time_s in RUNNING_FILTER_S.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Homing:
    """Homing of a joint from cycle to cycle."""

    joint: Joint
    known: bool
    """True if the hardstop must be where it was found before."""
    stage: HomingStage
    ticks: int
    """Cycles in this stage."""
    running_A: float
    """Current that keeps the motor running; until the motor turns, the rising current limit."""
    turned: bool
    """True if the motor has turned in this stage."""
    start_rad: float
    """Motor angle at the beginning of this stage."""
    anchor_rad: float
    """Motor angle when it last turned by the least step that counts as motion."""
    anchor_ticks: int
    """Cycles since then."""
    implausible_ticks: int = 0
    """Cycles in a row in which the current was implausible."""
    assisting_load_Nm: float = 0.0
    """Part of the load that pushes the joint towards its hardstop, at least 0."""
    retreat: JointPath | None = None
    readings_towards: Readings = NO_READINGS
    contact_line: ContactLine | None = None
    readings_away: Readings = NO_READINGS
    found: HardstopFit | None = None
    """Result; None until homing is complete."""


@dataclass(frozen=True, slots=True, eq=False)
class HomingUpdate:
    """Homing after a cycle, with the set-point of all joints and the failure, if any."""

    homing: Homing
    setpoint: Setpoint
    evrs: tuple[Evr, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class HomingInputs:
    """Parameters and readings of the joint in this cycle."""

    config: Config
    params: JointParams
    motor_rad: float
    rate_rad_s: float
    load_Nm: float
    current_A: float
    resolver_rad: float
    setpoint: Setpoint


def begin_homing(joint: Joint, joints: JointEstimate, accept_moved: bool) -> Homing:
    """Begin the homing of a joint, whose hardstop may be elsewhere than before if that is accepted."""
    known, motor_rad = (
        bool(joints.reference.known[joint]) and not accept_moved,
        float(joints.motor_rad[joint]),
    )
    return Homing(joint, known, HomingStage.FREE, 0, 0.0, False, motor_rad, motor_rad, 0)


def homing_limit_A(config: Config, homing: Homing) -> float:
    """Compute the current limit of the joint: the running current and a margin.

    Until the motor turns there is no margin. Away from the hardstop the motor lifts the load that pushes the
    joint towards it, which adds to the limit.
    """
    limit_A = homing.running_A
    if homing.stage is not HomingStage.FREE or homing.turned:
        params = config.params.joints.in_order()[homing.joint]
        limit_A += params.hardstop_press_Nm / params.torque_constant_Nm_A
    if homing.stage in (HomingStage.RETREAT, HomingStage.RELEASE) and homing.turned:
        limit_A += _load_current_A(config, homing)
    return min(float(config.current_limit_A[homing.joint]), limit_A)


def advance_homing(
    config: Config,
    homing: Homing,
    setpoint: Setpoint,
    joints: JointEstimate,
    load_Nm: Array,
    sensors: Sensors,
) -> HomingUpdate:
    """Advance homing by one cycle, from the set-point of all joints in the cycle before."""
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
    implausible = _find_implausible(inputs, homing)
    homing = replace(homing, implausible_ticks=homing.implausible_ticks + 1 if implausible else 0)
    failure = _check_missed(inputs, homing) or _check_current(inputs, homing) or _check_stuck(inputs, homing)
    if failure is not None:
        return _fail(inputs, homing, failure)
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
    """Update the time since the motor last turned, and the running current."""
    params, speed = inputs.config.params.hardstop, _speed(inputs, homing)
    moved_rad = abs(inputs.motor_rad - homing.anchor_rad)
    turned = homing.turned or moved_rad > BREAKAWAY_RAD
    homing = replace(homing, ticks=homing.ticks + 1, turned=turned, anchor_ticks=homing.anchor_ticks + 1)
    if turned and moved_rad > params.stall_speed_share * speed * params.stall_time_s:
        homing = replace(homing, anchor_rad=inputs.motor_rad, anchor_ticks=0)
    at_speed = abs(inputs.rate_rad_s) > 0.5 * speed
    if homing.stage is HomingStage.FREE and not at_speed:
        most_A = float(inputs.config.current_limit_A[homing.joint])
        return replace(homing, running_A=min(homing.running_A + params.breakaway_A_s * CYCLE_S, most_A))
    if homing.stage in RUNNING_GAIN and at_speed:
        error_A = abs(inputs.current_A) - homing.running_A
        return replace(homing, running_A=homing.running_A + RUNNING_GAIN[homing.stage] * error_A)
    return homing


def _check_missed(inputs: HomingInputs, homing: Homing) -> Evr | None:
    """Check that the output is not past the window in which its hardstop must be."""
    stop = inputs.params.hardstop_rad
    if inputs.resolver_rad >= stop - inputs.config.params.hardstop.window_rad:
        return None
    return HardstopMissed(homing.joint, inputs.resolver_rad, stop)


def _check_current(inputs: HomingInputs, homing: Homing) -> Evr | None:
    """Check that the current is not implausible for as long as any reading may be.

    An implausible current sensor cannot bound the torque on the hardstop.
    """
    if homing.implausible_ticks < inputs.config.params.monitors.reading_persistence:
        return None
    return CurrentImplausible(homing.joint, inputs.current_A, homing_limit_A(inputs.config, homing))


def _find_implausible(inputs: HomingInputs, homing: Homing) -> bool:
    """Return whether the current is above its limit, or against the motion."""
    limit = homing_limit_A(inputs.config, homing)
    too_much = homing.turned and abs(inputs.current_A) > MAX_READ_SHARE * limit + READ_NOISE_A
    steady = (
        homing.turned
        and homing.ticks * CYCLE_S > STEADY_S
        and homing.stage in (HomingStage.COARSE, HomingStage.FINE)
    )
    moving = steady and inputs.rate_rad_s < -MIN_SPEED_SHARE * _speed(inputs, homing)
    against = moving and inputs.current_A > READ_NOISE_A + _load_current_A(inputs.config, homing)
    return too_much or against


def _check_stuck(inputs: HomingInputs, homing: Homing) -> Evr | None:
    """Check that the motor turns, or has stalled at its current limit."""
    limit = homing_limit_A(inputs.config, homing)
    rising = homing.stage is HomingStage.FREE and limit < inputs.config.current_limit_A[homing.joint]
    waited = homing.anchor_ticks * CYCLE_S > STUCK_FACTOR * inputs.config.params.hardstop.stall_time_s
    if rising or not waited or homing.stage is HomingStage.RETREAT:
        return None
    return MotorStuck(homing.joint, inputs.current_A, limit)


def _free(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    if inputs.motor_rad - homing.start_rad < FREE_RAD:
        return _run(inputs, homing, _speed(inputs, homing))
    # the load that was lifted away from the hardstop assists towards it
    running_A = max(0.0, homing.running_A - _load_current_A(inputs.config, homing))
    return HomingUpdate(
        replace(_enter_stage(inputs, homing, HomingStage.COARSE), running_A=running_A),
        inputs.setpoint.at_rest(),
    )


def _search_coarse(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    if not _is_stalled(inputs, homing):
        return _run(inputs, homing, -_speed(inputs, homing))
    stop = inputs.params.hardstop_rad
    if inputs.resolver_rad > stop + inputs.config.params.hardstop.window_rad:
        return _fail(inputs, homing, StalledEarly(homing.joint, inputs.resolver_rad, stop))
    end_rad = inputs.setpoint.motor_rad.copy()
    end_rad[homing.joint] = inputs.motor_rad + inputs.config.params.hardstop.retreat_rad
    back = joint_path(inputs.config, inputs.setpoint.motor_rad, end_rad)
    return _retreat(inputs, replace(_enter_stage(inputs, homing, HomingStage.RETREAT), retreat=back))


def _retreat(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    path, time_s = homing.retreat, homing.ticks * CYCLE_S
    assert path is not None  # _search_coarse sets it
    if time_s >= path.duration_s + STEADY_S:
        return HomingUpdate(_enter_stage(inputs, homing, HomingStage.FINE), inputs.setpoint.at_rest())
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
    design_rad_Nm = series_compliance(inputs.config, homing.joint)
    if contact_line is None:
        return _fail(inputs, homing, HardstopUnclear(homing.joint))
    if not 1 / ratio < contact_line.compliance_rad_Nm / design_rad_Nm < ratio:
        event = HardstopImplausible(homing.joint, 1e6 * contact_line.compliance_rad_Nm, 1e6 * design_rad_Nm)
        return _fail(inputs, homing, event)
    homing = replace(_enter_stage(inputs, homing, HomingStage.RELEASE), contact_line=contact_line)
    return _run(inputs, homing, fine)


def _release(inputs: HomingInputs, homing: Homing) -> HomingUpdate:
    if homing.turned:
        homing = replace(homing, readings_away=_add_reading(inputs, homing.readings_away))
    j, contact_line = homing.joint, homing.contact_line
    assert contact_line is not None  # _search_fine sets it
    end_rad = (
        contact_line.contact_rad
        + homing.assisting_load_Nm * contact_line.compliance_rad_Nm
        + RETURN_HALF_WIDTHS * float(inputs.config.half_backlash_rad[j])
    )
    if inputs.motor_rad < end_rad:
        return _run(inputs, homing, inputs.config.params.hardstop.fine_speed_rad_s)
    backlash = measure_backlash(inputs.config, j, inputs.load_Nm, contact_line, homing.readings_away)
    result = locate_hardstop(inputs.config, j, inputs.load_Nm, contact_line, backlash)
    moved_rad = result.stop_rad - inputs.params.hardstop_rad
    bound_rad = inputs.config.params.hardstop.moved_rad
    if homing.known and abs(moved_rad) > bound_rad:
        return _fail(inputs, homing, HardstopMoved(j, moved_rad, bound_rad))
    return HomingUpdate(replace(homing, found=result), inputs.setpoint.at_rest())


def _is_stalled(inputs: HomingInputs, homing: Homing) -> bool:
    """Return whether the motor has not turned for the stall time although its current is at the limit."""
    waited = homing.anchor_ticks * CYCLE_S >= inputs.config.params.hardstop.stall_time_s
    limit = homing_limit_A(inputs.config, homing)
    return waited and abs(inputs.current_A) >= AT_LIMIT_SHARE * limit


def _run(inputs: HomingInputs, homing: Homing, rate_rad_s: float) -> HomingUpdate:
    """Advance the set-point at a steady speed, but at most `lead_rad` ahead of the motor.

    It goes back no faster than it goes on: the reading of the motor may be wrong within its bounds.
    """
    j, lead = homing.joint, inputs.config.params.hardstop.lead_rad
    motor, rate = inputs.setpoint.motor_rad.copy(), np.zeros_like(inputs.setpoint.rate_rad_s)
    wanted, back = motor[j] + rate_rad_s * CYCLE_S, motor[j] - rate_rad_s * CYCLE_S
    if rate_rad_s < 0:
        motor[j] = min(max(wanted, inputs.motor_rad - lead), back)
    else:
        motor[j] = max(min(wanted, inputs.motor_rad + lead), back)
    rate[j] = rate_rad_s if motor[j] == wanted else 0.0
    return HomingUpdate(homing, Setpoint(motor, rate))


def _fail(inputs: HomingInputs, homing: Homing, evr: Evr) -> HomingUpdate:
    return HomingUpdate(homing, inputs.setpoint.at_rest(), (evr,))


def _enter_stage(inputs: HomingInputs, homing: Homing, stage: HomingStage) -> Homing:
    at_rad = inputs.motor_rad
    homing = replace(homing, stage=stage, ticks=0, turned=False)
    return replace(homing, start_rad=at_rad, anchor_rad=at_rad, anchor_ticks=0)


def _add_reading(inputs: HomingInputs, readings: Readings) -> Readings:
    return readings.append(inputs.motor_rad, inputs.current_A * inputs.params.torque_constant_Nm_A)


def _speed(inputs: HomingInputs, homing: Homing) -> float:
    """Return the speed of this stage in rad/s."""
    params = inputs.config.params.hardstop
    coarse = params.coarse_speed_share * inputs.params.speed_rad_s
    return coarse if homing.stage in (HomingStage.FREE, HomingStage.COARSE) else params.fine_speed_rad_s


def _load_current_A(config: Config, homing: Homing) -> float:
    """Compute how much more current the motor needs away from the hardstop than towards it."""
    return 2 * homing.assisting_load_Nm / float(config.torque_constant_Nm_A[homing.joint])
