"""Protection, the last stage of a cycle: run all monitors, and decide a response that only reduces or stops.

Monitors report what happened and decide nothing; docs/faults.md lists them. Each has a bound, and most have
a persistence: for how many cycles in a row the bound must be passed. Such a monitor takes the count of the
cycles before, and returns it with this cycle.
"""

from dataclasses import dataclass, replace
from math import inf
from operator import ge, le, sub
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import (
    FollowingErrorHigh,
    MotorStalled,
    OverCurrent,
    OverTemperature,
    ResolverDisagrees,
    SetpointUnsafe,
    SoftLimitPassed,
    UnderTemperature,
)
from fsw.dictionary.types import cycle_record
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.protect.contact import (
    ApproachState,
    check_contact_kept,
    check_press_force,
    check_unexpected_contact,
    monitor_approach,
)
from fsw.protect.inputs import (
    NOISY,
    NONE_UNCHANGED,
    ArmStatus,
    MoveStatus,
    ProtectionBounds,
    check_frozen,
    check_tilt,
)
from fsw.protect.readings import READ_NOISY, ReadingState
from fsw.protect.resistance import FreeMove, monitor_free_move
from fsw.protect.responses import Decision, StandingFault, decide


@dataclass(frozen=True, slots=True)
class Counts:
    """Cycles in a row in which each persistent monitor has been beyond its bound."""

    following: int = 0
    stalled: int = 0
    over_current: int = 0
    winding: int = 0
    resolver: int = 0
    tilt: int = 0
    contact: int = 0
    press: int = 0


ALL_ZERO: Final = Counts()
NO_LAG: Final = (0.0,) * len(Joint)
"""Distances of motors at rest from their set-points."""
ROUNDING_RAD: Final = 1e-9


@cycle_record
class MonitorState:
    """Memory of the monitors from cycle to cycle."""

    counts: Counts = ALL_ZERO
    readings: tuple[float, ...] = (inf,) * len(NOISY)
    """Last readings of the sensors that have noise."""
    unchanged: tuple[int, ...] = NONE_UNCHANGED
    """For how many cycles each of those readings has been the same."""
    planned_gravity_R: Array | None = None
    """Gravity when the move under way began, (3,)."""
    approach: ApproachState | None = None
    free_move: FreeMove | None = None


def protect(
    bounds: ProtectionBounds,
    last: MonitorState,
    fault: StandingFault | None,
    arm: ArmStatus,
    sensors: Sensors,
    readings: ReadingState,
    last_rad: Array,
    of_readings: tuple[Evr, ...],
    of_move: tuple[Evr, ...],
) -> tuple[MonitorState, Decision | None]:
    """Monitor the arm in this cycle and decide what is done; None if nothing happened.

    Args:
        sensors: Readings to be used.
        readings: The same readings as they were read and judged.
        of_readings: Events of that judgement.
        of_move: Events of the move in this cycle, among them its own faults.
    """
    state, found = run_monitors(bounds, last, arm, sensors, readings)
    found = of_readings + found
    if arm.move is not None:
        found += check_setpoint(bounds, arm.move, last_rad)
    found += of_move
    return state, decide(bounds, arm.mode, fault, found, arm.motor_rad, last_rad) if found else None


def run_monitors(
    bounds: ProtectionBounds, last: MonitorState, arm: ArmStatus, sensors: Sensors, readings: ReadingState
) -> tuple[MonitorState, tuple[Evr, ...]]:
    """Run the monitors on this cycle, if there are readings to be used."""
    planned = None
    if arm.move is not None:
        planned = arm.gravity_R_m_s2 if last.planned_gravity_R is None else last.planned_gravity_R
    if not readings.used:
        return replace(last, planned_gravity_R=planned), ()
    read = used = readings.read[READ_NOISY]
    if readings.used is not readings.read:
        used = readings.used[READ_NOISY]
    unchanged, frozen = check_frozen(bounds, last.unchanged, last.readings, read)
    counts, found = _monitor_arm(bounds, last.counts, arm, sensors, planned)
    approach, force = monitor_approach(bounds, last.approach, arm, sensors)
    free_move, contact = monitor_free_move(bounds, last.free_move, arm, used, unchanged)
    state = MonitorState(counts, read, unchanged, planned, approach, free_move)
    return state, frozen + found + force + contact


def _monitor_arm(
    bounds: ProtectionBounds, last: Counts, arm: ArmStatus, sensors: Sensors, planned_gravity_R: Array | None
) -> tuple[Counts, tuple[Evr, ...]]:
    """Run the monitors that compute with readings."""
    evrs: tuple[Evr, ...] = ()
    counts = ALL_ZERO
    if True in sensors.switch_closed.tolist():
        evrs = check_unexpected_contact(bounds, arm.mode, arm.tool, sensors.switch_closed)
    if exceed_any_bound(bounds, arm, sensors):
        counts, found = _monitor_joints(bounds, last, arm, sensors)
        evrs += found
    tilted = lost = outside = 0
    if planned_gravity_R is not None:
        tilted, turned = check_tilt(bounds, last.tilt, planned_gravity_R, arm.imu_R_m_s2)
        evrs += turned
    press = None if arm.move is None else arm.move.press
    if press is not None:
        lost, contact = check_contact_kept(bounds, last.contact, press, sensors.switch_closed)
        outside, force = check_press_force(bounds, last.press, arm, press)
        evrs += contact + force
    if tilted or lost or outside:
        counts = replace(counts, tilt=tilted, contact=lost, press=outside)
    return counts, evrs


def _monitor_joints(
    bounds: ProtectionBounds, last: Counts, arm: ArmStatus, sensors: Sensors
) -> tuple[Counts, tuple[Evr, ...]]:
    """Run the monitors of the joints, one by one."""
    move = arm.move
    resolver, disagreements = check_resolvers(bounds, last.resolver, arm)
    is_moving = move is not None and not move.is_stopping
    winding, heat = check_windings(bounds, last.winding, is_moving, sensors.winding_C)
    if move is None:
        return Counts(winding=winding, resolver=resolver), disagreements + heat
    evrs = disagreements + heat + check_soft_limits(bounds, move, arm.motor_rad)
    following = stalled = over_current = 0
    if not move.is_releasing:
        error = np.abs(move.setpoint_rad - arm.motor_rad)
        stalled, still = check_stall(bounds, last.stalled, move, error, arm.motor_rate_rad_s)
        following, behind = check_following(bounds, last.following, error)
        over_current, high = check_current(bounds, last.over_current, sensors.current_A)
        evrs += still + behind + high
    return Counts(following, stalled, over_current, winding, resolver), evrs


def check_setpoint(bounds: ProtectionBounds, move: MoveStatus, last_rad: Array) -> tuple[Evr, ...]:
    """Check that a set-point is finite, inside the limits and no jump, whatever planned it.

    Outside the limits it may still move inward: that is the way back. The fault is of the first joint whose
    set-point must not go out.
    """
    limits = get_lowest(bounds, move).tolist(), bounds.highest_rad.tolist(), bounds.setpoint_step_rad
    each = zip(move.setpoint_rad.tolist(), last_rad.tolist(), *limits, strict=True)
    for joint, (commanded, last, lowest, highest, step) in enumerate(each):
        # written so that NaN fails it
        near = -step <= commanded - last <= step
        if near and lowest <= commanded <= highest:
            continue
        inward = min(lowest, last - ROUNDING_RAD) <= commanded <= max(highest, last + ROUNDING_RAD)
        if not (near and inward):
            return (SetpointUnsafe(Joint(joint), commanded, last),)
    return ()


def get_lowest(bounds: ProtectionBounds, move: MoveStatus) -> Array:
    """Return the lowest motor angles, (5,); a joint in homing may pass its soft limit."""
    return bounds.lowest_rad if move.homing is None else bounds.lowest_homing_rad[move.homing]


def exceed_any_bound(bounds: ProtectionBounds, arm: ArmStatus, sensors: Sensors) -> bool:
    """Check whether any joint is beyond a bound; only then the monitors below are run, one by one."""
    motor = arm.motor_rad.tolist()
    monitored = (
        *motor,
        *(NO_LAG if arm.move is None else map(sub, motor, arm.move.setpoint_rad.tolist())),
        *sensors.current_A.tolist(),
        *sensors.winding_C.tolist(),
        *arm.resolver_error_rad.tolist(),
    )
    return not (
        all(map(ge, monitored, bounds.monitored_lowest)) and all(map(le, monitored, bounds.monitored_highest))
    )


def check_soft_limits(bounds: ProtectionBounds, move: MoveStatus, motor_rad: Array) -> tuple[Evr, ...]:
    """Check that no joint beyond a limit is moved farther out; an arm at rest has nothing to be stopped."""
    below, above = motor_rad < get_lowest(bounds, move), motor_rad > bounds.highest_rad
    rate_rad_s = move.setpoint_rate_rad_s
    below, above = below & (rate_rad_s < 0), above & (rate_rad_s > 0)
    if not (below.any() or above.any()):
        return ()
    joint = Joint(int(np.argmax(below | above)))
    lowest = bounds.arm.soft_min_rad if move.homing is None else get_lowest(bounds, move)
    limit = lowest[joint] if below[joint] else bounds.arm.soft_max_rad[joint]
    return (SoftLimitPassed(joint, float(motor_rad[joint]), float(limit)),)


def check_following(bounds: ProtectionBounds, count: int, error_rad: Array) -> tuple[int, tuple[Evr, ...]]:
    """Check that no motor is too far from its set-point; `error_rad` is its distance, (5,)."""
    monitors = bounds.monitors
    if error_rad.max() <= monitors.following_error_rad:
        return 0, ()
    if count + 1 < monitors.following_persistence:
        return count + 1, ()
    joint = Joint(int(error_rad.argmax()))
    return count + 1, (FollowingErrorHigh(joint, float(error_rad[joint]), monitors.following_error_rad),)


def check_stall(
    bounds: ProtectionBounds, count: int, move: MoveStatus, error_rad: Array, rate_rad_s: Array
) -> tuple[int, tuple[Evr, ...]]:
    """Check that every motor far from its set-point, (5,), turns as it is commanded to, at rates (5,).

    Nearer to its set-point a motor may be held by friction. A joint in homing shall stall, so homing itself
    monitors it. Cycles in a row in which a motor was too slow are counted.
    """
    monitors = bounds.monitors
    if move.homing is not None:
        return 0, ()
    commanded = move.setpoint_rate_rad_s
    short = monitors.stall_share * np.abs(commanded) - rate_rad_s * np.sign(commanded)
    short = np.where(error_rad > monitors.stall_error_rad, short, 0.0)
    if short.max() <= 0:
        return 0, ()
    if count + 1 < monitors.stall_persistence:
        return count + 1, ()
    joint = Joint(int(short.argmax()))
    return count + 1, (MotorStalled(joint, float(rate_rad_s[joint]), float(commanded[joint])),)


def check_current(bounds: ProtectionBounds, count: int, current_A: Array) -> tuple[int, tuple[Evr, ...]]:
    """Check that no motor draws nearly all that it may; `current_A` has shape (5,)."""
    excess = np.abs(current_A) - bounds.over_current_A
    if excess.max() <= 0:
        return 0, ()
    if count + 1 < bounds.monitors.over_current_persistence:
        return count + 1, ()
    joint = Joint(int(excess.argmax()))
    return count + 1, (OverCurrent(joint, float(current_A[joint]), float(bounds.over_current_A[joint])),)


def check_windings(
    bounds: ProtectionBounds, count: int, is_moving: bool, winding_C: Array
) -> tuple[int, tuple[Evr, ...]]:
    """Check that no winding, (5,), is too hot, or too cold in a move; at rest it may be any colder."""
    monitors, read_C = bounds.monitors, winding_C.tolist()
    coldest, hottest = min(read_C), max(read_C)
    hot = hottest > monitors.winding_max_C
    if not hot and not (is_moving and coldest < monitors.winding_min_C):
        return 0, ()
    if count + 1 < monitors.winding_persistence:
        return count + 1, ()
    if hot:
        return count + 1, (OverTemperature(Joint(read_C.index(hottest)), hottest, monitors.winding_max_C),)
    return count + 1, (UnderTemperature(Joint(read_C.index(coldest)), coldest, monitors.winding_min_C),)


def check_resolvers(bounds: ProtectionBounds, count: int, arm: ArmStatus) -> tuple[int, tuple[Evr, ...]]:
    """Check each resolver of a calibrated joint against the estimated output and its uncertainty."""
    monitors = bounds.monitors
    excess = np.abs(arm.resolver_error_rad) - arm.gear_uncertainty_rad - monitors.resolver_error_rad
    excess = np.where(arm.calibrated, excess, -np.inf)
    if excess.max() <= 0:
        return 0, ()
    if count + 1 < monitors.resolver_persistence:
        return count + 1, ()
    joint = Joint(int(excess.argmax()))
    error = float(arm.resolver_error_rad[joint])
    return count + 1, (ResolverDisagrees(joint, error, abs(error) - float(excess[joint])),)
