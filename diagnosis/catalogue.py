"""The catalogue: every effect that makes sense at a joint, with bounds from the robot and its logs.

Base effects are nuisances: damping, dry friction, armature and gain of each joint whose numbers the model
does not know for certain. They are always fitted and never named, so they are no candidates there.

Effects that no log can tell apart stay in the catalogue side by side; the sets of a verdict hold them
together. docs/robot-effects.md lists these pairs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.arrays import Array
from diagnosis.effects.actuation import GainError
from diagnosis.effects.command import CommandDelay
from diagnosis.effects.effect import Effect
from diagnosis.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    LoadFriction,
    StribeckFriction,
    TemperatureFriction,
    ViscousFriction,
)
from diagnosis.effects.inertia import Armature
from diagnosis.effects.joint import JointEffect, JointScales, joint_scales
from diagnosis.effects.timing import EncoderScale, JointZero, MeasurementDelay
from diagnosis.links import link_effects
from diagnosis.logs import JointLog, Logs, Motion
from diagnosis.robot import ControlMode, Robot, RobotJoint
from diagnosis.transmissions import transmission_effects

WARMING_K: Final = 5.0
"""Least range of temperature with which friction can be seen to vary: servos show whole kelvins."""
BASE_PRIOR: Final = 10.0
"""Width of the prior of a base effect in typical sizes. Data that show a typical size outweigh it a
hundredfold; data that show nothing leave the nominal value."""


@dataclass(frozen=True, slots=True)
class _Facts:
    """All that decides which effects a joint may have."""

    joint: RobotJoint
    scales: JointScales
    logs: tuple[JointLog, ...]

    @property
    def has_command(self) -> bool:
        return any(log.command is not None for log in self.logs)

    @property
    def has_loop(self) -> bool:
        return self.has_command and self.joint.mode in (ControlMode.POSITION, ControlMode.VELOCITY)

    @property
    def warms(self) -> bool:
        return bool(self.scales.hottest_degC - self.scales.coldest_degC > WARMING_K)


_Condition = Callable[[_Facts], bool]


def _always(facts: _Facts) -> bool:
    return True


JOINT_EFFECTS: Final[tuple[tuple[type[JointEffect], _Condition], ...]] = (
    (StribeckFriction, _always),
    (LoadFriction, _always),
    (AsymmetricFriction, _always),
    (TemperatureFriction, lambda facts: facts.warms),
    (CommandDelay, lambda facts: facts.has_command),
    (MeasurementDelay, _always),
    (EncoderScale, _always),
    (JointZero, _always),
)
"""Effects at one joint, and where each makes sense. Velocity and load of any log show friction."""
BASE_EFFECTS: Final[tuple[tuple[type[JointEffect], _Condition], ...]] = (
    (ViscousFriction, _always),
    (CoulombFriction, _always),
    (Armature, _always),
    (GainError, lambda facts: facts.has_loop),
)
"""Nuisances of a joint that is not known, and candidates at one that is."""


def catalogue(robot: Robot, logs: Logs) -> tuple[Effect, ...]:
    """List the effects that make sense for a robot and its logs.

    Args:
        robot: Robot.
        logs: Logs; bounds and typical sizes come from the motions that are fitted.

    Returns:
        Effects, none of which is a base effect.
    """
    found: list[Effect] = []
    all_facts = _facts(robot, logs.fit)
    for facts in all_facts:
        tables = (JOINT_EFFECTS, BASE_EFFECTS) if facts.joint.is_known else (JOINT_EFFECTS,)
        found += _at(robot, facts, [row for table in tables for row in table])
    scales = {facts.joint.name: facts.scales for facts in all_facts}
    found += transmission_effects(robot, logs.fit, scales)
    found += link_effects(robot, logs.fit, scales)
    return tuple(found)


def base_effects(robot: Robot, logs: Logs) -> tuple[Effect, ...]:
    """List the nuisances of all joints that are not known.

    Args:
        robot: Robot.
        logs: Logs, of which the motions that are fitted give bounds and scales.

    Returns:
        Effects; `base_prior_std` has their priors.
    """
    unknown = [facts for facts in _facts(robot, logs.fit) if not facts.joint.is_known]
    return tuple(effect for facts in unknown for effect in _at(robot, facts, BASE_EFFECTS))


def base_prior_std(effects: Sequence[Effect]) -> Array:
    """Return the widths of the normal priors of base effects around their nominal values, which are size 0.

    A fit adds the residuals size / width. They decide only what the data do not: the armature of a joint that
    never accelerates, or friction at one that never moves.

    Args:
        effects: Base effects.

    Returns:
        Widths of all sizes one after the other, (n_sizes,), in the units of the sizes.
    """
    sizes = [size for effect in effects for size in effect.sizes]
    return np.array([min(size.prior_std, BASE_PRIOR * size.typical) for size in sizes])


def _facts(robot: Robot, motions: Sequence[Motion]) -> list[_Facts]:
    scales = joint_scales(robot, motions)
    return [
        _Facts(
            joint,
            scales[joint.name],
            tuple(motion.joints[joint.name] for motion in motions if joint.name in motion.joints),
        )
        for joint in robot.joints
        if joint.name in scales
    ]


def _at(
    robot: Robot, facts: _Facts, table: Sequence[tuple[type[JointEffect], _Condition]]
) -> list[JointEffect]:
    name = facts.joint.name
    return [kind.at(robot, name, {name: facts.scales}) for kind, makes_sense in table if makes_sense(facts)]
