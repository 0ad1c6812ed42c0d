"""Effects at one joint, and the numbers of the logs from which they take their bounds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, Size
from simgap.logs import Motion, Signal
from simgap.robot import Robot, RobotJoint

QUANTILE: Final = 0.995
"""Quantile that stands for the maximum of a noisy quantity."""
BASE_PRIOR: Final = 10.0
"""Width of the prior of a base effect in typical sizes; where the nominal value is larger, that is the width.
Data that show a typical size outweigh it a hundredfold; data that show nothing leave the nominal value."""
SPAN: Final = 5
"""Samples over which a difference gives a speed: fewer show the steps of the encoder."""


@dataclass(frozen=True, slots=True)
class JointScales:
    """Nominal numbers of one joint, and its ranges over all motions that are fitted."""

    damping_Nms_rad: float
    """Of the model, as are friction and armature."""
    frictionloss_Nm: float
    armature_kgm2: float
    low_rad: float
    high_rad: float
    speed_rad_s: float
    acceleration_rad_s2: float
    command_low: float
    """In the unit of the control mode; NaN without a command."""
    command_high: float
    torque_Nm: float
    """Torque limit. Where it is unlimited: the largest of logged torque and that of gravity and inertia."""
    hottest_degC: float
    """NaN where the temperature is not logged."""
    coldest_degC: float


@dataclass(frozen=True, slots=True)
class JointEffect(Effect):
    """An effect at a joint."""

    place: str
    index: int
    """Index of the joint in the robot."""
    joint: RobotJoint
    scales: JointScales
    is_base: bool = False
    """True for a nuisance, which is always fitted and never named."""

    @classmethod
    def at(cls, robot: Robot, place: str, scales: Mapping[str, JointScales]) -> Self:
        """Return the effect at a joint.

        Args:
            place: Name of the joint.
            scales: Numbers of all joints, as `joint_scales` returns them.
        """
        index = [joint.name for joint in robot.joints].index(place)
        return cls(place, index, robot.joints[index], scales[place])

    def with_prior(self, size: Size) -> Size:
        """Return a size with its prior around the nominal value, if this is a base effect."""
        if not self.is_base:
            return size
        return replace(size, prior_std=max(BASE_PRIOR * size.typical, -size.low))


def joint_scales(robot: Robot, motions: Sequence[Motion]) -> dict[str, JointScales]:
    """Collect ranges of all joints over motions.

    Args:
        motions: Motions that are fitted; joints without a log in any of them are left out.

    Returns:
        The numbers by the name of the joint.
    """
    found = {}
    for j, joint in enumerate(robot.joints):
        logs = [motion.joints[joint.name] for motion in motions if joint.name in motion.joints]
        if not logs:
            continue
        q = np.concatenate([log.position.value for log in logs])
        torques = [log.torque.value for log in logs if log.torque is not None]
        commands = [log.command for log in logs if log.command is not None]
        heats = [log.temperature.value for log in logs if log.temperature is not None]
        command = np.concatenate([one.value for one in commands]) if commands else np.array([np.nan])
        heat = np.concatenate(heats) if heats else np.array([np.nan])
        speeds = [_slope(log.position) for log in logs]
        speed = _high([one.value for one in speeds])
        acceleration = _high([_slope(one).value for one in speeds])
        found[joint.name] = JointScales(
            damping_Nms_rad=float(robot.model.dof_damping[joint.dof_index]),
            frictionloss_Nm=float(robot.model.dof_frictionloss[joint.dof_index]),
            armature_kgm2=float(robot.model.dof_armature[joint.dof_index]),
            low_rad=float(q.min()),
            high_rad=float(q.max()),
            speed_rad_s=speed,
            acceleration_rad_s2=acceleration,
            command_low=float(command.min()),
            command_high=float(command.max()),
            torque_Nm=_torque_Nm(robot, j, q, acceleration, torques),
            hottest_degC=float(heat.max()),
            coldest_degC=float(heat.min()),
        )
    return found


def _slope(signal: Signal) -> Signal:
    """Differentiate a signal over a few samples."""
    time_s, value = signal.time_s, signal.value
    if time_s.size <= SPAN:
        return Signal(time_s[:1], np.zeros(1))
    return Signal(
        (time_s[SPAN:] + time_s[:-SPAN]) / 2,
        (value[SPAN:] - value[:-SPAN]) / (time_s[SPAN:] - time_s[:-SPAN]),
    )


def _high(values: Sequence[Array]) -> float:
    """Return the largest usual magnitude; not 0, so that it can be a divisor."""
    return max(float(np.quantile(np.abs(np.concatenate(values)), QUANTILE)), 1e-6)


def _torque_Nm(robot: Robot, j: int, q: Array, acceleration: float, logged: Sequence[Array]) -> float:
    joint = robot.joints[j]
    if np.isfinite(joint.torque_limit_Nm):
        return joint.torque_limit_Nm
    data = mujoco.MjData(robot.model)
    largest = _high(logged) if logged else 0.0
    for angle in np.linspace(q.min(), q.max(), 9):
        data.qpos[joint.qpos_index] = angle
        mujoco.mj_forward(robot.model, data)
        inertia = np.zeros((robot.model.nv, robot.model.nv))
        mujoco.mj_fullM(robot.model, data, inertia)
        d = joint.dof_index
        largest = max(largest, float(abs(data.qfrc_bias[d]) + inertia[d, d] * acceleration))
    return max(largest, 1e-6)


def mjcf_joint(robot: Robot, place: str) -> str:
    """Return the name that the model has for a joint of the robot; models with added bodies keep it."""
    return str(robot.model.joint(int(robot.model.dof_jntid[robot.joint(place).dof_index])).name)
