"""Reference of encoders and resolvers: the result of hardstop calibration, kept while the power is off."""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Reference of encoders and resolvers on the output side, in the order of Joint."""

    calibrated: Flags
    """True for joints that have found their hardstop; the values of others are provisional, (5,)."""
    known: Flags
    """True for joints calibrated at any time; a new result is compared with the last one, (5,)."""
    zero_rad: Array
    """Motor angle at encoder count 0, (5,)."""
    half_backlash_rad: Array
    """Half the width of the backlash, measured if possible, else nominal, (5,)."""
    resolver_bias_rad: Array
    """Resolver reading less estimated output at the calibration, (5,)."""
    friction_Nm: Array
    """Torque that turns a joint without load, (5,); infinite if it was never measured."""


def no_reference(config: Config) -> Reference:
    """Build the reference of an arm of which only the parameters are known."""
    zeros = np.zeros_like(config.half_backlash_rad)
    never = np.zeros(zeros.size, bool)
    return Reference(never, never, zeros, config.half_backlash_rad, zeros, np.full(zeros.size, np.inf))


def provisional_reference(config: Config, reference: Reference, sensors: Sensors) -> Reference:
    """Set the encoder zeros of joints that were never calibrated from their resolvers."""
    read = sensors.resolver_rad - sensors.encoder_count * config.rad_per_count
    return replace(reference, zero_rad=np.where(reference.known, reference.zero_rad, read))


def forget_joint(reference: Reference, joint: int) -> Reference:
    """Mark a joint as uncalibrated; its values stay as provisional ones."""
    others = np.arange(reference.zero_rad.size) != joint
    return replace(reference, calibrated=reference.calibrated & others)


def record_calibration(
    reference: Reference,
    joint: int,
    zero_rad: float,
    half_backlash_rad: float,
    resolver_bias_rad: float,
    friction_Nm: float,
) -> Reference:
    """Record the calibration of a joint."""
    this = np.arange(reference.zero_rad.size) == joint
    return Reference(
        calibrated=reference.calibrated | this,
        known=reference.known | this,
        zero_rad=np.where(this, zero_rad, reference.zero_rad),
        half_backlash_rad=np.where(this, half_backlash_rad, reference.half_backlash_rad),
        resolver_bias_rad=np.where(this, resolver_bias_rad, reference.resolver_bias_rad),
        friction_Nm=np.where(this, friction_Nm, reference.friction_Nm),
    )
