"""Poses of the hardstop initialisation: gravity torques at the hardstops, and clearances.

The poses are flight parameters, `[hardstop]`. Those of the drawing are for the whole arm on Mars.
The calibration of the paper used an arm without a turret on Earth.
Its poses had the same gravity torque at each hardstop as later on Mars.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal, get_args

import numpy as np
from scipy.optimize import least_squares

from fsw.config import configure
from fsw.dictionary.commands import Calibrate, MoveJoint
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Joints5, joints5
from fsw.executive.expansion import expand_calibrate_all
from fsw.executive.poses import homing_start_poses
from fsw.kinematics.arm import build_arm
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from sim.clearance import Clearance, ClearanceModel

SWEEP_SPACING_RAD: Final = 0.03
HARDSTOP_CLEARANCE_M: Final = 0.015
LOAD_TOLERANCE_NM: Final = 0.5

PoseName = Literal["start_rad", "park_rad", "second_start_rad"]
POSE_NAMES: Final[tuple[PoseName, ...]] = get_args(PoseName)
FREE_ANGLES: Final[tuple[tuple[PoseName, Joint], ...]] = (
    ("start_rad", Joint.ELEVATION),
    ("park_rad", Joint.ELEVATION),
    ("second_start_rad", Joint.ELBOW),
)
"""Angles that are solved for equal torques at the hardstops of wrist, elbow and elevation."""
EQUALISED_JOINTS: Final = (Joint.WRIST, Joint.ELBOW, Joint.ELEVATION)
"""Joints whose torques are made equal; those of the others are near 0 at their hardstops."""


@dataclass(frozen=True, slots=True, eq=False)
class HardstopLoads:
    """Gravity torque on each joint at its hardstop, in the pose of its homing."""

    pose_rad: Array
    """Poses, shape (5, 5): joints by homings, both in the order of Joint."""
    torque_Nm: Array
    """Torques, shape (5,); a negative one presses the output on its hardstop."""


class NoPlan(ValueError):
    """Poses that cannot be found within the limits."""


def compute_hardstop_loads(params: Params, gravity_R_m_s2: Array) -> HardstopLoads:
    """Compute the gravity torque on each joint at its hardstop.

    Args:
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
    """
    poses = np.array([homing_start_poses(params, joint)[-1] for joint in Joint]).T
    for joint, joint_params in zip(Joint, params.joints.in_order(), strict=True):
        poses[joint, joint] = joint_params.hardstop_rad
    torques = settle_output(build_arm(params), poses, gravity_R_m_s2).torque_Nm
    return HardstopLoads(poses, np.diag(torques).copy())


def calibration_poses(params: Params) -> list[Array]:
    """List the poses between the motions of the hardstop initialisation.

    Each motion moves one joint.

    Returns:
        Output angles [rad], each of shape (5,).
    """
    stops = configure(params).hardstop_rad
    poses = [np.array(params.hardstop.start_rad)]
    for command in expand_calibrate_all(params).remaining:
        pose = poses[-1].copy()
        match command:
            case Calibrate(joint=joint):
                pose[joint] = stops[joint]
            case MoveJoint(joint=joint, angle_rad=angle):
                pose[joint] = angle
        poses.append(pose)
    return poses


def sweep_poses(params: Params, spacing_rad: float = SWEEP_SPACING_RAD) -> Array:
    """Sample all motions of the hardstop initialisation.

    Returns:
        Output angles [rad], shape (5, n).
    """
    legs = pairwise(calibration_poses(params))
    return np.concatenate([sample_leg(start, end, spacing_rad) for start, end in legs], axis=1)


def sample_leg(start_rad: Array, end_rad: Array, spacing_rad: float = SWEEP_SPACING_RAD) -> Array:
    """Sample the way from one pose to another, shape (5, n)."""
    samples = int(np.abs(end_rad - start_rad).max() / spacing_rad) + 2
    return np.linspace(start_rad, end_rad, samples, axis=1)


def sweep_clearance(
    params: Params, space: ClearanceModel, spacing_rad: float = SWEEP_SPACING_RAD
) -> Clearance:
    """Compute the least clearances during the hardstop initialisation."""
    return space.clearance(sweep_poses(params, spacing_rad))


def with_poses(params: Params, poses: dict[PoseName, Joints5]) -> Params:
    """Return the parameters with other poses of the hardstop initialisation."""
    stops = replace(
        params.hardstop,
        start_rad=poses["start_rad"],
        park_rad=poses["park_rad"],
        second_start_rad=poses["second_start_rad"],
    )
    return replace(params, hardstop=stops)


def equalise_loads(params: Params, gravity_R_m_s2: Array, wanted_Nm: Array) -> Params:
    """Find poses in which gravity has the wanted torques at the hardstops.

    The search starts at the poses of the parameters.

    Args:
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
        wanted_Nm: Torques at the hardstops, shape (5,).

    Returns:
        The parameters with these poses.

    Raises:
        NoPlan: the free angles cannot give these torques.
    """
    limits = [params.joints.in_order()[joint] for _, joint in FREE_ANGLES]

    def torque_error_Nm(angles: Array) -> Array:
        found = compute_hardstop_loads(_with_free_angles(params, angles), gravity_R_m_s2).torque_Nm
        error_Nm: Array = (found - wanted_Nm)[list(EQUALISED_JOINTS)]
        return error_Nm

    start = np.array([getattr(params.hardstop, pose)[joint] for pose, joint in FREE_ANGLES])
    low, high = [joint.soft_min_rad for joint in limits], [joint.soft_max_rad for joint in limits]
    solution = least_squares(torque_error_Nm, start, bounds=(low, high), xtol=1e-10)
    if np.abs(solution.fun).max() > LOAD_TOLERANCE_NM:
        raise NoPlan(f"the best torques differ from the wanted ones by {np.round(solution.fun, 1)} N m")
    return _with_free_angles(params, solution.x)


def _with_free_angles(params: Params, angles: Array) -> Params:
    poses = {name: list(getattr(params.hardstop, name)) for name in POSE_NAMES}
    for (pose, joint), angle in zip(FREE_ANGLES, angles, strict=True):
        poses[pose][joint] = float(angle)
    return with_poses(params, {name: joints5(np.array(pose)) for name, pose in poses.items()})
