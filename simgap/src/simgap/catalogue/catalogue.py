"""The catalogue: every effect that makes sense at a joint, with bounds from the robot and its logs.

Base effects are nuisances: damping, dry friction, armature and gain of each joint whose numbers the model
does not know for certain. They are always fitted and never named, so they are no candidates there.

Effects that no log can tell apart stay in the catalogue side by side; the sets of a verdict hold them
together. docs/robot-effects.md lists these pairs.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from simgap.catalogue.links import depends_on_angle, link_effects
from simgap.catalogue.transmissions import transmission_effects
from simgap.effects.actuation import (
    BackEmf,
    DampingGain,
    DeadZone,
    GainError,
    LeakyIntegral,
    SupplySag,
    TorqueConstant,
    TorqueLimit,
)
from simgap.effects.command import (
    AccelerationLimit,
    ClampHigh,
    ClampLow,
    CommandDelay,
    VelocityLimit,
)
from simgap.effects.effect import Effect
from simgap.effects.external import ConstantTorque, PeriodicTorque, PositionTorque, Spring
from simgap.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    LoadFriction,
    StribeckFriction,
    TemperatureFriction,
    ViscousFriction,
)
from simgap.effects.inertia import Armature
from simgap.effects.joint import JointEffect, JointScales, joint_scales
from simgap.effects.timing import EncoderScale, JointZero, MeasurementDelay
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

    @property
    def has_command(self) -> bool:
        return any(log.command is not None for log in self.logs)

    @property
    def has_position_loop(self) -> bool:
        return self.has_command and self.joint.mode is ControlMode.POSITION

    @property
    def has_damping_loop(self) -> bool:
        return self.has_command and self.joint.mode in (ControlMode.POSITION, ControlMode.VELOCITY)

    @property
    def has_limit(self) -> bool:
        """Return whether torque constant and gain error differ: they do at a limit of the torque."""
        return self.has_command and math.isfinite(self.joint.torque_limit_Nm)

    @property
    def warms(self) -> bool:
        return bool(self.scales.hottest_degC - self.scales.coldest_degC > WARMING_K)


_Condition = Callable[[_Facts], bool]


def _always(facts: _Facts) -> bool:
    return True


def _command(facts: _Facts) -> bool:
    return facts.has_command


def _position_loop(facts: _Facts) -> bool:
    return facts.has_position_loop


JOINT_EFFECTS: Final[tuple[tuple[type[JointEffect], _Condition], ...]] = (
    (StribeckFriction, _always),
    (LoadFriction, _always),
    (AsymmetricFriction, _always),
    (TemperatureFriction, lambda facts: facts.warms),
    (DampingGain, lambda facts: facts.has_damping_loop),
    (TorqueConstant, lambda facts: facts.has_limit),
    (TorqueLimit, _command),
    (BackEmf, _command),
    (DeadZone, _position_loop),
    (LeakyIntegral, _position_loop),
    (VelocityLimit, _position_loop),
    (AccelerationLimit, _position_loop),
    (ClampLow, _command),
    (ClampHigh, _command),
    (ConstantTorque, _always),
    (Spring, _always),
    (PositionTorque, _always),
    (CommandDelay, _command),
    (MeasurementDelay, _always),
    (EncoderScale, _always),
    (JointZero, lambda facts: facts.zero_is_seen),
)
"""Effects at one joint, and where each makes sense. Velocity and load of any log show friction."""
BASE_EFFECTS: Final[tuple[tuple[type[JointEffect], _Condition], ...]] = (
    (ViscousFriction, _always),
    (CoulombFriction, _always),
    (Armature, _always),
    (GainError, _command),
)
"""Nuisances of a joint that is not known, and candidates at one that is."""


def catalogue(robot: Robot, logs: Logs) -> tuple[Effect, ...]:
    """List the effects that make sense for a robot and its logs.

    Args:
        logs: Logs; bounds and typical sizes come from the motions that are fitted.

    Returns:
        Effects, none of which is a base effect.
    """
    found: list[Effect] = []
    all_facts = _facts(robot, logs.fit)
    for facts in all_facts:
        tables = (JOINT_EFFECTS, BASE_EFFECTS) if facts.joint.is_known else (JOINT_EFFECTS,)
        found += _at(robot, facts, [row for table in tables for row in table])
        if facts.joint.gear_ratio > 1:  # a turn of the motor: the only order that a robot file knows
            scale = {facts.joint.name: facts.scales}
            found.append(PeriodicTorque.of_order(robot, facts.joint.name, scale, facts.joint.gear_ratio))
    scales = {facts.joint.name: facts.scales for facts in all_facts}
    if len(all_facts) == len(robot.joints) and all(facts.has_command for facts in all_facts):
        sag = SupplySag.of(robot, scales, logs.fit)
        found += [sag] if sag.high > 0.0 else []
    found += transmission_effects(robot, logs.fit, scales)
    found += link_effects(robot, logs.fit, scales)
    return tuple(found)


def base_effects(robot: Robot, logs: Logs) -> tuple[Effect, ...]:
    """List the nuisances of all joints that are not known.

    Args:
        logs: Logs, of which the motions that are fitted give bounds and scales.

    Returns:
        Effects, whose sizes have priors. These decide only what the data do not: the armature of a joint
        that never accelerates, or friction at one that never moves.
    """
    unknown = [facts for facts in _facts(robot, logs.fit) if not facts.joint.is_known]
    found = [effect for facts in unknown for effect in _at(robot, facts, BASE_EFFECTS)]
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
