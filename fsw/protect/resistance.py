"""Monitor of free moves: resistance of the joints together is an unexpected contact.

Two signals show the torque of an obstacle. Both are compared with their own slow mean since the joint began
to turn, so that constant errors of weights, friction, biases and zeros cancel.

- The motor current, in every cycle: it is quiet, and counts for motors that turn. Friction varies with speed.
- The wind-up, resolver less estimated output, in every update: it is slower, but counts at any speed.

An obstacle acts on several joints, with unknown levers. The statistic is therefore a sum of squares

    S = sum over the joints of (excess against the motion, less its slack, in sigmas)^2

Noise alone gives S at most the chi-square distribution of five degrees of freedom. S passes CONTACT once in
1e9 independent readings: at nine a second, once in three years of motion. A fast mean with gain g less the
slow mean of n readings has the variance s^2 (g / (2 - g) + 1 / n).

The slack is what is not noise. For a current it is the viscous friction in the cold times the change of the
rate, a share for vibration, and the error of the modelled load while the side of the backlash is uncertain.
It is computed only where S passes the bound without it. For a wind-up: the uncertainty of the gear angle.

A joint shows nothing, and its slow means begin anew, in these cases:

- The gear does not drag the output: while it takes up its backlash, friction and load come and go.
- The side of the backlash is uncertain, for the wind-up: a crossing looks like any torque.
- The motor turns by less than a count a cycle, or turns back: its friction may have any value.
- The wind-up changes with the motion, which no obstacle does, or while its mean is young. The mean then holds
  what came before, such as a backlash that was crossed later than estimated.
- A reading jumps farther than noise and a stiff gear at full speed explain: that is a sensor.
- The median of the last readings shows less than half of what the fast mean shows: a few readings are wrong.

`docs/faults.md` derives the force that remains.
"""

from math import dist, sqrt
from operator import gt, sub
from typing import Final, NamedTuple

import numpy as np

from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import UnexpectedContact
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Array
from fsw.protect.inputs import (
    CURRENT_GAIN,
    CURRENT_UPDATES,
    RECENT,
    UPDATE_CYCLES,
    WIND_UP_UPDATES,
    ArmStatus,
    MoveStatus,
    ProtectionBounds,
    take_median,
)

CONTACT: Final = 50.7
"""Value that chi-square with five degrees of freedom passes with a probability of 1e-9."""
LEAST_UPDATES: Final = 3
"""Updates from which a slow mean is known."""
LEAST_WIND_UP_UPDATES: Final = 8
"""Updates beyond which that of the wind-up is known, 1 s: a jump has then left the smoothed error."""
DRAGGED_RAD: Final = 1e-5
"""Distance from the angle at which the gear drags its output: 1 N m, less than the error of any load."""
CHANGE_SIGMAS: Final = 3.0
"""Change of the wind-up that is no noise; noise alone begins one mean in 370 anew."""
LEAST_LEVER_M: Final = 0.05
"""Lever of the tool's motion on the joints below which no force is computed from their torques."""


class JointMeans(NamedTuple):
    """Slow means of a joint since it began to turn, and its last values."""

    updates: int = 0
    """Updates of the mean friction and rate; 0 begins them anew."""
    friction_A: float = 0.0
    """Current beyond that of the modelled load."""
    rate_rad_s: float = 0.0
    """Rate of the motor, measured from update to update."""
    wind_up_updates: int = 0
    """Updates of the mean wind-up; 0 begins it anew."""
    wind_up_rad: float = 0.0
    """Resolver less estimated output."""
    last_motor_rad: float = 0.0
    last_rate_rad_s: float = 0.0
    last_wind_up_rad: float = 0.0
    last_side: float = 0.0
    """Side of the backlash."""


class FreeMove(NamedTuple):
    """Monitor of a free move from cycle to cycle; values in the order of Joint."""

    cycles: int
    """Cycles since the last update of the slow means."""
    read: tuple[float, ...]
    """Readings of the cycle before: currents, then resolver less motor angles, (10,)."""
    fast_A: tuple[float, ...]
    """Fast means of the currents."""
    expected_A: tuple[float, ...]
    """Currents without a contact."""
    per_A: tuple[float, ...]
    """Sigmas per ampere, positive for a motor that turns forward; 0 for one that shows nothing."""
    means: tuple[JointMeans, ...]
    recent: tuple[tuple[float, ...], ...]
    """Readings of the last cycles, the newest first."""


NO_MEANS: Final = (JointMeans(),) * len(Joint)
NOTHING: Final = (0.0,) * len(Joint)


def monitor_free_move(
    bounds: ProtectionBounds,
    last: FreeMove | None,
    arm: ArmStatus,
    readings: tuple[float, ...],
    unchanged: tuple[int, ...],
) -> tuple[FreeMove | None, tuple[Evr, ...]]:
    """Check that nothing resists a free move.

    Args:
        readings: Noisy readings, in the order of `readings.NOISY`.
        unchanged: For how many cycles each of them has been the same.
    """
    move = arm.move
    if move is None or arm.mode is not Mode.FREE_SPACE or move.is_releasing or move.is_stopping:
        return None, ()
    if move.homing is not None:
        return None, ()
    read = (*readings[5:10], *map(sub, readings[:5], arm.motor_rad.tolist()))
    if last is None:
        return FreeMove(0, read, read[:5], read[:5], NOTHING, NO_MEANS, (read,)), ()
    near = dist(read[:5], last.read[:5]) <= bounds.least_step_A
    near = near and dist(read[5:], last.read[5:]) <= bounds.least_step_rad
    if not near and any(map(gt, map(abs, map(sub, read, last.read)), bounds.reading_step)):
        last = _forget_jumps(bounds, last, read)
    cycles, _, fast_A, expected_A, per_A, means, recent = last
    means_A, total = [], 0.0
    # the readings of the resolvers follow those of the currents, and are left out
    for reading, mean, expected, per in zip(read, fast_A, expected_A, per_A, strict=False):
        mean += CURRENT_GAIN * (reading - mean)
        means_A.append(mean)
        excess = (mean - expected) * per
        if excess > 0.0:
            total += excess * excess
    recent = (read, *recent[: RECENT - 1])
    now = FreeMove(cycles + 1, read, tuple(means_A), expected_A, per_A, means, recent)
    if total > CONTACT:
        contact = check_currents(bounds, now, arm, move)
        if contact:
            return now, contact
    if now.cycles < UPDATE_CYCLES:
        return now, ()
    load_A = compute_load_current(bounds, arm)
    updated = update_means(bounds, now, arm, load_A, unchanged)
    contact = check_wind_up(bounds, now, updated, arm, move)
    expected_A, per_A = expect_currents(bounds, updated, load_A)
    return FreeMove(0, read, now.fast_A, expected_A, per_A, updated, recent), contact


def take_medians(recent: tuple[tuple[float, ...], ...]) -> list[float]:
    """Take the medians of the last readings, (10,)."""
    return [take_median(values) for values in zip(*recent, strict=True)]


def show_half(off: float, median_off: float) -> bool:
    """Return whether a median shows at least half of what a mean shows, in its direction."""
    return 2.0 * median_off * off >= off * off


def _forget_jumps(bounds: ProtectionBounds, last: FreeMove, read: tuple[float, ...]) -> FreeMove:
    """Begin the means of readings that jumped anew; until they are known these joints show nothing."""
    jumped = list(map(gt, map(abs, map(sub, read, last.read)), bounds.reading_step))
    current, gear = jumped[:5], jumped[5:]
    means = [one._replace(updates=0) if jump else one for jump, one in zip(current, last.means, strict=True)]
    return last._replace(
        fast_A=tuple([a if jump else b for jump, a, b in zip(current, read[:5], last.fast_A, strict=True)]),
        per_A=tuple([0.0 if jump else per for jump, per in zip(current, last.per_A, strict=True)]),
        means=tuple(
            [one._replace(wind_up_updates=0) if jump else one for jump, one in zip(gear, means, strict=True)]
        ),
    )


def check_currents(
    bounds: ProtectionBounds, now: FreeMove, arm: ArmStatus, move: MoveStatus
) -> tuple[Evr, ...]:
    """Check the currents of a cycle, less their slack, against those that are expected."""
    medians = take_medians(now.recent)
    off_A = [
        mean - expected if show_half(mean - expected, median - expected) else 0.0
        for mean, expected, median in zip(now.fast_A, now.expected_A, medians[:5], strict=True)
    ]
    slack_A = compute_slack(bounds, now.means)
    excess = [
        max(off * per - slack * abs(per), 0.0)
        for off, per, slack in zip(off_A, now.per_A, slack_A, strict=True)
    ]
    if sum(one * one for one in excess) <= CONTACT:
        return ()
    off_rad = np.array(off_A) / bounds.stiffness_A_rad
    torque_Nm = np.where(np.array(now.per_A) == 0.0, 0.0, -off_rad * bounds.arm.gear_stiffness_Nm_rad)
    return (describe_contact(bounds, arm, move, torque_Nm, excess.index(max(excess))),)


def compute_slack(bounds: ProtectionBounds, means: tuple[JointMeans, ...]) -> list[float]:
    """Compute the currents that friction at another speed and errors of the load explain, (5,)."""
    slack_A = []
    for one, damping, steady_A, error_A in zip(
        means, bounds.damping_As_rad, bounds.steady_A, bounds.load_error_A, strict=True
    ):
        # until the next update the rate changes by no more than its lag, and what the jerk adds
        lag = 2.0 * abs(one.last_rate_rad_s - one.rate_rad_s)
        slack_A.append(damping * lag + steady_A + (0.0 if one.last_side else error_A))
    return slack_A


def compute_load_current(bounds: ProtectionBounds, arm: ArmStatus) -> list[float]:
    """Compute the currents that the estimated wind-up of the gears takes, (5,), without friction."""
    each = zip(arm.gear_rad.tolist(), arm.half_backlash_rad.tolist(), bounds.stiffness_A_rad, strict=True)
    return [stiffness * (min(max(gear, -half), half) - gear) for gear, half, stiffness in each]


def _wind_up(arm: ArmStatus, gear_rad: Array) -> Array:
    """Compute the wind-up of gears, (5,); in its backlash a gear has none."""
    half = arm.half_backlash_rad
    wind_up: Array = gear_rad - np.minimum(np.maximum(gear_rad, -half), half)
    return wind_up


def update_means(
    bounds: ProtectionBounds, now: FreeMove, arm: ArmStatus, load_A: list[float], unchanged: tuple[int, ...]
) -> tuple[JointMeans, ...]:
    """Update the slow means of all joints, or begin them anew; a repeated resolver reading is left out."""
    after: list[JointMeans] = []
    for last, mean_A, loaded_A, motor, gear, low, high, wound, side, same, turning in zip(
        now.means,
        now.fast_A,
        load_A,
        arm.motor_rad.tolist(),
        arm.gear_rad.tolist(),
        arm.gear_lowest_rad.tolist(),
        arm.gear_highest_rad.tolist(),
        arm.resolver_error_rad.tolist(),
        arm.side.tolist(),
        unchanged[:5],
        bounds.turning_rad_s,
        strict=True,
    ):
        n, friction_A, slow_rate, m, slow, last_motor, last_rate, last_wound, last_side = last
        rate = (motor - last_motor) * bounds.updates_Hz
        is_dragged = abs(gear - (low if rate > 0.0 else high)) < DRAGGED_RAD
        if is_dragged and abs(rate) > turning and rate * last_rate > 0.0:
            n = n + 1 if n < CURRENT_UPDATES else n
            friction_A += (mean_A - loaded_A - friction_A) / n
            slow_rate += (rate - slow_rate) / n
        else:
            n, friction_A, slow_rate = 0, 0.0, 0.0
        off = wound - slow
        is_free = off * rate > 0.0 or m <= LEAST_WIND_UP_UPDATES
        changes = is_free and abs(off) > CHANGE_SIGMAS * bounds.wind_up_sigma_rad[m]
        if same:
            wound = last_wound
        elif changes or side == 0.0 or side != last_side:
            m, slow = 0, wound
        else:
            m = m + 1 if m < WIND_UP_UPDATES else m
            slow += off / m
        after.append(JointMeans(n, friction_A, slow_rate, m, slow, motor, rate, wound, side))
    return tuple(after)


def expect_currents(
    bounds: ProtectionBounds, means: tuple[JointMeans, ...], load_A: list[float]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Compute expected currents and sigmas per ampere until the next update, as in FreeMove."""
    expected_A, per_A = [], []
    for one, loaded_A in zip(means, load_A, strict=True):
        per = 1.0 / bounds.current_sigma_A[one.updates]
        expected_A.append(one.friction_A + loaded_A)
        is_known = one.updates >= LEAST_UPDATES
        per_A.append(0.0 if not is_known else per if one.last_rate_rad_s > 0.0 else -per)
    return tuple(expected_A), tuple(per_A)


def check_wind_up(
    bounds: ProtectionBounds,
    before: FreeMove,
    now: tuple[JointMeans, ...],
    arm: ArmStatus,
    move: MoveStatus,
) -> tuple[Evr, ...]:
    """Check the wind-up in an update against the slow means before it."""
    total, excess, off_rad = 0.0, [], []
    each = zip(
        before.means, now, arm.gear_uncertainty_rad.tolist(), move.setpoint_rate_rad_s.tolist(), strict=True
    )
    for last, one, unsure, rate in each:
        off = one.last_wind_up_rad - last.wind_up_rad
        is_known = min(last.wind_up_updates, one.wind_up_updates) > LEAST_WIND_UP_UPDATES
        # the rate is the commanded one: an encoder that is stuck makes the output run ahead
        resists = is_known and off * rate <= 0.0
        off_rad.append(off if resists else 0.0)
        beyond = abs(off) - unsure if resists else 0.0
        excess.append(beyond / bounds.wind_up_sigma_rad[last.wind_up_updates] if beyond > 0.0 else 0.0)
        total += excess[-1] * excess[-1]
    if total <= CONTACT or not _is_confirmed(before, arm, off_rad, excess):
        return ()
    wound_rad = _wind_up(arm, arm.gear_rad + np.array(off_rad)) - _wind_up(arm, arm.gear_rad)
    torque_Nm = bounds.arm.gear_stiffness_Nm_rad * wound_rad
    return (describe_contact(bounds, arm, move, torque_Nm, excess.index(max(excess))),)


def _is_confirmed(before: FreeMove, arm: ArmStatus, off_rad: list[float], excess: list[float]) -> bool:
    """Return whether the wind-up of the joints whose last readings show it too is a contact by itself."""
    total = 0.0
    medians = take_medians(before.recent)[5:]
    expected_rad = (arm.gear_rad + arm.resolver_bias_rad).tolist()
    for median, expected, one, off, sigmas in zip(
        medians, expected_rad, before.means, off_rad, excess, strict=True
    ):
        if show_half(off, median - expected - one.wind_up_rad):
            total += sigmas * sigmas
    return total > CONTACT


def describe_contact(
    bounds: ProtectionBounds, arm: ArmStatus, move: MoveStatus, torque_Nm: Array, joint: int
) -> UnexpectedContact:
    """Describe a contact by the joint that shows it best, and by a force against the motion of the tool.

    The force is the least-squares fit to the torques of the obstacle on the outputs, (5,), 0 where unknown.
    """
    frames = forward(bounds.arm, arm.motor_rad + arm.gear_rad)
    J = joint_jacobian(frames, tool_pose(bounds.arm, frames, arm.tool).p)[3:]
    velocity_m_s = J @ move.setpoint_rate_rad_s
    speed_m_s = sqrt(float(velocity_m_s @ velocity_m_s))
    per_N = np.where(torque_Nm == 0.0, 0.0, -J.T @ velocity_m_s) / max(speed_m_s, 1e-9)
    square = float(per_N @ per_N)
    force_N = float(per_N @ torque_Nm) / square if square > LEAST_LEVER_M**2 else 0.0
    return UnexpectedContact(Joint(joint), abs(float(torque_Nm[joint])), abs(force_N))
