"""Poses in which a joint may run to its hardstop, and the checks of these."""

from math import degrees
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.params import Params
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array

HOMED_TWICE: Final = Joint.ELEVATION
"""Joint that is homed a second time, in a pose in which its load is as wanted."""
MAX_GRAVITY_SHARE: Final = 0.6
"""Greatest share of the pressing torque that gravity may supply."""


def homing_start_poses(params: Params, joint: Joint) -> tuple[Array, ...]:
    """Return the poses in which the homing of a joint begins, one for each time that it is homed.

    In the first pose the joints homed before it are at their parking angles; all others are at their start.

    Returns:
        Output angles in radians, shape (5,) each.
    """
    parked = [HARDSTOP_ORDER.index(other) < HARDSTOP_ORDER.index(joint) for other in Joint]
    first = np.where(parked, params.hardstop.park_rad, params.hardstop.start_rad)
    return (first, np.array(params.hardstop.second_start_rad)) if joint is HOMED_TWICE else (first,)


def check_homing(config: Config, joints: JointEstimate, joint: Joint) -> str | None:
    """Return the reason that a joint may not run to its hardstop from the present pose, or None.

    The joint may begin anywhere between its hardstop and its angle in a start pose. The output angles of
    uncalibrated joints come from their resolvers.
    """
    reasons = [
        _check_pose(config, joints.output_rad, joint, pose)
        for pose in homing_start_poses(config.params, joint)
    ]
    if None not in reasons:
        return reasons[-1]
    return _check_gravity_torque(config, joints, joint, joints.output_rad)


def check_homing_all(config: Config, joints: JointEstimate) -> str | None:
    """Return the reason that the joints may not be calibrated one after the other from here, or None."""
    starts = [(joint, pose) for joint in HARDSTOP_ORDER for pose in homing_start_poses(config.params, joint)]
    too_heavy = (_check_gravity_torque(config, joints, joint, pose) for joint, pose in starts)
    return check_homing(config, joints, HARDSTOP_ORDER[0]) or next(filter(None, too_heavy), None)


def _check_gravity_torque(config: Config, joints: JointEstimate, joint: Joint, pose_rad: Array) -> str | None:
    """Check that gravity leaves enough of the pressing torque.

    The stall at the hardstop is detected by the rest of that torque.
    """
    params, pose = config.params.joints.in_order()[joint], pose_rad.copy()
    pose[joint] = params.hardstop_rad
    press_Nm = -float(settle_output(config.arm, pose, joints.gravity_R_m_s2).torque_Nm[joint])
    most_Nm = MAX_GRAVITY_SHARE * params.hardstop_press_Nm
    if press_Nm <= most_Nm:
        return None
    return (
        f"joint {joint.name.lower()}: gravity presses it on its hardstop with {press_Nm:.0f} N m, "
        f"at most {most_Nm:.0f} N m are allowed"
    )


def _check_pose(config: Config, output_rad: Array, joint: Joint, pose_rad: Array) -> str | None:
    """Check that outputs are near a start pose; the homed joint may be between it and its hardstop."""
    tolerance = config.params.hardstop.pose_tolerance_rad
    low, high = pose_rad - tolerance, pose_rad + tolerance
    low[joint] = config.protection.lowest_homing_rad[joint, joint]
    beyond = np.maximum(low - output_rad, output_rad - high)
    if beyond.max() <= 0:
        return None
    worst = Joint(int(beyond.argmax()))
    return (
        f"joint {worst.name.lower()}: {degrees(output_rad[worst]):.1f} deg is outside "
        f"{degrees(low[worst]):.1f} .. {degrees(high[worst]):.1f} deg, "
        f"where {joint.name.lower()} may be calibrated"
    )
