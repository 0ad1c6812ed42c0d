"""Estimate of the joints from encoders and resolvers, and of the load and the deflected tool pose.

The joints are estimated every cycle, the load at a lower rate.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import cycle_record
from fsw.estimate.gear import (
    LIKELY,
    GearBounds,
    bound_gear,
    bound_loads,
    gear_after_motor_turn,
    include_gear,
    locate_in_backlash,
)
from fsw.estimate.reference import HardstopFit, Reference
from fsw.estimate.resolver_baseline import (
    RESOLVER_GAIN,
    ResolverBaseline,
    bound_drift,
    error_on_brakes,
    narrow_gear,
    new_baseline,
)
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import ToolForce, load_arm, push_torque, settle_output
from fsw.kinematics.transforms import Array, Flags
from fsw.messages import Sensors, ToolChannels

GRAVITY_FILTER_S: Final = 1.0
"""Time constant of the smoothing of gravity."""
GRAVITY_GAIN: Final = np.array(1.0 / (GRAVITY_FILTER_S * CYCLE_HZ))
ANYWHERE_RAD: Final = 1.0
"""Bound of the gear angles before a load is known."""
PER_S: Final = np.array(float(CYCLE_HZ))
"""Cycles per second."""


@cycle_record
class JointEstimate:
    """Estimate of the joints on the output side, in the order of Joint."""

    initialised: bool
    """True once sensors have been read."""
    reference: Reference
    """Encoder zeros and resolver biases."""
    motor_rad: Array
    """Motor angles, (5,); for an uncalibrated joint, its first resolver reading plus the motion since."""
    motor_rate_rad_s: Array
    """Motor rates, (5,)."""
    gear_rad: Array
    """Output less motor angle, backlash and wind-up: lowest, likely and highest, (5, 3)."""
    bounds: GearBounds
    """Bounds of the gear angles under the present load, (5, 3)."""
    resolver_error_rad: Array
    """Resolver less estimated output and learned bias, smoothed, (5,)."""
    imu_R_m_s2: Array
    """Gravity as the IMU reads it, smoothed, (3,)."""
    baseline: ResolverBaseline
    """What the resolvers read where sides of the backlash were last known."""
    down_R: Array | None = None
    """Direction of gravity that the ground has set, (3,); None if it has not."""

    @property
    def gravity_R_m_s2(self) -> Array:
        """Gravity, in the direction that the ground has set, else that of the IMU, (3,)."""
        if self.down_R is None:
            return self.imu_R_m_s2
        gravity: Array = self.down_R * np.linalg.norm(self.imu_R_m_s2)
        return gravity

    @property
    def output_rad(self) -> Array:
        """Likely output angles, (5,)."""
        output: Array = self.motor_rad + self.gear_rad[:, LIKELY]
        return output

    @property
    def backlash_state(self) -> Array:
        """Position, side, and uncertainty of the gear angle inside the backlash, (3, 5)."""
        return locate_in_backlash(self.reference.half_backlash_rad, self.gear_rad)

    @property
    def side(self) -> Array:
        """Side of the backlash, +1 or -1 if it is certain, else 0, (5,)."""
        side: Array = self.backlash_state[1]
        return side

    @property
    def uncertainty_rad(self) -> Array:
        """Largest error of the likely gear angle, (5,); an error of the gear stiffness adds to it."""
        uncertainty: Array = self.backlash_state[2]
        return uncertainty


def uninitialised_estimate(config: Config, reference: Reference) -> JointEstimate:
    """Build the estimate before the first reading; gear angles are unknown until a load is known."""
    zeros = np.zeros_like(config.half_backlash_rad)
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
        baseline=new_baseline(config),
    )


def update_joints(config: Config, last: JointEstimate, sensors: Sensors) -> JointEstimate:
    """Update the estimate with the readings of this cycle."""
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
        baseline=last.baseline,
        down_R=last.down_R,
    )


def begin_joints(config: Config, last: JointEstimate) -> JointEstimate:
    """Begin the estimate anew: nothing is known but the reference, and gravity that the ground has set."""
    return replace(uninitialised_estimate(config, last.reference), down_R=last.down_R)


def _initialise(config: Config, last: JointEstimate, sensors: Sensors) -> JointEstimate:
    """Initialise the motor angles from the first readings."""
    # the resolvers give the encoder zeros of joints that were never calibrated
    known, turned = last.reference, sensors.encoder_count * config.rad_per_count
    zero = np.where(known.known, known.zero_rad, sensors.resolver_rad - turned)
    reference, motor = replace(known, zero_rad=zero), turned + zero
    return replace(
        last, initialised=True, reference=reference, motor_rad=motor, imu_R_m_s2=sensors.gravity_R_m_s2
    )


def apply_calibration(
    config: Config, joints: JointEstimate, load_Nm: Array, joint: Joint, found: HardstopFit
) -> JointEstimate:
    """Set the encoder zero of a joint so that its output met the hardstop at the nominal angle.

    The gear must just have dragged the joint off its hardstop, to positive angles.
    """
    this = np.arange(load_Nm.size) == joint
    shift = config.params.joints.in_order()[joint].hardstop_rad - found.stop_rad
    read = joints.output_rad + joints.reference.resolver_bias_rad + joints.resolver_error_rad
    half = np.where(this, found.half_backlash_rad, joints.reference.half_backlash_rad)
    bounds = bound_gear(config, half, bound_loads(config, load_Nm, joints.gravity_R_m_s2))
    gear = np.where(this[:, None], bounds.lowest_rad, joints.gear_rad)
    motor = joints.motor_rad + np.where(this, shift, 0.0)
    last, baseline = joints.reference, joints.baseline
    return replace(
        joints,
        reference=Reference(
            calibrated=last.calibrated | this,
            known=last.known | this,
            zero_rad=np.where(this, last.zero_rad + shift, last.zero_rad),
            half_backlash_rad=half,
            resolver_bias_rad=np.where(this, read - motor - gear[:, LIKELY], last.resolver_bias_rad),
            friction_Nm=np.where(this, found.running_Nm - load_Nm, last.friction_Nm),
        ),
        motor_rad=motor,
        gear_rad=gear,
        bounds=bounds,
        resolver_error_rad=np.where(this, 0.0, joints.resolver_error_rad),
        baseline=replace(
            baseline,
            known_rad=np.where(this, 0.0, baseline.known_rad),
            known_output_rad=np.where(this, motor + gear[:, LIKELY], baseline.known_output_rad),
            braked_rad=np.where(this, 0.0, baseline.braked_rad),
        ),
    )


def apply_load(
    config: Config, joints: JointEstimate, load_Nm: Array, more_Nm: Array | None = None
) -> JointEstimate:
    """Update the gear angles under newly modelled loads."""
    loads = bound_loads(config, load_Nm, joints.gravity_R_m_s2, more_Nm)
    bounds = bound_gear(config, joints.reference.half_backlash_rad, loads)
    held = _held_where_located(config, joints)
    if held.any():
        bounds = include_gear(bounds, joints.gear_rad, held)
    gear = gear_after_motor_turn(joints.gear_rad, np.zeros_like(load_Nm), bounds)
    return replace(joints, bounds=bounds, gear_rad=gear)


def _held_where_located(config: Config, joints: JointEstimate) -> Flags:
    """Return which outputs are where their resolvers have located them, (5,).

    They stay while the motor rests on its brake and the resolver reads the same: loads that would move them
    are not those of the arm.
    """
    baseline = joints.baseline
    held: Flags = joints.motor_rad == baseline.located_motor_rad
    if held.any():
        change_rad = np.abs(joints.resolver_error_rad - baseline.known_rad)
        held = held & (change_rad <= bound_drift(config, baseline, joints.output_rad))
    return held


def note_braked(joints: JointEstimate) -> JointEstimate:
    """Note the resolver errors of the cycle in which a move puts the brakes on, its motors at rest."""
    return replace(joints, baseline=replace(joints.baseline, braked_rad=joints.resolver_error_rad))


def locate_at_rest(config: Config, joints: JointEstimate) -> JointEstimate:
    """Locate undecided outputs by their resolvers where a move ends; where sides are known, note the errors.

    An output is where its resolver reads it, as far as load and friction allow, and its uncertainty becomes
    what the resolver may err.
    """
    baseline, side = joints.baseline, joints.side
    error = error_on_brakes(config, baseline, joints.resolver_error_rad)
    bound = bound_drift(config, baseline, joints.output_rad)
    located = (side == 0) & joints.reference.calibrated & (joints.uncertainty_rad > bound)
    gear = narrow_gear(joints.gear_rad, located, error - baseline.known_rad, bound)
    moved = gear[:, LIKELY] - joints.gear_rad[:, LIKELY]
    return replace(
        joints,
        gear_rad=gear,
        bounds=include_gear(joints.bounds, gear, located),
        # estimate and error together are what the resolver reads
        resolver_error_rad=np.where(located, error - moved, joints.resolver_error_rad),
        baseline=replace(
            baseline,
            known_rad=np.where(side != 0, error, baseline.known_rad),
            known_output_rad=np.where(side != 0, joints.output_rad, baseline.known_output_rad),
            located_motor_rad=np.where(located, joints.motor_rad, np.inf),
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class LoadEstimate:
    """Estimate of spring strains and joint torques."""

    known: bool
    """True after the first estimate, which iterates to convergence; later ones iterate once."""
    strain: Array
    """Spring displacements, (6, 6), links second."""
    torque_Nm: Array
    """Torque of the load on each joint, (5,)."""
    press_torque_Nm: Array
    """Part of the torque that a contact force causes, (5,)."""


def no_load(n: int) -> LoadEstimate:
    """Build the estimate of a load that is not known yet."""
    return LoadEstimate(False, np.zeros((6, n + 1)), np.zeros(n), np.zeros(n))


def update_load(
    config: Config,
    tick: int,
    tool: str,
    joints: JointEstimate,
    last: LoadEstimate,
    push: ToolForce | None = None,
) -> tuple[LoadEstimate, JointEstimate, ToolChannels]:
    """Update strain, load, gear bounds and tool channels with one pass of the statics."""
    arm, output = config.arm, joints.output_rad
    strain = last.strain if last.known else settle_output(arm, output, joints.gravity_R_m_s2).strain
    frames, strain, torque = load_arm(arm, output, strain, joints.gravity_R_m_s2, push)
    push_Nm, uncertainty_Nm = np.zeros_like(torque), None
    if push is not None:
        push_Nm = push_torque(arm, frames, push)
        uncertainty_Nm = _force_uncertainty(config, push_Nm, push)
    X_RT = tool_pose(arm, frames, tool)
    index = config.params.tool_names.index(tool)
    channels = ToolChannels(tick, index, X_RT.p, X_RT.R, output, config.structure_C, torque)
    return (
        LoadEstimate(True, strain, torque, push_Nm),
        apply_load(config, joints, torque, uncertainty_Nm),
        channels,
    )


def _force_uncertainty(config: Config, push_Nm: Array, push: ToolForce) -> Array:
    """Compute the uncertainty of the loads (5,) of a contact force; no sensor measures the force."""
    force_N, preload = float(np.linalg.norm(push.force_R_N)), config.params.preload
    uncertainty_Nm: Array = np.abs(push_Nm) * (
        max(preload.error_share * force_N, preload.error_N) / max(force_N, 1e-9)
    )
    return uncertainty_Nm
