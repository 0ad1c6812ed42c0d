"""Run all monitors of a cycle: they report what happened and decide nothing. docs/faults.md lists them.

Each has a bound, and most have a persistence: for how many cycles in a row the bound must be passed.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Final

import numpy as np

from fsw.dictionary.evrs import Evr
from fsw.dictionary.types import cycle_record
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.protect import motors
from fsw.protect.bounds import ProtectionBounds
from fsw.protect.contact import (
    ApproachState,
    check_contact_kept,
    check_press_force,
    check_unexpected_contact,
    monitor_approach,
)
from fsw.protect.readings import (
    NOISY,
    NONE_UNCHANGED,
    check_cycle_count,
    check_frozen,
    check_tilt,
    noisy_readings,
)
from fsw.protect.resistance import FreeMove, monitor_free_move
from fsw.protect.status import ArmStatus


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


@cycle_record
class MonitorState:
    """Memory of the monitors from cycle to cycle."""

    counts: Counts = ALL_ZERO
    cycle: int | None = None
    """Cycle count of the avionics when flight software was called last."""
    readings: tuple[float, ...] = (inf,) * len(NOISY)
    """Last readings of the sensors that have noise."""
    unchanged: tuple[int, ...] = NONE_UNCHANGED
    """For how many cycles each of those readings has been the same."""
    planned_gravity_R: Array | None = None
    """Gravity when the move under way began, (3,)."""
    approach: ApproachState | None = None
    free_move: FreeMove | None = None


def run_monitors(
    bounds: ProtectionBounds, last: MonitorState, arm: ArmStatus, sensors: Sensors, usable: bool
) -> tuple[MonitorState, tuple[Evr, ...]]:
    """Run the monitors on this cycle; unusable readings are only counted.

    Returns:
        The state for the next cycle, and what was found.
    """
    evrs = check_cycle_count(bounds, last.cycle, sensors.cycle)
    planned = None
    if arm.move is not None:
        planned = arm.gravity_R_m_s2 if last.planned_gravity_R is None else last.planned_gravity_R
    if not usable:
        return replace(last, cycle=sensors.cycle, planned_gravity_R=planned), evrs
    readings = noisy_readings(sensors)
    unchanged, frozen = check_frozen(bounds, last.unchanged, last.readings, readings)
    counts, found = _monitor_arm(bounds, last.counts, arm, sensors, planned)
    approach, force = monitor_approach(bounds, last.approach, arm, sensors)
    free_move, contact = monitor_free_move(bounds, last.free_move, arm, readings, unchanged)
    state = MonitorState(counts, sensors.cycle, readings, unchanged, planned, approach, free_move)
    return state, evrs + frozen + found + force + contact


def _monitor_arm(
    bounds: ProtectionBounds,
    last: Counts,
    arm: ArmStatus,
    sensors: Sensors,
    planned_gravity_R: Array | None,
) -> tuple[Counts, tuple[Evr, ...]]:
    """Run the monitors that compute with readings."""
    evrs: tuple[Evr, ...] = ()
    counts = ALL_ZERO
    if True in sensors.switch_closed.tolist():
        evrs = check_unexpected_contact(bounds, arm.mode, arm.tool, sensors.switch_closed)
    if motors.exceed_any_bound(bounds, arm, sensors):
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
    resolver, disagreements = motors.check_resolvers(bounds, last.resolver, arm)
    is_moving = move is not None and not move.is_stopping
    winding, heat = motors.check_windings(bounds, last.winding, is_moving, sensors.winding_C)
    if move is None:
        return Counts(winding=winding, resolver=resolver), disagreements + heat
    evrs = disagreements + heat + motors.check_soft_limits(bounds, move, arm.motor_rad)
    following = stalled = over_current = 0
    if not move.is_releasing:
        error = np.abs(move.setpoint_rad - arm.motor_rad)
        stalled, still = motors.check_stall(bounds, last.stalled, move, error, arm.motor_rate_rad_s)
        following, behind = motors.check_following(bounds, last.following, error)
        over_current, high = motors.check_current(bounds, last.over_current, sensors.current_A)
        evrs += still + behind + high
    return Counts(following, stalled, over_current, winding, resolver), evrs
