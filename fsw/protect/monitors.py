"""Monitors: they say what happened and decide nothing. Each has a bound and a persistence of its own."""

from dataclasses import dataclass
from math import hypot, isfinite
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import (
    ContactInFreeSpace,
    FollowingErrorHigh,
    GravityImplausible,
    OverCurrent,
    ResolverDisagrees,
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
    resolver: int


QUIET: Final = MonitorState(0, 0, 0)


def unusable(config: Config, sensors: Sensors) -> tuple[Evr, ...]:
    """Readings that nothing may be computed from.

    This comes first: comparisons with NaN are all false and clip nothing, and a wild value stays in filters.
    """
    analog = (
        ("resolver_rad", sensors.resolver_rad),
        ("current_A", sensors.current_A),
        ("winding_C", sensors.winding_C),
        ("gravity_R_m_s2", sensors.gravity_R_m_s2),
    )
    # hypot neither overflows nor warns, and is finite only if all its arguments are
    found = tuple(SensorNotFinite(name) for name, values in analog if not isfinite(hypot(*values.tolist())))
    if found:
        return found
    gravity, bounds = hypot(*sensors.gravity_R_m_s2.tolist()), config.params.monitors
    if bounds.gravity_min_m_s2 <= gravity <= bounds.gravity_max_m_s2:
        return ()
    return (GravityImplausible(gravity, bounds.gravity_min_m_s2, bounds.gravity_max_m_s2),)


def watch(
    config: Config, last: MonitorState, mode: Mode, move: Move | None, sensors: Sensors, joints: JointEstimate
) -> tuple[MonitorState, tuple[Evr, ...]]:
    """All other monitors, on finite readings: the state for the next cycle and what was found."""
    evrs: tuple[Evr, ...] = ()
    if move is not None:
        evrs += _soft_limits(config, move, joints.motor_rad)
    if sensors.switch_closed.any():
        evrs += _contact(mode, move, sensors.switch_closed)
    resolver, apart = _resolver(config, last.resolver, joints)
    evrs += apart
    if move is None or move.phase is Phase.RELEASE:
        return QUIET if resolver == 0 else MonitorState(0, 0, resolver), evrs
    following, found = _following(config, last.following, move.hold.motor_rad, joints.motor_rad)
    over_current, drawn = _over_current(config, last.over_current, sensors.current_A)
    counts = MonitorState(following, over_current, resolver)
    return QUIET if counts == QUIET else counts, evrs + found + drawn


def _soft_limits(config: Config, move: Move, motor_rad: Array) -> tuple[Evr, ...]:
    """A joint beyond a limit that is not being moved back; an arm at rest has nothing to be stopped."""
    below, above = motor_rad < lowest_for(config, move), motor_rad > config.highest_rad
    if not (below.any() or above.any()):
        return ()
    rate_rad_s = move.hold.rate_rad_s
    below, above = below & (rate_rad_s < 0), above & (rate_rad_s > 0)
    if not (below.any() or above.any()):
        return ()
    joint = Joint(int(np.argmax(below | above)))
    lowest = config.arm.soft_min_rad if move.seek is None else lowest_for(config, move)
    limit = lowest[joint] if below[joint] else config.arm.soft_max_rad[joint]
    return (SoftLimitPassed(joint, float(motor_rad[joint]), float(limit)),)


def lowest_for(config: Config, move: Move) -> Array:
    """Motor angles not to be passed: a joint that seeks its hardstop goes beyond its soft limit."""
    return config.lowest_rad if move.seek is None else config.lowest_seeking_rad[move.seek.joint]


def _resolver(config: Config, last: int, joints: JointEstimate) -> tuple[int, tuple[Evr, ...]]:
    """A resolver away from the believed output of its joint by more than its bound and what is unknown."""
    bounds = config.params.monitors
    error_rad = np.abs(joints.resolver_error_rad)
    if error_rad.max() <= bounds.resolver_error_rad:
        return 0, ()
    excess = error_rad - joints.uncertainty_rad - bounds.resolver_error_rad
    excess = np.where(joints.reference.calibrated, excess, -np.inf)
    if excess.max() <= 0:
        return 0, ()
    if last + 1 < bounds.resolver_persistence:
        return last + 1, ()
    joint = Joint(int(excess.argmax()))
    error = float(joints.resolver_error_rad[joint])
    return last + 1, (ResolverDisagrees(joint, error, abs(error) - float(excess[joint])),)


def _contact(mode: Mode, move: Move | None, closed: Flags) -> tuple[Evr, ...]:
    """A closed switch where nothing was to be touched: any in free space, another tool's when guarded."""
    expected: tuple[Switch, ...] = ()
    if mode in (Mode.GUARDED, Mode.RETRACTING, Mode.PRELOAD, Mode.FAULTED):
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
