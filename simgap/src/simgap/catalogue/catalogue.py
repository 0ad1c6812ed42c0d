"""The catalogue: every effect that makes sense at a joint, with bounds from the robot and its logs.

Base effects are nuisances: damping, dry friction, armature and gain of each joint whose numbers the model
does not know for certain. They are always fitted and never named, so they are no candidates there.

Effects that no log can tell apart stay in the catalogue side by side; the sets of a verdict hold them
together. docs/robot-effects.md lists these pairs.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simgap.catalogue.links import depends_on_angle, link_effects
from simgap.effects import actuation, command, forces, transmission
from simgap.effects.effect import Effect, JointEffect, JointScales, joint_scales
from simgap.effects.inertia import Armature
from simgap.logs import JointLog, Logs, Motion
from simgap.robot import ControlMode, Robot, RobotJoint

WARMING_K: Final = 5.0
"""Least range of temperature with which friction can be seen to vary: servos show whole kelvins."""


@dataclass(frozen=True, slots=True)
class _Facts:
    """All that decides which effects a joint may have."""

    joint: RobotJoint
    scales: JointScales
    logs: tuple[JointLog, ...]
    zero_is_seen: bool

    def is_logged(self) -> bool:
        """Return True: velocity and load of any log show friction."""
        return True

    def has_command(self) -> bool:
        return any(log.command is not None for log in self.logs)

    def has_position_loop(self) -> bool:
        return self.has_command() and self.joint.mode is ControlMode.POSITION

    def has_damping_loop(self) -> bool:
        return self.has_command() and self.joint.mode in (ControlMode.POSITION, ControlMode.VELOCITY)

    def has_limit(self) -> bool:
        """Return whether torque constant and gain error differ: they do at a limit of the torque."""
        return self.has_command() and math.isfinite(self.joint.torque_limit_Nm)

    def is_switched(self) -> bool:
        """Return whether the motor of a loop is without power in a part of the logs."""
        off = any(log.enabled is not None and bool((log.enabled.value < 0.5).any()) for log in self.logs)
        return off and self.has_damping_loop()

    def warms(self) -> bool:
        return bool(self.scales.hottest_degC - self.scales.coldest_degC > WARMING_K)

    def is_hinge(self) -> bool:
        return not self.joint.is_slide

    def sees_zero(self) -> bool:
        return self.zero_is_seen


_Condition = Callable[[_Facts], bool]
JOINT_EFFECTS: Final[tuple[tuple[type[JointEffect], _Condition], ...]] = (
    (forces.StribeckFriction, _Facts.is_logged),
    (forces.LoadFriction, _Facts.is_logged),
    (forces.AsymmetricFriction, _Facts.is_logged),
    (forces.TemperatureFriction, _Facts.warms),
    (actuation.DampingGain, _Facts.has_damping_loop),
    (actuation.TorqueConstant, _Facts.has_limit),
    (actuation.TorqueLimit, _Facts.has_command),
    (actuation.BackEmf, _Facts.has_command),
    (actuation.DeadZone, _Facts.has_position_loop),
    (actuation.LeakyIntegral, _Facts.has_position_loop),
    (command.VelocityLimit, _Facts.has_position_loop),
    (command.AccelerationLimit, _Facts.has_position_loop),
    (command.ClampLow, _Facts.has_command),
    (command.ClampHigh, _Facts.has_command),
    (forces.ConstantTorque, _Facts.is_logged),
    (forces.Spring, _Facts.is_logged),
    (forces.PositionTorque, _Facts.is_hinge),
    (command.CommandDelay, _Facts.has_command),
    (command.MeasurementDelay, _Facts.is_logged),
    (command.EncoderScale, _Facts.is_logged),
    (command.JointZero, _Facts.sees_zero),
)
"""Effects at one joint, and where each makes sense."""
BASE_EFFECTS: Final[tuple[tuple[type[JointEffect], _Condition], ...]] = (
    (forces.ViscousFriction, _Facts.is_logged),
    (forces.CoulombFriction, _Facts.is_logged),
    (Armature, _Facts.is_logged),
    (actuation.GainError, _Facts.has_command),
)
"""Nuisances of a joint that is not known, and candidates at one that is."""
SWITCHED_EFFECTS: Final[tuple[tuple[type[JointEffect], _Condition], ...]] = (
    (actuation.DampingGain, _Facts.is_switched),
)
"""Further nuisances. Back-EMF acts under power alone; a log without power tells it from viscous friction."""


def catalogue(robot: Robot, logs: Logs) -> tuple[Effect, ...]:
    """List the effects, none of the base, that make sense for a robot and the fitted motions of its logs."""
    found: list[Effect] = []
    all_facts = _facts(robot, logs.fit)
    for facts in all_facts:
        tables = (JOINT_EFFECTS, BASE_EFFECTS) if facts.joint.is_known else (JOINT_EFFECTS,)
        found += _at(robot, facts, [row for table in tables for row in table])
        if facts.joint.gear_ratio > 1:  # a turn of the motor: the only order that a robot file knows
            scale = {facts.joint.name: facts.scales}
            found.append(
                forces.PeriodicTorque.of_order(robot, facts.joint.name, scale, facts.joint.gear_ratio)
            )
    scales = {facts.joint.name: facts.scales for facts in all_facts}
    if len(all_facts) == len(robot.joints) and all(facts.has_command() for facts in all_facts):
        sag = actuation.SupplySag.of(robot, scales, logs.fit)
        found += [sag] if sag.high > 0.0 else []
    found += _common_delays(robot, found)
    found += transmission_effects(robot, logs.fit, scales)
    found += link_effects(robot, logs.fit, scales)
    return tuple(found)


def _common_delays(robot: Robot, found: Sequence[Effect]) -> list[Effect]:
    """List delays that all joints have in common, where several joints may have one each."""
    commands = tuple(one for one in found if isinstance(one, command.CommandDelay))
    positions = tuple(one for one in found if isinstance(one, command.MeasurementDelay))
    if len(commands) < 2:
        return []
    period_s = robot.control_period_s
    return [
        command.CommonCommandDelay(commands, period_s),
        command.CommonMeasurementDelay(positions, period_s),
    ]


def base_effects(robot: Robot, logs: Logs) -> tuple[JointEffect, ...]:
    """List the nuisances of all joints that are not known.

    The sizes have priors. These decide only what the data do not: the armature of a joint that never
    accelerates, or friction at one that never moves.
    """
    found: list[JointEffect] = []
    for facts in _facts(robot, logs.fit):
        found += [] if facts.joint.is_known else _at(robot, facts, (*BASE_EFFECTS, *SWITCHED_EFFECTS))
        if not facts.joint.torque_constant_is_known:
            found += _at(robot, facts, ((actuation.CurrentScale, _Facts.is_logged),))
    return tuple(replace(effect, is_base=True) for effect in found)


def _facts(robot: Robot, motions: Sequence[Motion]) -> list[_Facts]:
    scales = joint_scales(robot, motions)
    return [
        _Facts(
            joint,
            scales[joint.name],
            tuple(motion.joints[joint.name] for motion in motions if joint.name in motion.joints),
            depends_on_angle(robot, joint.name, scales),
        )
        for joint in robot.joints
        if joint.name in scales
    ]


def _at(
    robot: Robot, facts: _Facts, table: Sequence[tuple[type[JointEffect], _Condition]]
) -> list[JointEffect]:
    name = facts.joint.name
    return [kind.at(robot, name, {name: facts.scales}) for kind, makes_sense in table if makes_sense(facts)]


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
    """
    found: list[Effect] = []
    for j, joint in enumerate(robot.joints):
        logs = [motion.joints[joint.name] for motion in motions if joint.name in motion.joints]
        spread_rad = _spread_rad(logs)
        if not logs or (spread_rad == 0 and not all(log.command for log in logs)):
            continue
        found += _gear(robot, j, scales[joint.name], spread_rad)
        found += _couplings(robot, j, scales, spread_rad)
        if spread_rad > 0 and not joint.is_slide:
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
        per_compliance = transmission.gear_inertia_kgm2(robot, j) * (2 * np.pi) ** 2
        static = DEFLECTION_RAD * joint.per_rad / scales.torque_Nm
        backlash_rad = SERVO_BACKLASH_RAD * joint.per_rad
        high_rad = 10 * backlash_rad
        compliance = min(1 / (per_compliance * VISIBLE_Hz**2), static)
        softest = min(1 / (per_compliance * SOFTEST_Hz**2), 10 * static)
    return [
        transmission.Backlash(joint.name, j, is_at_output, backlash_rad, high_rad, joint.is_slide),
        transmission.JointCompliance(joint.name, j, is_at_output, compliance, softest, joint.is_slide),
    ]


def _couplings(robot: Robot, j: int, scales: Mapping[str, JointScales], spread_rad: float) -> list[Effect]:
    found: list[Effect] = []
    for k in (j - 1, j + 1):
        if not 0 <= k < len(robot.joints) or robot.joints[k].name not in scales:
            continue
        if robot.joints[k].is_slide != robot.joints[j].is_slide:  # a share of the motion has no unit
            continue
        neighbour = robot.joints[k].name
        range_rad = scales[neighbour].high_rad - scales[neighbour].low_rad
        typical = SEEN_SHARE * spread_rad / range_rad if spread_rad > 0 and range_rad > 0 else SERVO_COUPLING
        found.append(
            transmission.JointCoupling(robot.joints[j].name, j, neighbour, k, min(typical, SERVO_COUPLING))
        )
    return found


def _periodic(joint: RobotJoint, scales: JointScales, spread_rad: float) -> list[Effect]:
    """List the orders of an eccentric or tilted encoder, of the motor, and all orders that are smooth.

    A single order is listed if the joint turns through half a period of it. Less of a wave looks like a
    compliance or a scale, and its amplitude can be anything.
    """
    range_rad = scales.high_rad - scales.low_rad
    orders = dict.fromkeys((1, 2, max(1, round(joint.gear_ratio))))
    typical_rad = SEEN_SHARE * spread_rad
    single = [
        transmission.PeriodicError(joint.name, k, typical_rad) for k in orders if k * range_rad >= np.pi
    ]
    return [*single, transmission.SmoothPeriodicError(joint.name, typical_rad)]
