"""The load on the joints and the deflected tool pose, at a lower rate than the cycle."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.channels import ToolChannels
from fsw.dictionary.enums import Joint, Tool
from fsw.estimate.gear import (
    LIKELY,
    GearBounds,
    bound_gear,
    bound_loads,
    gear_after_motor_turn,
    locate_in_backlash,
)
from fsw.estimate.hardstop import HardstopFit
from fsw.estimate.reference import Reference, provisional_reference, record_calibration
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import ToolForce, compute_load, settle_output
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

    initialised: bool
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
    def backlash_state(self) -> Array:
        """How the outputs lie in their gaps, (3, 5): place, side, uncertainty of the gear angle."""
        return locate_in_backlash(self.reference.half_gap_rad, self.gear_rad)

    @property
    def gap_rad(self) -> Array:
        """Likely place of the output in its gap, wind-up not counted."""
        gap: Array = self.backlash_state[0]
        return gap

    @property
    def side(self) -> Array:
        """Side of the gap where it is known, else 0."""
        side: Array = self.backlash_state[1]
        return side

    @property
    def uncertainty_rad(self) -> Array:
        """How far the gear angle may be from its likely value; an error of its stiffness comes on top."""
        uncertainty: Array = self.backlash_state[2]
        return uncertainty


def uninitialised_estimate(config: Config, reference: Reference) -> JointEstimate:
    """Nothing has been read yet; every output may be anywhere in its gear until a load is known."""
    zeros = np.zeros_like(config.half_gap_rad)
    anywhere = np.outer(np.ones_like(zeros), [-ANYWHERE_RAD, 0.0, ANYWHERE_RAD])
    return JointEstimate(
        initialised=False,
        reference=reference,
        motor_rad=zeros,
        motor_rate_rad_s=zeros,
        gear_rad=anywhere,
        bounds=GearBounds(np.full_like(anywhere, -ANYWHERE_RAD), np.full_like(anywhere, ANYWHERE_RAD)),
        resolver_error_rad=zeros,
        imu_R_m_s2=np.zeros(3),
    )


def update_joints(config: Config, last: JointEstimate, sensors: Sensors) -> JointEstimate:
    """The estimate with this cycle's readings."""
    if not last.initialised:
        return _initialise(config, last, sensors)
    motor = sensors.encoder_count * config.rad_per_count + last.reference.zero_rad
    motion = motor - last.motor_rad
    gear = gear_after_motor_turn(last.gear_rad, motion, last.bounds)
    error = sensors.resolver_rad - motor - gear[:, LIKELY] - last.reference.resolver_bias_rad
    return JointEstimate(
        initialised=True,
        reference=last.reference,
        motor_rad=motor,
        motor_rate_rad_s=motion * PER_S,
        gear_rad=gear,
        bounds=last.bounds,
        resolver_error_rad=last.resolver_error_rad + RESOLVER_GAIN * (error - last.resolver_error_rad),
        imu_R_m_s2=last.imu_R_m_s2 + GRAVITY_GAIN * (sensors.gravity_R_m_s2 - last.imu_R_m_s2),
        down_R=last.down_R,
    )


def apply_calibration(
    config: Config, joints: JointEstimate, load_Nm: Array, joint: Joint, found: HardstopFit
) -> JointEstimate:
    """The estimate with a joint's zero such that its output met the hardstop where the drawing has it.

    The joint has just been dragged off its stop, to positive angles.
    """
    this = np.arange(load_Nm.size) == joint
    shift = config.params.joints.in_order()[joint].hardstop_rad - found.stop_rad
    read = joints.output_rad + joints.reference.resolver_bias_rad + joints.resolver_error_rad
    half = np.where(this, found.half_gap_rad, joints.reference.half_gap_rad)
    bounds = bound_gear(config, half, bound_loads(config, load_Nm, joints.gravity_R_m_s2))
    gear = np.where(this[:, None], bounds.lowest_rad, joints.gear_rad)
    motor = joints.motor_rad + np.where(this, shift, 0.0)
    bias = read - motor - gear[:, LIKELY]
    return replace(
        joints,
        reference=record_calibration(
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


def _initialise(config: Config, last: JointEstimate, sensors: Sensors) -> JointEstimate:
    reference = provisional_reference(config, last.reference, sensors)
    motor = sensors.encoder_count * config.rad_per_count + reference.zero_rad
    return replace(
        last,
        initialised=True,
        reference=reference,
        motor_rad=motor,
        imu_R_m_s2=sensors.gravity_R_m_s2,
    )


def apply_load(
    config: Config, joints: JointEstimate, load_Nm: Array, more_Nm: Array | None = None
) -> JointEstimate:
    """The estimate under newly modelled loads, and so much (5) more uncertain ones."""
    loads = bound_loads(config, load_Nm, joints.gravity_R_m_s2, more_Nm)
    bounds = bound_gear(config, joints.reference.half_gap_rad, loads)
    gear = gear_after_motor_turn(joints.gear_rad, np.zeros_like(load_Nm), bounds)
    return replace(joints, bounds=bounds, gear_rad=gear)


@dataclass(frozen=True, slots=True, eq=False)
class LoadEstimate:
    """Spring strains (6, 6), links second, and joint torques (5)."""

    known: bool
    """Whether there was a look at the load; the first one converges, later ones only follow."""
    strain: Array
    torque_Nm: Array
    press_torque_Nm: Array
    """The part of it that a press causes."""


def no_load(n: int) -> LoadEstimate:
    """No load known yet."""
    return LoadEstimate(False, np.zeros((6, n + 1)), np.zeros(n), np.zeros(n))


def update_load(
    config: Config,
    tick: int,
    tool: Tool,
    joints: JointEstimate,
    last: LoadEstimate,
    push: ToolForce | None = None,
) -> tuple[LoadEstimate, JointEstimate, ToolChannels]:
    """One pass of the statics at the present outputs: load, bounds of the gears, and the tool channels."""
    arm, output = config.arm, joints.output_rad
    strain = last.strain if last.known else settle_output(arm, output, joints.gravity_R_m_s2).strain
    frames = forward(arm, output, strain)
    strain, torque = compute_load(arm, frames, joints.gravity_R_m_s2, push)
    of_push, unsure = np.zeros_like(torque), None
    if push is not None:
        of_push = torque - compute_load(arm, frames, joints.gravity_R_m_s2)[1]
        unsure = _force_uncertainty(config, of_push, push)
    X_RT = tool_pose(arm, frames, tool)
    channels = ToolChannels(tick, tool, X_RT.p, X_RT.R, output, torque)
    return LoadEstimate(True, strain, torque, of_push), apply_load(config, joints, torque, unsure), channels


def _force_uncertainty(config: Config, of_push_Nm: Array, push: ToolForce) -> Array:
    """By how much the loads (5) of a press may be off: no sensor feels the force."""
    force_N, preload = float(np.linalg.norm(push.force_R_N)), config.params.preload
    unsure: Array = np.abs(of_push_Nm) * (
        max(preload.error_share * force_N, preload.error_N) / max(force_N, 1e-9)
    )
    return unsure
