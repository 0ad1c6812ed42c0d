"""Monitor of free moves: resistance of several joints at once is an unexpected contact.

Two signals show the torque of an obstacle. Both are compared with their own mean since the joint began to turn,
so that constant errors of weights, friction, biases and zeros cancel.

- The motor current, every cycle: it is quiet, but friction changes with the speed. It counts for motors that turn.
- The wind-up, resolver less estimated output, every UPDATE_CYCLES: it is slower, but counts at any speed and for
  joints on their brakes.

An obstacle acts on several joints, with unknown levers. The statistic is therefore the sum of squares

    S = sum over joints of (excess of the mean over its expectation and slack, against the motion, in sigmas)^2

With noise alone, S has at most the chi-square distribution of five degrees of freedom. It passes CONTACT once in
1e9 independent readings: with nine of them a second, once in three years of motion. The noise of a fast mean with
gain g over a slow mean of n readings has the variance s^2 (g / (2 - g) + 1 / n).

The slack is what is not noise. For the current it is the viscous friction in the cold times the change of speed. For
the wind-up it is the uncertainty of the gear angle: that of the modelled load, and of its side of the backlash.

A joint shows nothing, and its slow means begin anew, in these cases:

- The side of the backlash is uncertain or changes: a crossing looks like a torque.
- The motor turns by less than an encoder count a cycle, or turns back: its friction may have any value.
- A reading jumps farther than noise and the stiffness of the gear at full speed explain: that is a sensor.

docs/faults.md derives the force that remains after noise, speed and reaction time.
"""

from math import sqrt
from operator import gt, sub
from typing import Final, NamedTuple

import numpy as np

from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import UnexpectedContact
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Array
from fsw.protect.bounds import (
    CURRENT_GAIN,
    CURRENT_UPDATES,
    UPDATE_CYCLES,
    WIND_UP_UPDATES,
    ProtectionBounds,
)
from fsw.protect.status import ArmStatus, MoveStatus

CONTACT: Final = 50.7
"""Value that chi-square with five degrees of freedom passes with a probability of 1e-9."""
LEAST_UPDATES: Final = 3
"""Updates from which a slow mean is known."""
LEAST_LEVER_M: Final = 0.05
"""Lever of the tool's motion on the joints below which no force is computed from their torques."""
NONE: Final = (0.0,) * len(Joint)


class Means(NamedTuple):
    """Slow means of a joint since it began to turn on one flank of its backlash."""

    updates: int = 0
    """Updates of friction and speed; 0 begins them anew."""
    friction_A: float = 0.0
    """Current beyond that of the modelled load."""
    rate_rad_s: float = 0.0
    """Measured rate of the motor."""
    last_rate_rad_s: float = 0.0
    last_motor_rad: float = 0.0
    wound_updates: int = 0
    """Updates of the wind-up; 0 begins it anew."""
    wound_rad: float = 0.0
    """Resolver less estimated output."""
    last_wound_rad: float = 0.0
    side: float = 0.0
    """Side of the backlash."""


class FreeMove(NamedTuple):
    """Monitor of a free move from cycle to cycle; values in the order of Joint."""

    cycles: int
    """Cycles since the last update of the slow means."""
    read_A: tuple[float, ...]
    """Current readings of the cycle before."""
    fast_A: tuple[float, ...]
    """Fast means of the currents."""
    expected_A: tuple[float, ...]
    """Currents without a contact."""
    per_A: tuple[float, ...]
    """Sigmas per ampere, positive for a motor that turns forward; 0 for a joint that shows nothing."""
    slack: tuple[float, ...]
    """Excess in sigmas that a change of speed explains."""
    means: tuple[Means, ...]


UNKNOWN: Final = (Means(),) * len(Joint)


def monitor_free_move(
    bounds: ProtectionBounds,
    last: FreeMove | None,
    arm: ArmStatus,
    readings: tuple[float, ...],
    unchanged: tuple[int, ...],
) -> tuple[FreeMove | None, tuple[Evr, ...]]:
    """Check that nothing resists a free move.

    Args:
        bounds: Bounds of protection.
        last: State of the cycle before; None if no free move was under way.
        arm: Arm with its joints and move.
        readings: Noisy readings, in the order of `readings.NOISY`.
        unchanged: For how many cycles each of them has been the same.

    Returns:
        The state for the next cycle, None unless a free move is under way, and the fault.
    """
    move = arm.move
    if move is None or arm.mode is not Mode.FREE_SPACE or move.is_releasing or move.is_stopping:
        return None, ()
    if move.homing is not None:
        return None, ()
    read_A = readings[5:10]
    if last is None:
        return FreeMove(0, read_A, read_A, read_A, NONE, NONE, UNKNOWN), ()
    cycles, before_A, fast_A, expected_A, per_A, slack, means = last
    fast_A = tuple([mean + CURRENT_GAIN * (now - mean) for now, mean in zip(read_A, fast_A, strict=True)])
    if any(map(gt, map(abs, map(sub, read_A, before_A)), bounds.current_step_A)):
        jumped = [abs(a - b) > c for a, b, c in zip(read_A, before_A, bounds.current_step_A, strict=True)]
        per_A = tuple([0.0 if is_jump else one for is_jump, one in zip(jumped, per_A, strict=True)])
        means = tuple(
            [one._replace(updates=0) if is_jump else one for is_jump, one in zip(jumped, means, strict=True)]
        )
    total, worst, joint = 0.0, 0.0, 0
    for k, (mean, expected, per, less) in enumerate(zip(fast_A, expected_A, per_A, slack, strict=True)):
        excess = (mean - expected) * per - less
        if excess > 0.0:
            total += excess * excess
            if excess > worst:
                worst, joint = excess, k
    found: tuple[Evr, ...] = ()
    if total > CONTACT:
        torque_Nm = [
            (mean - expected) * constant if per else 0.0
            for mean, expected, per, constant in zip(
                fast_A, expected_A, per_A, bounds.torque_constant_Nm_A, strict=True
            )
        ]
        found = (describe_contact(bounds, arm, move, -np.array(torque_Nm), joint),)
    cycles += 1
    if cycles < UPDATE_CYCLES:
        return FreeMove(cycles, read_A, fast_A, expected_A, per_A, slack, means), found
    means, by_wind_up = update_means(bounds, means, arm, move, fast_A, unchanged)
    expected_A, per_A, slack = expect_currents(bounds, means, arm)
    return FreeMove(0, read_A, fast_A, expected_A, per_A, slack, means), found or by_wind_up


def load_current_A(bounds: ProtectionBounds, arm: ArmStatus) -> list[float]:
    """Compute the currents that the estimated wind-up of the gears takes, (5,)."""
    wound_rad = arm.gear_rad - arm.side * arm.half_backlash_rad
    current: list[float] = (-wound_rad * bounds.stiffness_A_rad).tolist()
    return current


def update_means(
    bounds: ProtectionBounds,
    means: tuple[Means, ...],
    arm: ArmStatus,
    move: MoveStatus,
    fast_A: tuple[float, ...],
    unchanged: tuple[int, ...],
) -> tuple[tuple[Means, ...], tuple[Evr, ...]]:
    """Update the slow means, and check the wind-up against its own.

    Returns:
        The means, and the fault that the wind-up shows.
    """
    after: list[Means] = []
    excess = [0.0] * len(Joint)
    each = zip(
        means,
        fast_A,
        load_current_A(bounds, arm),
        arm.motor_rad.tolist(),
        arm.resolver_error_rad.tolist(),
        arm.side.tolist(),
        bounds.turning_rad_s,
        bounds.wind_up_step_rad,
        arm.gear_uncertainty_rad.tolist(),
        strict=True,
    )
    for joint, (last, mean_A, load_A, motor, wound, side, turning, step, unsure) in enumerate(each):
        n, friction_A, slow_rate, last_rate, last_motor, m, slow, before, last_side = last
        rate = (motor - last_motor) * bounds.updates_Hz
        sure = side != 0.0 and side == last_side
        if sure and abs(rate) > turning and rate * last_rate > 0.0:
            n = min(n + 1, CURRENT_UPDATES)
            friction_A += (mean_A - load_A - friction_A) / n
            slow_rate += (rate - slow_rate) / n
        else:
            n = 0
        if not sure or abs(wound - before) > step:
            m, slow = 0, wound
        elif not unchanged[joint]:
            off = wound - slow
            if m >= LEAST_UPDATES and off * rate <= 0.0:
                excess[joint] = max((abs(off) - unsure) / bounds.wind_up_sigma_rad[m], 0.0)
            m = min(m + 1, WIND_UP_UPDATES)
            slow += off / m
        after.append(Means(n, friction_A, slow_rate, rate, motor, m, slow, wound, side))
    if sum([one * one for one in excess]) <= CONTACT:
        return tuple(after), ()
    off_rad = [x.last_wound_rad - y.wound_rad if one else 0.0 for x, y, one in zip(after, means, excess, strict=True)]
    torque_Nm = compute_torque(bounds, arm, np.array(off_rad))
    return tuple(after), (
        describe_contact(bounds, arm, move, torque_Nm, int(np.argmax(excess))),
    )


def expect_currents(
    bounds: ProtectionBounds, means: tuple[Means, ...], arm: ArmStatus
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Expect the currents until the next update.

    Returns:
        Expected currents, sigmas per ampere and slack, as in FreeMove.
    """
    expected, per, slack = [], [], []
    for one, load_A, damping, jerk in zip(
        means, load_current_A(bounds, arm), bounds.damping_As_rad, bounds.rate_step_rad_s, strict=True
    ):
        is_known = one.updates >= LEAST_UPDATES
        sigma_A = bounds.current_sigma_A[one.updates]
        expected.append(one.friction_A + load_A)
        per.append((1.0 if one.last_rate_rad_s > 0.0 else -1.0) / sigma_A if is_known else 0.0)
        # until the next update the speed changes by no more than its lag, and what the jerk adds
        change_rad_s = 2 * abs(one.last_rate_rad_s - one.rate_rad_s) + jerk
        slack.append(damping * change_rad_s / sigma_A)
    return tuple(expected), tuple(per), tuple(slack)


def describe_contact(
    bounds: ProtectionBounds, arm: ArmStatus, move: MoveStatus, torque_Nm: Array, joint: int
) -> UnexpectedContact:
    """Describe a contact by the joint that shows it best, and by a force against the motion of the tool.

    The force is the least-squares fit to the torques of the joints that show something.
    """
    frames = forward(bounds.arm, arm.motor_rad + arm.gear_rad)
    J = joint_jacobian(frames, tool_pose(bounds.arm, frames, arm.tool).p)[3:]
    velocity = J @ move.setpoint_rate_rad_s
    speed = sqrt(float(velocity @ velocity))
    per_N = np.where(torque_Nm == 0.0, 0.0, -J.T @ velocity / max(speed, 1e-9))
    square = float(per_N @ per_N)
    force_N = float(per_N @ torque_Nm) / square if square > LEAST_LEVER_M**2 else 0.0
    return UnexpectedContact(Joint(joint), abs(float(torque_Nm[joint])), abs(force_N))


def compute_torque(bounds: ProtectionBounds, arm: ArmStatus, off_rad: Array) -> Array:
    """Compute the torques on the outputs, (5,), that turn them this far; in its backlash a gear carries none."""
    half = arm.half_backlash_rad
    before, after = arm.gear_rad, arm.gear_rad + off_rad
    wound_rad = (after - np.clip(after, -half, half)) - (before - np.clip(before, -half, half))
    torque_Nm: Array = bounds.arm.gear_stiffness_Nm_rad * wound_rad
    return torque_Nm
