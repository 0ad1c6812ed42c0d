"""Configuration of flight software: the parameters, and what is computed from them once."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fsw.collision.geometry import CollisionGeometry, build_collision_geometry
from fsw.dictionary.params import Params, digest
from fsw.kinematics.arm import Arm, build_arm, heat_arm
from fsw.kinematics.transforms import Array
from fsw.protect.inputs import ProtectionBounds, compute_bounds
from fsw.protect.readings import ReadingBounds, compute_reading_bounds

CYCLE_HZ = 64
CYCLE_S = 1.0 / CYCLE_HZ


@dataclass(frozen=True, eq=False)
class Config:
    """Values that are constant during a move; joint arrays (5,) in the order of Joint."""

    params: Params
    structure_C: float
    """Temperature of the structure for which `arm` is built."""
    arm: Arm
    calibrated_arm: Arm
    """Arm at the calibration temperature."""
    farthest_tool: str
    """Tool at the greatest distance from the turret axis."""
    protection: ProtectionBounds
    readings: ReadingBounds
    rad_per_count: Array
    """Angle on the output side for one encoder count."""
    half_backlash_rad: Array
    """Half the backlash by the parameters; a calibrated joint has a measured value in its Reference."""
    hardstop_rad: Array
    output_friction_Nm: Array
    load_error_Nm: Array
    torque_constant_Nm_A: Array
    speed_rad_s: Array
    acceleration_rad_s2: Array
    jerk_rad_s3: Array
    current_limit_A: Array
    brake_ticks: int
    settle_ticks: int
    settle_timeout_ticks: int

    @cached_property
    def collision_geometry(self) -> CollisionGeometry:
        """Build the shapes of the arm, the rover and the ground; few configurations are asked for them."""
        return build_collision_geometry(self.params, self.arm)

    @cached_property
    def params_sha256(self) -> str:
        """Compute the SHA-256 of the parameter values; few configurations are asked for it."""
        return digest(self.params)

    def prepare(self) -> None:
        """Compute what is otherwise computed when it is first asked for, so that no first cycle has to."""
        _ = self.collision_geometry, self.params_sha256


def configure(params: Params) -> Config:
    """Build the configuration from parameters, with the arm at its calibration temperature."""
    joints, motion, arm = params.joints.in_order(), params.motion, build_arm(params)
    return Config(
        params=params,
        structure_C=params.heat.calibration_C,
        arm=arm,
        calibrated_arm=arm,
        farthest_tool=max(arm.X_FT, key=lambda name: float(np.hypot(*arm.X_FT[name].p[:2]))),
        protection=compute_bounds(params, arm, CYCLE_S),
        readings=compute_reading_bounds(params, CYCLE_S),
        rad_per_count=np.array([2 * np.pi / (j.encoder_counts_per_turn * j.gear_ratio) for j in joints]),
        half_backlash_rad=np.array([0.5 * j.backlash_rad for j in joints]),
        hardstop_rad=np.array([j.hardstop_rad for j in joints]),
        output_friction_Nm=np.array([j.output_friction_Nm for j in joints]),
        load_error_Nm=np.array([j.load_error_Nm for j in joints]),
        torque_constant_Nm_A=np.array([j.torque_constant_Nm_A for j in joints]),
        speed_rad_s=np.array([j.speed_rad_s for j in joints]),
        acceleration_rad_s2=np.array([j.acceleration_rad_s2 for j in joints]),
        jerk_rad_s3=np.array([j.jerk_rad_s3 for j in joints]),
        current_limit_A=np.array([j.current_limit_A for j in joints]),
        brake_ticks=ticks(motion.brake_delay_s),
        settle_ticks=ticks(motion.settle_time_s),
        settle_timeout_ticks=ticks(motion.settle_timeout_s),
    )


def configure_at(config: Config, structure_C: float) -> Config:
    """Build the configuration with the arm that has grown to this temperature of its structure.

    Everything that flight software computes from the arm uses it: solutions, estimates, collisions, monitors.
    """
    heat = config.params.heat
    arm = heat_arm(config.calibrated_arm, heat.compensated_share * (structure_C - heat.calibration_C))
    return replace(config, structure_C=structure_C, arm=arm, protection=replace(config.protection, arm=arm))


def ticks(duration_s: float) -> int:
    """Compute the least number of cycles that last at least this long."""
    return int(np.ceil(duration_s * CYCLE_HZ))
