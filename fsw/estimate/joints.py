"""What the joints are believed to do, from the incremental encoders and the load."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.joints import Joint
from fsw.estimate.gear import (
    LIKELY,
    GearBounds,
    bounds_under,
    gear_after,
    lie_of,
    uncertain_loads,
)
from fsw.estimate.hardstop import Found
from fsw.estimate.reference import Reference, provisional, remembered
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors

GRAVITY_FILTER_S: Final = 1.0
GRAVITY_GAIN: Final = np.array(1.0 / (GRAVITY_FILTER_S * CYCLE_HZ))
ANYWHERE_RAD: Final = 1.0
RESOLVER_FILTER_S: Final = 0.25
RESOLVER_GAIN: Final = np.array(1.0 / (RESOLVER_FILTER_S * CYCLE_HZ))
PER_S: Final = np.array(float(CYCLE_HZ))


@dataclass(frozen=True, slots=True, eq=False)
class JointEstimate:
    """Output side, order of Joint."""

    awake: bool
    """Whether anything has been read yet."""
    reference: Reference
    motor_rad: Array
    """Of a joint that is not calibrated, what its resolver said at first and the motion since."""
    motor_rate_rad_s: Array
    gear_rad: Array
    """Output less motor angle, backlash and wind-up: at least, likely, at most; (5, 3)."""
    bounds: GearBounds
    resolver_error_rad: Array
    """Resolver less believed output and learned bias, smoothed."""
    imu_R_m_s2: Array
    """Gravity as the IMU reads it, smoothed."""
    down_R: Array | None = None
    """The direction of gravity as the ground set it."""

    @property
    def gravity_R_m_s2(self) -> Array:
        """Gravity, in the direction that the ground set or the IMU reads."""
        if self.down_R is None:
            return self.imu_R_m_s2
        gravity: Array = self.down_R * np.linalg.norm(self.imu_R_m_s2)
        return gravity

    @property
    def output_rad(self) -> Array:
        """The likely output angles."""
        output: Array = self.motor_rad + self.gear_rad[:, LIKELY]
        return output

    @property
    def lie(self) -> Array:
        """How the outputs lie in their gaps, (3, 5): place, side, uncertainty of the gear angle."""
        return lie_of(self.reference.half_gap_rad, self.gear_rad)

    @property
    def gap_rad(self) -> Array:
        """Likely place of the output in its gap, wind-up not counted."""
        gap: Array = self.lie[0]
        return gap

    @property
    def side(self) -> Array:
        """Side of the gap where it is known, else 0."""
        side: Array = self.lie[1]
        return side

    @property
    def uncertainty_rad(self) -> Array:
        """How far the gear angle may be from its likely value; an error of its stiffness comes on top."""
        uncertainty: Array = self.lie[2]
        return uncertainty


def asleep(config: Config, reference: Reference) -> JointEstimate:
    """Nothing has been read yet; every output may be anywhere in its gear until a load is known."""
    zeros = np.zeros_like(config.half_gap_rad)
    anywhere = np.outer(np.ones_like(zeros), [-ANYWHERE_RAD, 0.0, ANYWHERE_RAD])
    return JointEstimate(
        awake=False,
        reference=reference,
        motor_rad=zeros,
        motor_rate_rad_s=zeros,
        gear_rad=anywhere,
        bounds=GearBounds(np.full_like(anywhere, -ANYWHERE_RAD), np.full_like(anywhere, ANYWHERE_RAD)),
        resolver_error_rad=zeros,
        imu_R_m_s2=np.zeros(3),
    )


def update(config: Config, last: JointEstimate, sensors: Sensors) -> JointEstimate:
    """The estimate with this cycle's readings."""
    if not last.awake:
        return _first(config, last, sensors)
    motor = sensors.encoder_count * config.rad_per_count + last.reference.zero_rad
    motion = motor - last.motor_rad
    gear = gear_after(last.gear_rad, motion, last.bounds)
    error = sensors.resolver_rad - motor - gear[:, LIKELY] - last.reference.resolver_bias_rad
    return JointEstimate(
        awake=True,
        reference=last.reference,
        motor_rad=motor,
        motor_rate_rad_s=motion * PER_S,
        gear_rad=gear,
        bounds=last.bounds,
        resolver_error_rad=last.resolver_error_rad + RESOLVER_GAIN * (error - last.resolver_error_rad),
        imu_R_m_s2=last.imu_R_m_s2 + GRAVITY_GAIN * (sensors.gravity_R_m_s2 - last.imu_R_m_s2),
        down_R=last.down_R,
    )


def calibrated(
    config: Config, joints: JointEstimate, load_Nm: Array, joint: Joint, found: Found
) -> JointEstimate:
    """The estimate with a joint's zero such that its output met the hardstop where the drawing has it.

    The joint has just been dragged off its stop, to positive angles.
    """
    this = np.arange(load_Nm.size) == joint
    shift = config.params.joints.in_order()[joint].hardstop_rad - found.stop_rad
    read = joints.output_rad + joints.reference.resolver_bias_rad + joints.resolver_error_rad
    half = np.where(this, found.half_gap_rad, joints.reference.half_gap_rad)
    bounds = bounds_under(config, half, uncertain_loads(config, load_Nm, joints.gravity_R_m_s2))
    gear = np.where(this[:, None], bounds.lowest_rad, joints.gear_rad)
    motor = joints.motor_rad + np.where(this, shift, 0.0)
    bias = read - motor - gear[:, LIKELY]
    return replace(
        joints,
        reference=remembered(
            joints.reference,
            joint,
            zero_rad=float(joints.reference.zero_rad[joint] + shift),
            half_gap_rad=found.half_gap_rad,
            resolver_bias_rad=float(bias[joint]),
            friction_Nm=found.running_Nm - float(load_Nm[joint]),
        ),
        motor_rad=motor,
        gear_rad=gear,
        bounds=bounds,
        resolver_error_rad=np.where(this, 0.0, joints.resolver_error_rad),
    )


def _first(config: Config, asleep: JointEstimate, sensors: Sensors) -> JointEstimate:
    reference = provisional(config, asleep.reference, sensors)
    motor = sensors.encoder_count * config.rad_per_count + reference.zero_rad
    return replace(
        asleep, awake=True, reference=reference, motor_rad=motor, imu_R_m_s2=sensors.gravity_R_m_s2
    )


def loaded(
    config: Config, joints: JointEstimate, load_Nm: Array, more_Nm: Array | None = None
) -> JointEstimate:
    """The estimate under newly modelled loads, and so much (5) more uncertain ones."""
    loads = uncertain_loads(config, load_Nm, joints.gravity_R_m_s2, more_Nm)
    bounds = bounds_under(config, joints.reference.half_gap_rad, loads)
    gear = gear_after(joints.gear_rad, np.zeros_like(load_Nm), bounds)
    return replace(joints, bounds=bounds, gear_rad=gear)
