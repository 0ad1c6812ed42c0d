"""Monitors: they say what happened and decide nothing. Each has a bound and a persistence of its own."""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import (
    ContactInFreeSpace,
    Evr,
    FollowingErrorHigh,
    OverCurrent,
    SensorNotFinite,
    SoftLimitPassed,
)
from fsw.dictionary.joints import SWITCHES_OF, Joint, Switch
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors
from fsw.motion.move import Move, Phase


@dataclass(frozen=True, slots=True)
class MonitorState:
    """How many cycles in a row each persistent monitor has been beyond its bound."""

    following: int
    over_current: int


def nothing_seen() -> MonitorState:
    """All quiet."""
    return MonitorState(0, 0)


def non_finite(sensors: Sensors) -> tuple[Evr, ...]:
    """Readings that are no numbers. This comes first: comparisons with NaN are all false and clip nothing."""
    analog = (
        ("resolver_rad", sensors.resolver_rad),
        ("current_A", sensors.current_A),
        ("winding_C", sensors.winding_C),
        ("gravity_R_m_s2", sensors.gravity_R_m_s2),
    )
    # a sum is finite only if all its terms are: one reduction where all is well
    if np.isfinite(sum(values.sum() for _, values in analog)):
        return ()
    return tuple(SensorNotFinite(name) for name, values in analog if not np.all(np.isfinite(values)))


def watch(
    config: Config, last: MonitorState, mode: Mode, move: Move | None, sensors: Sensors, joints: JointEstimate
) -> tuple[MonitorState, tuple[Evr, ...]]:
    """All other monitors, on finite readings: the state for the next cycle and what was found."""
    evrs: tuple[Evr, ...] = ()
    if joints.referenced:
        evrs += _soft_limits(config, joints.motor_rad)
    if sensors.switch_closed.any():
        evrs += _contact(mode, move, sensors.switch_closed)
    if move is None or move.phase is Phase.RELEASE:
        return nothing_seen(), evrs
    following, found = _following(config, last.following, move.hold.motor_rad, joints.motor_rad)
    over_current, drawn = _over_current(config, last.over_current, sensors.current_A)
    return MonitorState(following, over_current), evrs + found + drawn


def _soft_limits(config: Config, motor_rad: Array) -> tuple[Evr, ...]:
    margin = config.params.monitors.soft_limit_margin_rad
    below = motor_rad < config.arm.soft_min_rad - margin
    above = motor_rad > config.arm.soft_max_rad + margin
    if not (below.any() or above.any()):
        return ()
    joint = Joint(int(np.argmax(below | above)))
    limit = config.arm.soft_min_rad[joint] if below[joint] else config.arm.soft_max_rad[joint]
    return (SoftLimitPassed(joint, float(motor_rad[joint]), float(limit)),)


def _contact(mode: Mode, move: Move | None, closed: Flags) -> tuple[Evr, ...]:
    """A closed switch where nothing was to be touched: any in free space, another tool's when guarded."""
    expected: tuple[Switch, ...] = ()
    if mode in (Mode.GUARDED, Mode.RETRACTING, Mode.FAULTED):
        expected = (
            SWITCHES_OF[move.guarded] if move is not None and move.guarded is not None else tuple(Switch)
        )
    found = next((switch for switch in Switch if closed[switch] and switch not in expected), None)
    return () if found is None else (ContactInFreeSpace(found),)


def _following(
    config: Config, last: int, setpoint_rad: Array, motor_rad: Array
) -> tuple[int, tuple[Evr, ...]]:
    bounds = config.params.monitors
    error = np.abs(setpoint_rad - motor_rad)
    if error.max() <= bounds.following_error_rad:
        return 0, ()
    if last + 1 < bounds.following_persistence:
        return last + 1, ()
    joint = Joint(int(error.argmax()))
    return last + 1, (FollowingErrorHigh(joint, float(error[joint]), bounds.following_error_rad),)


def _over_current(config: Config, last: int, current_A: Array) -> tuple[int, tuple[Evr, ...]]:
    bounds = config.params.monitors
    bound = bounds.over_current_fraction * config.current_limit_A
    excess = np.abs(current_A) - bound
    if excess.max() <= 0:
        return 0, ()
    if last + 1 < bounds.over_current_persistence:
        return last + 1, ()
    joint = Joint(int(excess.argmax()))
    return last + 1, (OverCurrent(joint, float(current_A[joint]), float(bound[joint])),)
