"""Effects of gears and encoders that a robot and its logs may show, with their typical sizes."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from simgap.effects.coupling import JointCoupling
from simgap.effects.effect import Effect
from simgap.effects.joint import JointScales
from simgap.effects.periodic import PeriodicError, SmoothPeriodicError
from simgap.effects.transmission import Backlash, JointCompliance, gear_inertia_kgm2
from simgap.logs import JointLog, Motion
from simgap.robot import Robot, RobotJoint

VISIBLE_Hz: Final = 10.0
"""Resonance of a joint that is worth a name: logs have 20 samples a second at least."""
SOFTEST_Hz: Final = 2.0
"""Resonance below which a joint would be seen to swing."""
DEFLECTION_RAD: Final = 0.05
"""Deflection under full torque that is worth a name, where the link is too light for such a resonance. Ten
times as much would be seen."""
SERVO_BACKLASH_RAD: Final = 0.01
"""Backlash of a hobby servo, half a degree. Ten times as much would be felt by hand."""
SERVO_COUPLING: Final = 0.05
"""Share of a joint's load at its neighbour that is worth a name."""
SEEN_SHARE: Final = 0.5
"""Share of the spread between two encoders that an effect must explain to be worth a name."""


def transmission_effects(
    robot: Robot, motions: Sequence[Motion], scales: Mapping[str, JointScales]
) -> list[Effect]:
    """List backlash, compliance, couplings and periodic errors.

    An encoder is taken to be at the motor where a second one looks on, or where the robot file gives torques
    of the motor (gear ratio above 1); else it is at the output, as in servos. Without a second encoder, gears
    show in a simulation only, so there must be commands. Periodic errors need the second encoder: that of the
    loop hides its own.

    Args:
        motions: Motions that are fitted.
        scales: Numbers of the joints.

    Returns:
        Effects.
    """
    found: list[Effect] = []
    for j, joint in enumerate(robot.joints):
        logs = [motion.joints[joint.name] for motion in motions if joint.name in motion.joints]
        spread_rad = _spread_rad(logs)
        if not logs or (spread_rad == 0 and not all(log.command for log in logs)):
            continue
        found += _gear(robot, j, scales[joint.name], spread_rad)
        found += _couplings(robot, j, scales, spread_rad)
        if spread_rad > 0:
            found += _periodic(joint, scales[joint.name], spread_rad)
    return found


def _spread_rad(logs: Sequence[JointLog]) -> float:
    """Return the standard deviation of second encoder minus position; 0 without a second encoder."""
    differences = [
        np.interp(log.position.time_s, log.secondary.time_s, log.secondary.value) - log.position.value
        for log in logs
        if log.secondary is not None and log.secondary.value.any()
    ]
    return float(np.std(np.concatenate(differences))) if differences else 0.0


def _gear(robot: Robot, j: int, scales: JointScales, spread_rad: float) -> list[Effect]:
    joint = robot.joints[j]
    is_at_output = spread_rad == 0 and joint.gear_ratio == 1
    if spread_rad > 0:
        backlash_rad, compliance = 2 * SEEN_SHARE * spread_rad, SEEN_SHARE * spread_rad / scales.torque_Nm
        high_rad, softest = 10 * backlash_rad, 10 * compliance
    else:
        per_compliance = gear_inertia_kgm2(robot, j) * (2 * np.pi) ** 2
        static = DEFLECTION_RAD / scales.torque_Nm
        backlash_rad, high_rad = SERVO_BACKLASH_RAD, 10 * SERVO_BACKLASH_RAD
        compliance = min(1 / (per_compliance * VISIBLE_Hz**2), static)
        softest = min(1 / (per_compliance * SOFTEST_Hz**2), 10 * static)
    return [
        Backlash(joint.name, j, is_at_output, backlash_rad, high_rad),
        JointCompliance(joint.name, j, is_at_output, compliance, softest),
    ]


def _couplings(robot: Robot, j: int, scales: Mapping[str, JointScales], spread_rad: float) -> list[Effect]:
    found: list[Effect] = []
    for k in (j - 1, j + 1):
        if not 0 <= k < len(robot.joints) or robot.joints[k].name not in scales:
            continue
        neighbour = robot.joints[k].name
        range_rad = scales[neighbour].high_rad - scales[neighbour].low_rad
        typical = SEEN_SHARE * spread_rad / range_rad if spread_rad > 0 and range_rad > 0 else SERVO_COUPLING
        found.append(JointCoupling(robot.joints[j].name, j, neighbour, k, min(typical, SERVO_COUPLING)))
    return found


def _periodic(joint: RobotJoint, scales: JointScales, spread_rad: float) -> list[Effect]:
    """List the orders of an eccentric or tilted encoder, of the motor, and all orders that are smooth.

    A single order is listed if the joint turns through half a period of it. Less of a wave looks like a
    compliance or a scale, and its amplitude can be anything.
    """
    range_rad = scales.high_rad - scales.low_rad
    orders = dict.fromkeys((1, 2, max(1, round(joint.gear_ratio))))
    typical_rad = SEEN_SHARE * spread_rad
    single = [PeriodicError(joint.name, k, typical_rad) for k in orders if k * range_rad >= np.pi]
    return [*single, SmoothPeriodicError(joint.name, typical_rad)]
