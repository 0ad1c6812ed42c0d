"""The poses in which a joint may run to its hardstop."""

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
"""It has a second turn, when the joints beyond it can go where its load is as wanted."""
MAX_GRAVITY_SHARE: Final = 0.6
"""The share of the pressing torque that gravity may take."""


def homing_start_poses(params: Params, joint: Joint) -> tuple[Array, ...]:
    """The poses in which a joint begins, one for each of its turns.

    In the first those before it are parked, and it and those after it wait.
    """
    parked = [HARDSTOP_ORDER.index(other) < HARDSTOP_ORDER.index(joint) for other in Joint]
    first = np.where(parked, params.hardstop.park_rad, params.hardstop.start_rad)
    return (first, np.array(params.hardstop.again_rad)) if joint is HOMED_TWICE else (first,)


def check_homing(config: Config, joints: JointEstimate, joint: Joint) -> str | None:
    """Why a joint may not run to its hardstop from where the arm is, or None.

    It may begin anywhere between its hardstop and its place in such a pose; where joints are not calibrated,
    their resolvers tell.
    """
    reasons = [
        _check_pose(config, joints.output_rad, joint, pose)
        for pose in homing_start_poses(config.params, joint)
    ]
    if None not in reasons:
        return reasons[-1]
    return _check_gravity_torque(config, joints, joint, joints.output_rad)


def check_homing_all(config: Config, joints: JointEstimate) -> str | None:
    """Why the joints may not be calibrated one after the other from where the arm is, or None."""
    turns = [(joint, pose) for joint in HARDSTOP_ORDER for pose in homing_start_poses(config.params, joint)]
    heavy = (_check_gravity_torque(config, joints, joint, pose) for joint, pose in turns)
    return check_homing(config, joints, HARDSTOP_ORDER[0]) or next(
        (reason for reason in heavy if reason), None
    )


def _check_gravity_torque(config: Config, joints: JointEstimate, joint: Joint, pose_rad: Array) -> str | None:
    """Gravity that presses a joint on its hardstop leaves little of the torque by which it is to be felt."""
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


def _check_pose(config: Config, at_rad: Array, joint: Joint, pose_rad: Array) -> str | None:
    tolerance = config.params.hardstop.pose_tolerance_rad
    low, high = pose_rad - tolerance, pose_rad + tolerance
    low[joint] = config.protection.lowest_seeking_rad[joint, joint]
    beyond = np.maximum(low - at_rad, at_rad - high)
    if beyond.max() <= 0:
        return None
    worst = Joint(int(beyond.argmax()))
    return (
        f"joint {worst.name.lower()}: {degrees(at_rad[worst]):.1f} deg is outside "
        f"{degrees(low[worst]):.1f} .. {degrees(high[worst]):.1f} deg, "
        f"where {joint.name.lower()} may be calibrated"
    )
