"""What hardstop initialisation leaves behind: flight software keeps it while the power is off."""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What encoders and resolvers mean; output side, order of Joint."""

    calibrated: Flags
    """Which joints have found their hardstop; what the others have here is only provisional."""
    known: Flags
    """Which have at any time; where one is found anew, it is held against what it was."""
    zero_rad: Array
    """Motor angle at encoder count 0."""
    half_gap_rad: Array
    """Half the width of the backlash, measured where it could be."""
    resolver_bias_rad: Array
    friction_Nm: Array
    """Torque that it takes to turn a joint without load; infinite where nobody has felt it."""


def no_reference(config: Config) -> Reference:
    """Nothing is known but what the parameters say."""
    zeros = np.zeros_like(config.half_gap_rad)
    never = np.zeros(zeros.size, bool)
    return Reference(never, never, zeros, config.half_gap_rad, zeros, np.full(zeros.size, np.inf))


def provisional_reference(config: Config, reference: Reference, sensors: Sensors) -> Reference:
    """The reference with joints that were never calibrated where their resolvers say: good to watch by."""
    read = sensors.resolver_rad - sensors.encoder_count * config.rad_per_count
    return replace(reference, zero_rad=np.where(reference.known, reference.zero_rad, read))


def forget_joint(reference: Reference, joint: int) -> Reference:
    """The reference without a joint, whose numbers stay as provisional ones."""
    others = np.arange(reference.zero_rad.size) != joint
    return replace(reference, calibrated=reference.calibrated & others)


def record_calibration(
    reference: Reference,
    joint: int,
    zero_rad: float,
    half_gap_rad: float,
    resolver_bias_rad: float,
    friction_Nm: float,
) -> Reference:
    """The reference with a joint that is now calibrated."""
    this = np.arange(reference.zero_rad.size) == joint
    return Reference(
        calibrated=reference.calibrated | this,
        known=reference.known | this,
        zero_rad=np.where(this, zero_rad, reference.zero_rad),
        half_gap_rad=np.where(this, half_gap_rad, reference.half_gap_rad),
        resolver_bias_rad=np.where(this, resolver_bias_rad, reference.resolver_bias_rad),
        friction_Nm=np.where(this, friction_Nm, reference.friction_Nm),
    )
