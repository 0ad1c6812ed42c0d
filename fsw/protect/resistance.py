"""Monitor of free moves: resistance that winds up the gears is an unexpected contact.

An obstacle holds back an output whose motor turns on. Resolver less motor and estimated gear angle then moves
against the motion. Constant errors, such as those of zeros, biases and weights, are in its slow mean as well,
and cancel. A joint shows resistance if

    fast mean - slow mean  >  6 sigma of the noise of both  +  uncertainty of the gear angle

The noise has variance s2 g / (2 - g) for the fast mean with gain g, and s2 / n for the mean of n readings. Six
sigma are passed once in 1e9 independent readings. Five joints have 64 / 8 of them a second, so that noise alone
raises a false alarm in ten months of motion. The uncertainty is that of the modelled load and of a backlash that
may have been crossed.

In these cases a joint shows nothing, and its slow mean begins anew:

- The side of the backlash is not certain. A crossing looks like any torque up to backlash times stiffness.
- The angle jumps farther than noise and the joint's greatest speed explain: that is a sensor.
- The resolver reads the same as before: it may be frozen.

The least torque that is found is K (6 s sqrt(g / (2 - g)) + u): 20 N m at the large joints and 10 N m at the
small ones of Curiosity. Along a joint with lever r the least force is this over r. The force still rises by
stiffness times speed times reaction time, see `docs/faults.md`.
"""

from typing import Final, NamedTuple

import numpy as np

from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import UnexpectedContact
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Array
from fsw.protect.bounds import FAST_GAIN, LEAST_READINGS, MOST_READINGS, ProtectionBounds
from fsw.protect.status import ArmStatus

SLOWEST_RAD_S: Final = 1e-9
"""Speed of a tool below which its direction is not computed."""
LEAST_LEVER_M: Final = 0.05
"""Lever of the motion on the joints below which no force is computed from their torques."""


class JointResistance(NamedTuple):
    """Resistance of one joint from cycle to cycle."""

    wound_rad: float
    """Resolver less motor and estimated gear angle, of the last cycle."""
    slow_rad: float
    """Slow mean of it."""
    fast_rad: float
    """Fast mean of it, less the slow mean."""
    readings: int
    """Number of readings in the slow mean, at most MOST_READINGS; 0 begins it anew."""


UNKNOWN: Final = JointResistance(0.0, 0.0, 0.0, 0)
Resistance = tuple[JointResistance, ...]


def monitor_free_move(
    bounds: ProtectionBounds,
    last: Resistance | None,
    arm: ArmStatus,
    resolver_rad: tuple[float, ...],
    unchanged: tuple[int, ...],
) -> tuple[Resistance | None, tuple[Evr, ...]]:
    """Check that nothing resists a free move.

    Args:
        bounds: Bounds of protection.
        last: State of the cycle before; None if no free move was under way.
        arm: Arm with its joints and move.
        resolver_rad: Resolver readings, first five of the noisy readings.
        unchanged: For how many cycles each noisy reading has been the same.

    Returns:
        The state for the next cycle, None unless a free move is under way, and the fault.
    """
    move = arm.move
    if move is None or arm.mode is not Mode.FREE_SPACE or move.is_releasing or move.is_stopping:
        return None, ()
    if move.homing is not None:
        return None, ()
    now: list[JointResistance] = []
    worst, found = 1.0, -1
    for joint, (before, read, motor, gear, unsure, side, rate, step, same) in enumerate(
        zip(
            (UNKNOWN,) * len(Joint) if last is None else last,
            resolver_rad,
            arm.motor_rad.tolist(),
            arm.gear_rad.tolist(),
            arm.gear_uncertainty_rad.tolist(),
            arm.side.tolist(),
            move.setpoint_rate_rad_s.tolist(),
            bounds.free_step_rad,
            unchanged,
            strict=False,
        )
    ):
        if same:
            now.append(before)
            continue
        wound = read - motor - gear
        last_rad, slow, fast, n = before
        if n == 0 or side == 0.0 or not -step < wound - last_rad < step:
            now.append(JointResistance(wound, wound, 0.0, 1))
            continue
        off = wound - slow
        fast += FAST_GAIN * (off - fast)
        if n < MOST_READINGS:
            n += 1
        now.append(JointResistance(wound, slow + off / n, fast, n))
        if n > LEAST_READINGS and fast * rate <= 0.0:
            share = abs(fast) / (bounds.free_noise_rad[n] + unsure)
            if share > worst:
                worst, found = share, joint
    if found < 0:
        return tuple(now), ()
    return tuple(now), (describe_contact(bounds, arm, tuple(now), Joint(found)),)


def describe_contact(
    bounds: ProtectionBounds, arm: ArmStatus, resistance: Resistance, joint: Joint
) -> UnexpectedContact:
    """Describe a contact: torque of the joint that shows it best, and force against the motion of the tool.

    The force is the least-squares fit to the torques of the joints that are sure of their backlash.
    """
    torque_Nm = compute_torque(bounds, arm, np.array([one.fast_rad for one in resistance]))
    known = np.array([one.readings > LEAST_READINGS for one in resistance])
    per_N = np.where(known, _compute_torque_per_N(bounds, arm), 0.0)
    square = float(per_N @ per_N)
    force_N = float(per_N @ torque_Nm) / square if square > LEAST_LEVER_M**2 else 0.0
    return UnexpectedContact(joint, abs(float(torque_Nm[joint])), abs(force_N))


def compute_torque(bounds: ProtectionBounds, arm: ArmStatus, resisted_rad: Array) -> Array:
    """Compute the torques, (5,), that turn the outputs this far; in its backlash a gear carries none."""
    half = arm.half_backlash_rad
    before, after = arm.gear_rad, arm.gear_rad + resisted_rad
    wound_rad = (after - np.clip(after, -half, half)) - (before - np.clip(before, -half, half))
    torque_Nm: Array = bounds.arm.gear_stiffness_Nm_rad * wound_rad
    return torque_Nm


def _compute_torque_per_N(bounds: ProtectionBounds, arm: ArmStatus) -> Array:
    """Compute the torque of a newton on the tool against its motion, (5,); zero if it does not move."""
    frames = forward(bounds.arm, arm.motor_rad + arm.gear_rad)
    J = joint_jacobian(frames, tool_pose(bounds.arm, frames, arm.tool).p)[3:]
    rate = np.zeros(len(Joint)) if arm.move is None else arm.move.setpoint_rate_rad_s
    velocity = J @ rate
    speed = float(np.linalg.norm(velocity))
    per_N: Array = -J.T @ velocity / speed if speed > SLOWEST_RAD_S else np.zeros(len(Joint))
    return per_N
