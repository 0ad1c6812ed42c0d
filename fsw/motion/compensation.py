"""Compensation of backlash and deflection: the shift of set-points, and the side to end a move on."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import BacklashMode, DeflectionMode
from fsw.estimate.gear import clip_to_backlash, load_error
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.statics import relative_target
from fsw.kinematics.transforms import Array

NO_GRAVITY: Final = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Compensation:
    """Compensations of a move; wind-up of the gears counts as deflection."""

    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"

    def gravity(self, joints: JointEstimate) -> Array:
        """Return the gravity of the deflection model in RMECH, shape (3,); zero if it is off."""
        return NO_GRAVITY if self.deflection == "off" else joints.gravity_R_m_s2

    def allowance(self, joints: JointEstimate, gear_rad: Array) -> Array:
        """Compute the part of the gear angles by which set-points are shifted.

        Args:
            joints: Estimate of the joints.
            gear_rad: Gear angles, output less motor, shape (5, ...).

        Returns:
            Backlash and wind-up in radians, each 0 if not compensated; same shape.
        """
        wind_up = gear_rad - clip_to_backlash(joints.reference.half_backlash_rad, gear_rad)
        backlash = self.backlash_allowance(joints, gear_rad)
        allowed: Array = backlash if self.deflection == "off" else backlash + wind_up
        return allowed

    def backlash_allowance(self, joints: JointEstimate, gear_rad: Array) -> Array:
        """Compute the backlash part of `allowance`, in radians, same shape."""
        backlash = clip_to_backlash(joints.reference.half_backlash_rad, gear_rad)
        return backlash if self.backlash == "on" else np.zeros_like(backlash)

    def target(
        self, config: Config, joints: JointEstimate, reference: str, p_RoTo_R_m: Array, approach_R: Array
    ) -> tuple[Array, Array]:
        """Convert a target to one for absolute inverse kinematics.

        Only relative compensation changes it: by the present deflection of the reference tool.

        Args:
            config: Configuration of flight software.
            joints: Estimate of the joints.
            reference: Tool whose present deflection counts.
            p_RoTo_R_m: Position of the tool in RMECH, shape (3, ...).
            approach_R: Unit direction of the tool axis, same shape.

        Returns:
            Position and approach, same shapes.
        """
        if self.deflection != "relative":
            return p_RoTo_R_m, approach_R
        return relative_target(
            config.arm, reference, joints.output_rad, joints.gravity_R_m_s2, p_RoTo_R_m, approach_R
        )


def final_direction(config: Config, load_Nm: Array, gravity_R_m_s2: Array) -> Array:
    """Choose the direction in which each output ends its move, so that its side of the backlash is known.

    If the load does not decide, the output moves in the positive direction and so ends on the negative side.
    If the load may then push it to the positive side, it moves in the negative direction and ends there.

    Args:
        config: Configuration of flight software.
        load_Nm: Loads at the end of the move, shape (5,).
        gravity_R_m_s2: Gravity in RMECH, shape (3,).

    Returns:
        1, -1, or 0 if the load decides the side; shape (5,).
    """
    error = load_error(config, gravity_R_m_s2)
    decided = np.abs(load_Nm) > config.output_friction_Nm + error
    pushed = load_Nm > config.output_friction_Nm - error
    direction: Array = np.where(decided, 0.0, np.where(pushed, -1.0, 1.0))
    return direction
