"""Monitors of the joints: limits, following, stall, current, temperature, resolver against encoder.

Those with a persistence take how many cycles in a row they have been beyond their bound, and return it.
"""

from operator import ge, le

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import (
    FollowingErrorHigh,
    MotorStalled,
    OverCurrent,
    OverTemperature,
    ResolverDisagrees,
    SoftLimitPassed,
    UnderTemperature,
)
from fsw.dictionary.joints import Joint
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.motion.move import Move


def beyond(config: Config, move: Move | None, sensors: Sensors, joints: JointEstimate) -> bool:
    """Whether any joint is beyond a bound below; only then it is asked beyond which, and for how long."""
    motor = joints.motor_rad
    behind = motor - (motor if move is None else move.hold.motor_rad)
    watched = (
        *motor.tolist(),
        *behind.tolist(),
        *sensors.current_A.tolist(),
        *sensors.winding_C.tolist(),
        *joints.resolver_error_rad.tolist(),
    )
    return not (all(map(ge, watched, config.watched_low)) and all(map(le, watched, config.watched_high)))


def soft_limits(config: Config, move: Move, motor_rad: Array) -> tuple[Evr, ...]:
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


def following(config: Config, last: int, error_rad: Array) -> tuple[int, tuple[Evr, ...]]:
    """A motor too far from its set-point."""
    bounds = config.params.monitors
    if error_rad.max() <= bounds.following_error_rad:
        return 0, ()
    if last + 1 < bounds.following_persistence:
        return last + 1, ()
    joint = Joint(int(error_rad.argmax()))
    return last + 1, (FollowingErrorHigh(joint, float(error_rad[joint]), bounds.following_error_rad),)


def stalled(
    config: Config, last: int, move: Move, error_rad: Array, joints: JointEstimate
) -> tuple[int, tuple[Evr, ...]]:
    """A motor that does not turn as it is to, so far from its set-point that it is no matter of friction.

    A joint that seeks its hardstop is to stall, and is watched by its own rules.
    """
    bounds = config.params.monitors
    if move.seek is not None:
        return 0, ()
    asked = move.hold.rate_rad_s
    short = bounds.stall_share * np.abs(asked) - joints.motor_rate_rad_s * np.sign(asked)
    short = np.where(error_rad > bounds.stall_error_rad, short, 0.0)
    if short.max() <= 0:
        return 0, ()
    if last + 1 < bounds.stall_persistence:
        return last + 1, ()
    joint = Joint(int(short.argmax()))
    return last + 1, (MotorStalled(joint, float(joints.motor_rate_rad_s[joint]), float(asked[joint])),)


def over_current(config: Config, last: int, current_A: Array) -> tuple[int, tuple[Evr, ...]]:
    """A motor that draws nearly all that it may."""
    bounds = config.params.monitors
    bound = bounds.over_current_fraction * config.current_limit_A
    excess = np.abs(current_A) - bound
    if excess.max() <= 0:
        return 0, ()
    if last + 1 < bounds.over_current_persistence:
        return last + 1, ()
    joint = Joint(int(excess.argmax()))
    return last + 1, (OverCurrent(joint, float(current_A[joint]), float(bound[joint])),)


def winding(config: Config, last: int, moving: bool, winding_C: Array) -> tuple[int, tuple[Evr, ...]]:
    """A winding too hot, or too cold while the arm moves: at rest it may be as cold as it gets."""
    bounds, read_C = config.params.monitors, winding_C.tolist()
    coldest, hottest = min(read_C), max(read_C)
    hot = hottest > bounds.winding_max_C
    if not hot and not (moving and coldest < bounds.winding_min_C):
        return 0, ()
    if last + 1 < bounds.winding_persistence:
        return last + 1, ()
    if hot:
        return last + 1, (OverTemperature(Joint(read_C.index(hottest)), hottest, bounds.winding_max_C),)
    return last + 1, (UnderTemperature(Joint(read_C.index(coldest)), coldest, bounds.winding_min_C),)


def resolver(config: Config, last: int, joints: JointEstimate) -> tuple[int, tuple[Evr, ...]]:
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
