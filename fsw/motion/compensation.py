"""What a set-point allows for so that the output, and the tool on it, comes to where it is wanted."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import BacklashMode, DeflectionMode
from fsw.dictionary.enums import Tool
from fsw.estimate.gear import clip_to_backlash, load_error
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.statics import relative_target
from fsw.kinematics.transforms import Array

NO_GRAVITY: Final = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Compensation:
    """Whether a move allows for backlash, and what it does about deflection; wind-up counts as deflection."""

    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"

    def gravity(self, joints: JointEstimate) -> Array:
        """The gravity under which the arm is taken to hang: none if it is taken to be rigid."""
        return NO_GRAVITY if self.deflection == "off" else joints.gravity_R_m_s2

    def allowance(self, joints: JointEstimate, gear_rad: Array) -> Array:
        """The part of gear angles (5, ...) by which set-points are shifted."""
        wind_up = gear_rad - clip_to_backlash(joints.reference.half_gap_rad, gear_rad)
        gap = self.backlash_allowance(joints, gear_rad)
        allowed: Array = gap if self.deflection == "off" else gap + wind_up
        return allowed

    def backlash_allowance(self, joints: JointEstimate, gear_rad: Array) -> Array:
        """The part of that which is backlash."""
        gap = clip_to_backlash(joints.reference.half_gap_rad, gear_rad)
        return gap if self.backlash == "on" else np.zeros_like(gap)

    def target(
        self, config: Config, joints: JointEstimate, reference: Tool, p_RoTo_R_m: Array, approach_R: Array
    ) -> tuple[Array, Array]:
        """The target (3, ...) for the absolute inverse; relative to the deflection of a tool as it is now."""
        if self.deflection != "relative":
            return p_RoTo_R_m, approach_R
        return relative_target(
            config.arm, reference, joints.output_rad, joints.gravity_R_m_s2, p_RoTo_R_m, approach_R
        )


def final_direction(config: Config, load_Nm: Array, gravity_R_m_s2: Array) -> Array:
    """In which direction outputs (5) should come to rest under these loads so that their side is known.

    0 where the load decides. Otherwise from the negative side, unless the load may be enough to push an
    output that comes from there across its gap: then from the positive side, where it is pushed to.
    """
    error = load_error(config, gravity_R_m_s2)
    decided = np.abs(load_Nm) > config.output_friction_Nm + error
    pushed = load_Nm > config.output_friction_Nm - error
    direction: Array = np.where(decided, 0.0, np.where(pushed, -1.0, 1.0))
    return direction
