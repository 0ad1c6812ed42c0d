"""Motor angles from the incremental encoders, and the side of each joint's backlash."""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.commands import SetReference
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors

GRAVITY_FILTER_S = 1.0
GRAVITY_GAIN = 1.0 / (GRAVITY_FILTER_S * CYCLE_HZ)
STILL_RAD = 2e-5
"""An output that is to move less than this is left where it lies."""


@dataclass(frozen=True, slots=True, eq=False)
class JointEstimate:
    """What the joints are believed to do; output side, order of Joint."""

    referenced: bool
    """Whether the encoder zero is known; before that the angles mean nothing."""
    zero_rad: Array
    motor_rad: Array
    motor_rate_rad_s: Array
    load_side: Array
    """Sign of a load that exceeds friction and so decides the side of the backlash, else 0."""
    gap_rad: Array
    """Output less motor angle inside the backlash: half the width on a flank, wind-up not counted."""
    gravity_R_m_s2: Array


def unreferenced(n: int) -> JointEstimate:
    """Nothing is known yet."""
    zeros = np.zeros(n)
    return JointEstimate(False, zeros, zeros, zeros, zeros, zeros, np.zeros(3))


def update(config: Config, last: JointEstimate, sensors: Sensors) -> JointEstimate:
    """The estimate with this cycle's encoder counts and gravity reading."""
    motor = sensors.encoder_count * config.rad_per_count + last.zero_rad
    if not last.referenced:
        return replace(last, motor_rad=motor, gravity_R_m_s2=sensors.gravity_R_m_s2)
    motion = motor - last.motor_rad
    return JointEstimate(
        referenced=True,
        zero_rad=last.zero_rad,
        motor_rad=motor,
        motor_rate_rad_s=motion * CYCLE_HZ,
        load_side=last.load_side,
        gap_rad=gap_after(config, last.load_side, last.gap_rad, motion),
        gravity_R_m_s2=last.gravity_R_m_s2 + GRAVITY_GAIN * (sensors.gravity_R_m_s2 - last.gravity_R_m_s2),
    )


def set_reference(config: Config, estimate: JointEstimate, command: SetReference) -> JointEstimate:
    """The estimate with encoder zero and backlash side as told."""
    told = np.array(command.motor_rad)
    return replace(
        estimate,
        referenced=True,
        zero_rad=estimate.zero_rad + told - estimate.motor_rad,
        motor_rad=told,
        motor_rate_rad_s=np.zeros_like(told),
        gap_rad=config.half_gap_rad * np.array(command.gap_side),
    )


def load_side(config: Config, torque_Nm: Array) -> Array:
    """Sign of the torques that exceed the friction of the output, else 0."""
    side: Array = np.sign(torque_Nm) * (np.abs(torque_Nm) > _rows(config.output_friction_Nm, torque_Nm))
    return side


def gap_after(config: Config, load_side: Array, gap_rad: Array, motion_rad: Array) -> Array:
    """Where the output lies in the backlash after the motor moved.

    A load that exceeds friction holds the output on its flank. Otherwise friction holds the output while the
    motor crosses the gap, and then the rear flank drags it along: the play operator.
    """
    half = config.half_gap_rad
    dragged = np.minimum(np.maximum(gap_rad - motion_rad, -half), half)
    gap: Array = np.where(load_side != 0, load_side * half, dragged)
    return gap


def gap_to_move(config: Config, torque_Nm: Array, gap_rad: Array, motion_rad: Array) -> Array:
    """Where the output will lie in the backlash once it has moved this far: what a set-point must allow for.

    Unlike in gap_after, the motion is that of the output: whoever wants it to move at all must cross the gap.
    """
    side, half = load_side(config, torque_Nm), _rows(config.half_gap_rad, torque_Nm)
    moved = np.abs(motion_rad) > STILL_RAD
    unloaded = np.where(moved, -np.sign(motion_rad) * half, gap_rad)
    gap: Array = np.where(side != 0, side * half, unloaded)
    return gap


def _rows(per_joint: Array, like: Array) -> Array:
    """A value per joint (5,) beside joint arrays (5, ...)."""
    return per_joint.reshape(-1, *(1,) * (like.ndim - 1))
