"""The poses of the hardstop initialisation: gravity's torque at each stop, and how much room there is.

They are flight parameters, `[hardstop]`. Those of nominal.toml are for the whole arm on Mars. The paper
calibrated on Earth without a turret, in poses in which gravity has the same torque at each stop as later on
Mars.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from scipy.optimize import least_squares

from fsw.config import configure
from fsw.dictionary.commands import Calibrate, MoveJoint
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Joints5, joints5
from fsw.executive.expansion import expand_calibrate_all
from fsw.executive.homing_poses import homing_start_poses
from fsw.kinematics.arm import build_arm
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from sim.arms import BuiltArm
from sim.clearance import Clearance, ClearanceModel
from sim.effects.structure import StandInTurret
from sim.world import World

SWEEP_SPACING_RAD: Final = 0.03
HARDSTOP_CLEARANCE_M: Final = 0.015
LOAD_TOLERANCE_NM: Final = 0.5

PoseName = Literal["start_rad", "park_rad", "again_rad"]
FREE_ANGLES: Final[tuple[tuple[PoseName, Joint], ...]] = (
    ("start_rad", Joint.ELEVATION),
    ("park_rad", Joint.ELEVATION),
    ("again_rad", Joint.ELBOW),
)
"""The angles that make torques equal: at the stops of wrist, elbow and elevation."""
EQUALISED_JOINTS: Final = (Joint.WRIST, Joint.ELBOW, Joint.ELEVATION)
"""The others carry next to nothing at their stops."""


def _joints_from_deg(*angles_deg: float) -> Joints5:
    return joints5(np.radians(angles_deg))


EARTH_GUESS: Final[dict[PoseName, Joints5]] = {
    "start_rad": _joints_from_deg(-81.1, -110.4, -158.2, -184.2, -14.2),
    "park_rad": _joints_from_deg(-179.9, -101.8, -163.9, -172.6, 38.9),
    "again_rad": _joints_from_deg(-81.1, -175.0, -158.0, -172.6, 38.9),
}
"""For the arm without a turret on Earth; `equalised` makes its torques those of another plan."""


@dataclass(frozen=True, slots=True, eq=False)
class HardstopLoads:
    """Gravity's torque on each joint at its hardstop, in the pose of its last turn."""

    pose_rad: Array
    """Joints by poses, both in the order of Joint."""
    torque_Nm: Array
    """Negative presses the output on its stop."""


class NoPlan(ValueError):
    """No poses within the limits do what is asked."""


def compute_hardstop_loads(params: Params, gravity_R_m_s2: Array) -> HardstopLoads:
    """What each joint carries at its hardstop."""
    poses = np.array([homing_start_poses(params, joint)[-1] for joint in Joint]).T
    for joint, of_joint in zip(Joint, params.joints.in_order(), strict=True):
        poses[joint, joint] = of_joint.hardstop_rad
    torques = settle_output(build_arm(params), poses, gravity_R_m_s2).torque_Nm
    return HardstopLoads(poses, np.diag(torques).copy())


def calibration_poses(params: Params) -> list[Array]:
    """Every pose (5) between two motions while all joints are calibrated; each motion is of one joint."""
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
    """Poses all along the way, (5, n)."""
    poses = calibration_poses(params)
    legs = []
    for start, end in pairwise(poses):
        samples = int(np.abs(end - start).max() / spacing_rad) + 2
        legs.append(np.linspace(start, end, samples, axis=1))
    return np.concatenate(legs, axis=1)


def sweep_clearance(
    params: Params, space: ClearanceModel, spacing_rad: float = SWEEP_SPACING_RAD
) -> Clearance:
    """How close the arm comes to anything while all joints are calibrated."""
    return space.clearance(sweep_poses(params, spacing_rad))


def with_poses(params: Params, poses: dict[PoseName, Joints5]) -> Params:
    """The parameters with other poses of the hardstop initialisation."""
    stops = replace(
        params.hardstop,
        start_rad=poses["start_rad"],
        park_rad=poses["park_rad"],
        again_rad=poses["again_rad"],
    )
    return replace(params, hardstop=stops)


def equalise_loads(params: Params, gravity_R_m_s2: Array, wanted_Nm: Array) -> Params:
    """The parameters with poses near those they have, in which gravity has these torques (5) at the stops.

    Raises:
        NoPlan: the free angles cannot bring them about.
    """
    limits = [params.joints.in_order()[joint] for _, joint in FREE_ANGLES]

    def missed_Nm(angles: Array) -> Array:
        found = compute_hardstop_loads(_with_free_angles(params, angles), gravity_R_m_s2).torque_Nm
        missed: Array = (found - wanted_Nm)[list(EQUALISED_JOINTS)]
        return missed

    first = np.array([getattr(params.hardstop, pose)[joint] for pose, joint in FREE_ANGLES])
    low, high = [joint.soft_min_rad for joint in limits], [joint.soft_max_rad for joint in limits]
    found = least_squares(missed_Nm, first, bounds=(low, high), xtol=1e-10)
    if np.abs(found.fun).max() > LOAD_TOLERANCE_NM:
        raise NoPlan(f"the torques miss what was wanted by {np.round(found.fun, 1)} N m at best")
    return _with_free_angles(params, found.x)


def without_turret(arm: BuiltArm, on_earth: bool) -> BuiltArm:
    """The arm without its turret, which flight software knows; on Earth in poses for it.

    There the torques are those that the whole arm has in its own poses on Mars.
    """
    turret = StandInTurret(0.0)
    bare = replace(arm, effects=(*arm.effects, turret), params=turret.on_params(arm.params))
    if not on_earth:
        return bare
    wanted_Nm = compute_hardstop_loads(arm.params, World().gravity_N_m_s2).torque_Nm
    guess = with_poses(bare.params, EARTH_GUESS)
    return replace(bare, params=equalise_loads(guess, World("earth").gravity_N_m_s2, wanted_Nm))


def _with_free_angles(params: Params, angles: Array) -> Params:
    poses = {name: list(getattr(params.hardstop, name)) for name in EARTH_GUESS}
    for (pose, joint), angle in zip(FREE_ANGLES, angles, strict=True):
        poses[pose][joint] = float(angle)
    return with_poses(params, {name: joints5(np.array(pose)) for name, pose in poses.items()})
