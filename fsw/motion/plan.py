"""A plan: the paths of a move, the gap that its set-points allow for, or why it cannot be."""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import Deflection
from fsw.dictionary.joints import Joint
from fsw.estimate.joints import JointEstimate, gap_to_move
from fsw.kinematics.limits import beyond_limits, outside
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array
from fsw.motion.paths import Path, joint_path


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a move cannot be."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Paths to run one after the other, where they end, and what they assume."""

    paths: tuple[Path, ...]
    motor_rad: Array
    """At the end."""
    gap_rad: Array
    """Where the outputs are expected to lie in their backlash at the end."""
    branch: str | None = None
    """The inverse-kinematics branch, where one was chosen."""


def plan_poses(config: Config, joints: JointEstimate, poses: list[Array]) -> Plan | Refusal:
    """Joint moves from output pose (5) to output pose, deflection apart; refused beyond the soft limits."""
    legs: list[Path] = []
    motor, output, gap = joints.motor_rad, joints.motor_rad + joints.gap_rad, joints.gap_rad
    for pose in poses:
        if over_limits(config, pose) > 0:
            return Refusal(worst_limit(config, pose))
        hanging = rest(config.arm, pose, joints.gravity_R_m_s2)
        if not hanging.converged:
            return Refusal("the arm of these parameters is too soft to hang still")
        torque = hanging.torque_Nm
        gap = gap_to_move(config, torque, gap, pose - output)
        start, motor, output = motor, motor_under(config, pose, torque, gap), pose
        legs.append(joint_path(config, start, motor))
    return Plan(tuple(legs), motor, gap)


def motor_under(config: Config, output_rad: Array, torque_Nm: Array, gap_rad: Array) -> Array:
    """Motor angles (5, ...) under output angles: less the wind-up and less the gap."""
    stiffness = config.arm.gear_stiffness_Nm_rad.reshape(5, *(1,) * (output_rad.ndim - 1))
    motor: Array = output_rad - torque_Nm / stiffness - gap_rad
    return motor


def believed_gravity(joints: JointEstimate, deflection: Deflection) -> Array:
    """The gravity that a plan reckons with: none if it is not to compensate deflection."""
    return joints.gravity_R_m_s2 if deflection == "absolute" else np.zeros(3)


def over_limits(config: Config, output_rad: Array) -> Array:
    """By how much the worst joint of (5, ...) is beyond its soft limit; negative is inside."""
    over: Array = beyond_limits(config.arm, output_rad).max(axis=0)
    return over


def worst_limit(config: Config, output_rad: Array) -> str:
    """The sentence about the joint of a pose (5) that is farthest beyond its soft limit."""
    joint = Joint(int(np.argmax(beyond_limits(config.arm, output_rad))))
    return outside(config.arm, joint, output_rad[joint])
