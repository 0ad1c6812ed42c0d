"""Undecided backlash before a move relative to a touched spot: which joint, and how far at the tool.

While a tool touches, no joint can be dragged to a side of its backlash without losing or moving the contact.
The joints of the next tool are: its move to the standoff ends on known sides.
"""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import BacklashUndecided
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import joint_jacobian, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array


@dataclass(frozen=True, slots=True, eq=False)
class UndecidedBacklash:
    """Joints whose flank is not known, and what that means at a tool."""

    tool: str
    joints: tuple[Joint, ...]
    error_rad: Array
    """Largest error of each joint's estimated output, 0 where the flank is known, (5,)."""
    error_m: Array
    """Largest error of the tool across its axis from each joint, (5,)."""

    @property
    def events(self) -> tuple[BacklashUndecided, ...]:
        """Return an event for each joint."""
        return tuple(
            BacklashUndecided(joint, float(self.error_rad[joint]), self.tool, float(self.error_m[joint]))
            for joint in self.joints
        )

    def refusal(self, max_m: float) -> str | None:
        """Return the reason to refuse a move that needs the tool known within a distance, or None."""
        error_m = float(self.error_m.sum())
        if error_m <= max_m:
            return None
        names = ", ".join(joint.name.lower() for joint in self.joints)
        return (
            f"the backlash of {names} is undecided: the spot of {self.tool} is known to "
            f"{1e3 * error_m:.1f} mm, at most {1e3 * max_m:.1f} mm are allowed; touch it again"
        )


def assess_backlash(config: Config, joints: JointEstimate, tool: str) -> UndecidedBacklash:
    """Find the joints whose flank is not known, and how far they may put a tool beside its estimate.

    A joint that is uncertain by more than half its backlash, from its middle to a flank, may be on either.
    """
    undecided = joints.uncertainty_rad > joints.reference.half_backlash_rad
    frames = settle_output(config.arm, joints.output_rad, joints.gravity_R_m_s2).frames
    X_RT = tool_pose(config.arm, frames, tool)
    axis = X_RT.R[:, 0]
    moved_m = joint_jacobian(frames, X_RT.p)[3:]
    across_m = np.linalg.norm(moved_m - np.outer(axis, axis @ moved_m), axis=0)
    error_rad = np.where(undecided, joints.uncertainty_rad, 0.0)
    found = tuple(joint for joint in Joint if undecided[joint])
    return UndecidedBacklash(tool, found, error_rad, across_m * error_rad)
