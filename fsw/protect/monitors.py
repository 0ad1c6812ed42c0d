"""All monitors of a cycle: they say what happened and decide nothing. docs/faults.md lists them.

Each has a bound, and most a persistence: for how many cycles in a row the bound must be passed.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr
from fsw.dictionary.joints import Tool
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.motion.move import Move, Phase
from fsw.motion.plan_press import Pressing
from fsw.protect import motors
from fsw.protect.felt import Felt, felt
from fsw.protect.readings import LIVE, LIVELY, frozen, lively, missed
from fsw.protect.tilt import tilt
from fsw.protect.touch import contact, contact_lost, preload_outside


@dataclass(frozen=True, slots=True)
class Counts:
    """How many cycles in a row each persistent monitor has been beyond its bound."""

    following: int = 0
    stalled: int = 0
    over_current: int = 0
    winding: int = 0
    resolver: int = 0
    tilt: int = 0
    contact: int = 0
    preload: int = 0


QUIET: Final = Counts()


@dataclass(frozen=True, slots=True, eq=False)
class MonitorState:
    """What monitors remember of the cycles before."""

    counts: Counts = QUIET
    cycle: int | None = None
    """The avionics' count when flight software was called last."""
    readings: tuple[float, ...] = (inf,) * len(LIVELY)
    """Of the sensors that have noise."""
    same: tuple[int, ...] = LIVE
    """For how many cycles each of those readings has been the same."""
    planned_gravity_R: Array | None = None
    """What gravity was when the move under way began."""
    felt: Felt | None = None


def watch(
    config: Config,
    last: MonitorState,
    mode: Mode,
    tool: Tool,
    move: Move | None,
    sensors: Sensors,
    joints: JointEstimate,
    pressing: Pressing | None,
    usable: bool,
) -> tuple[MonitorState, tuple[Evr, ...]]:
    """The state for the next cycle and what was found; of unusable readings, only how many came."""
    evrs = missed(config, last.cycle, sensors.cycle)
    planned = None
    if move is not None:
        planned = joints.gravity_R_m_s2 if last.planned_gravity_R is None else last.planned_gravity_R
    if not usable:
        return replace(last, cycle=sensors.cycle, planned_gravity_R=planned), evrs
    readings = lively(sensors)
    same, dead = frozen(config, last.same, last.readings, readings)
    counts, found = _watch_arm(config, last.counts, mode, tool, move, sensors, joints, pressing, planned)
    touch, force = felt(config, last.felt, move, sensors, joints)
    return MonitorState(counts, sensors.cycle, readings, same, planned, touch), evrs + dead + found + force


def _watch_arm(
    config: Config,
    last: Counts,
    mode: Mode,
    tool: Tool,
    move: Move | None,
    sensors: Sensors,
    joints: JointEstimate,
    pressing: Pressing | None,
    planned_gravity_R: Array | None,
) -> tuple[Counts, tuple[Evr, ...]]:
    """The monitors that need readings to compute with."""
    evrs: tuple[Evr, ...] = ()
    counts = QUIET
    if True in sensors.switch_closed.tolist():
        evrs += contact(mode, tool, sensors.switch_closed)
    if motors.beyond(config, move, sensors, joints):
        counts, found = _watch_joints(config, last, move, sensors, joints)
        evrs += found
    if move is None or planned_gravity_R is None:
        return counts, evrs
    lost = outside = 0
    tilted, turned = tilt(config, last.tilt, planned_gravity_R, joints.imu_R_m_s2)
    evrs += turned
    if move.press is not None and not move.stopped and pressing is not None:
        lost, gone = contact_lost(config, last.contact, pressing, sensors.switch_closed)
        outside, force = preload_outside(config, last.preload, pressing, move.press.torque_per_N, joints)
        evrs += gone + force
    if tilted or lost or outside:
        counts = replace(counts, tilt=tilted, contact=lost, preload=outside)
    return counts, evrs


def _watch_joints(
    config: Config, last: Counts, move: Move | None, sensors: Sensors, joints: JointEstimate
) -> tuple[Counts, tuple[Evr, ...]]:
    """The monitors of the joints, one by one."""
    resolver, apart = motors.resolver(config, last.resolver, joints)
    moving = move is not None and not move.stopped
    winding, heat = motors.winding(config, last.winding, moving, sensors.winding_C)
    if move is None:
        return Counts(winding=winding, resolver=resolver), apart + heat
    evrs = apart + heat + motors.soft_limits(config, move, joints.motor_rad)
    following = stalled = drawn = 0
    if move.phase is not Phase.RELEASE:
        error = np.abs(move.hold.motor_rad - joints.motor_rad)
        stalled, still = motors.stalled(config, last.stalled, move, error, joints)
        following, behind = motors.following(config, last.following, error)
        drawn, high = motors.over_current(config, last.over_current, sensors.current_A)
        evrs += still + behind + high
    return Counts(following, stalled, drawn, winding, resolver), evrs
