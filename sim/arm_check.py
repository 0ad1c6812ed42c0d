"""Checks of an arm in its plant: that it can be made, homed and stowed, and reaches its workspace.

The poses of the hardstop initialisation are flight parameters, `[hardstop]`. Those of the drawing are for the
whole arm on Mars. The calibration of the paper used an arm without a turret on Earth. Its poses had the same
gravity torque at each hardstop as later on Mars.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from math import degrees
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import Calibrate, MoveJoint
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Joints5, joints5
from fsw.executive.expansion import expand_calibrate_all
from fsw.executive.poses import MAX_GRAVITY_SHARE, homing_start_poses
from fsw.kinematics.arm import build_arm
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from sim.arm_model.description import BadArm
from sim.arm_model.load import ArmModel
from sim.clearance import ClearanceModel, Gap
from sim.effects.structure import StandInTurret
from sim.frames import approach_from, p_R_from_N, random_targets
from sim.setting import World
from sim.world import check_plant

if TYPE_CHECKING:
    from sim.arms import BuiltArm

SWEEP_SPACING_RAD: Final = 0.03
HARDSTOP_CLEARANCE_M: Final = 0.015
MOST_SHIFT_RAD: Final = 28e-6
"""Largest wind-up of a gear by the difference of a torque from the wanted one. It makes the 0.2 mrad by which
a calibrated hardstop scatters 1 % larger. In 5 of 40 calibrated arms the elevation has 7 to 25 urad, as the
elbow is at its limit.
"""

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
    """Compute the gravity torque on each joint at its hardstop, for gravity in the rover frame, (3,)."""
    poses = np.array([homing_start_poses(params, joint)[-1] for joint in Joint]).T
    for joint, joint_params in zip(Joint, params.joints.in_order(), strict=True):
        poses[joint, joint] = joint_params.hardstop_rad
    torques = settle_output(build_arm(params), poses, gravity_R_m_s2).torque_Nm
    return HardstopLoads(poses, np.diag(torques).copy())


def calibration_poses(params: Params) -> list[Array]:
    """List the poses, output angles of shape (5,) [rad], between the motions of the hardstop initialisation.

    Each motion moves one joint.
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


def sweep_poses(poses: Iterable[Array], spacing_rad: float = SWEEP_SPACING_RAD) -> Array:
    """Sample the way over poses: output angles [rad], shape (5, n)."""
    return np.concatenate([sample_leg(*leg, spacing_rad) for leg in pairwise(poses)], axis=1)


def sample_leg(start_rad: Array, end_rad: Array, spacing_rad: float = SWEEP_SPACING_RAD) -> Array:
    """Sample the way from one pose to another, shape (5, n)."""
    samples = int(np.abs(end_rad - start_rad).max() / spacing_rad) + 2
    return np.linspace(start_rad, end_rad, samples, axis=1)


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

    Raises:
        NoPlan: the free angles cannot give these torques.
    """
    limits = [params.joints.in_order()[joint] for _, joint in FREE_ANGLES]

    def torque_error_Nm(angles: Array) -> Array:
        found = compute_hardstop_loads(_with_free_angles(params, angles), gravity_R_m_s2).torque_Nm
        error_Nm: Array = (found - wanted_Nm)[list(EQUALISED_JOINTS)]
        return error_Nm

    from scipy.optimize import least_squares  # half of the time that every start of a program would take

    start = np.array([getattr(params.hardstop, pose)[joint] for pose, joint in FREE_ANGLES])
    low, high = [joint.soft_min_rad for joint in limits], [joint.soft_max_rad for joint in limits]
    solution = least_squares(torque_error_Nm, start, bounds=(low, high), xtol=1e-10)
    joints = params.joints.in_order()
    stiffness_Nm_rad = np.array([joints[joint].gear_stiffness_Nm_rad for joint in EQUALISED_JOINTS])
    if np.abs(solution.fun / stiffness_Nm_rad).max() > MOST_SHIFT_RAD:
        raise NoPlan(f"the best torques differ from the wanted ones by {np.round(solution.fun, 1)} N m")
    return _with_free_angles(params, solution.x)


def _with_free_angles(params: Params, angles: Array) -> Params:
    poses = {name: list(getattr(params.hardstop, name)) for name in POSE_NAMES}
    for (pose, joint), angle in zip(FREE_ANGLES, angles, strict=True):
        poses[pose][joint] = float(angle)
    return with_poses(params, {name: joints5(np.array(pose)) for name, pose in poses.items()})


MARS: Final = World()
TARGETS: Final = 300
"""Number of random targets of which each tool must reach one: enough to find 1 % that it reaches."""


def check_arm(arm: ArmModel) -> None:
    """Check an arm in its plant on level Mars, beyond what lint checks; BadArm if it cannot be used."""
    check_plant(arm)
    problems = _find_problems(arm)
    if problems:
        raise BadArm("\n".join(f"arm {arm.name}: {problem}" for problem in problems))


@cache
def _find_problems(arm: ArmModel) -> tuple[str, ...]:
    space = ClearanceModel(arm.params, MARS, arm)
    return (
        *_find_homing_problems(arm.params, space),
        *_find_stow_problem(arm.params, space),
        *_find_reach_problems(arm, space),
    )


def _find_homing_problems(params: Params, space: ClearanceModel) -> Iterator[str]:
    """Yield what is wrong with the homing of each joint."""
    seen = set()
    legs = pairwise(calibration_poses(params))
    for command, (start, end) in zip(expand_calibrate_all(params).remaining, legs, strict=True):
        if not isinstance(command, Calibrate | MoveJoint) or command.joint in seen:
            continue
        is_homing = isinstance(command, Calibrate)
        problem = _find_way_problem(space, start, end, command.joint)
        if problem is None and is_homing:
            problem = _find_load_problem(params, space, start, end, command.joint)
        if problem is not None:
            seen.add(command.joint)
            what = "be homed" if is_homing else "move on after a homing"
            yield f"joint {command.joint.name.lower()} cannot {what}: {problem}; change poses.hardstop_*"


def _find_way_problem(space: ClearanceModel, start_rad: Array, end_rad: Array, joint: Joint) -> str | None:
    """Return which parts come too near while a joint moves, or None."""
    way = sample_leg(start_rad, end_rad)
    gap = space.clearance(way).least
    if gap.distance_m >= HARDSTOP_CLEARANCE_M:
        return None
    return f"at {degrees(way[joint, gap.pose]):.1f} deg {_describe(gap)}"


def _find_load_problem(
    params: Params, space: ClearanceModel, start_rad: Array, stop_rad: Array, joint: Joint
) -> str | None:
    """Return how gravity keeps a joint from its hardstop, or None.

    The current limit towards the hardstop is that of the first move away and the pressing torque. Gravity
    that pulls away is missing from the former, and adds to the torque that is needed: twice its size.
    """
    own = params.joints.in_order()[joint]
    low_Nm, high_Nm = -MAX_GRAVITY_SHARE * own.hardstop_press_Nm, own.output_friction_Nm
    settled = settle_output(space.arm, np.column_stack([start_rad, stop_rad]), MARS.gravity_N_m_s2)
    start_Nm, stop_Nm = settled.torque_Nm[joint]
    if not low_Nm <= stop_Nm <= high_Nm:
        return f"at its hardstop gravity has {stop_Nm:.0f} N m, outside {low_Nm:.0f} .. {high_Nm:.0f}"
    if start_Nm > 0.5 * own.hardstop_press_Nm:
        most = f"at most {0.5 * own.hardstop_press_Nm:.0f}, half of hardstop_press_Nm, are allowed"
        at = degrees(start_rad[joint])
        return f"at {at:.1f} deg, where it starts, gravity pulls it away with {start_Nm:.0f} N m; {most}"
    return None


def _describe(gap: Gap) -> str:
    part, other = gap.parts
    distance_mm = 1e3 * gap.distance_m
    where = f"{distance_mm:.0f} mm from" if distance_mm >= 0 else f"{-distance_mm:.0f} mm inside"
    return f"the {part} is {where} the {other}, and {1e3 * HARDSTOP_CLEARANCE_M:.0f} mm are needed"


def _find_stow_problem(params: Params, space: ClearanceModel) -> Iterator[str]:
    """Yield which parts come too near between the stowed and the ready pose."""
    poses = np.array([params.poses.stowed_rad, *params.poses.unstow_via_rad, params.poses.ready_rad])
    gap = space.clearance(sweep_poses(poses)).least
    if gap.distance_m < HARDSTOP_CLEARANCE_M:
        yield f"cannot be stowed: {_describe(gap)}; change poses.stowed_rad, unstow_via_rad or ready_rad"


def _find_reach_problems(arm: ArmModel, space: ClearanceModel) -> Iterator[str]:
    """Yield a sentence for each tool that reaches no target of the workspace."""
    p_N_m, angles = random_targets(np.random.default_rng(0), TARGETS, arm.workspace)
    p_R_m, approach = p_R_from_N(p_N_m.T).T, approach_from(angles)
    for tool in arm.params.tools:
        found = inverse_kinematics(space.arm, tool.name, p_R_m, approach, MARS.gravity_N_m_s2)
        if not np.any(found.verdict == BranchVerdict.VALID):
            yield f"tool {tool.title} reaches none of {TARGETS} random targets; {arm.workspace.hint}"


def without_turret(arm: "BuiltArm", on_earth: bool) -> "BuiltArm":
    """Return the arm without its turret, which flight software knows.

    On Earth its poses have the torques of the whole arm in its own poses on Mars.
    """
    turret = StandInTurret(0.0)
    bare = replace(arm, effects=(*arm.effects, turret), params=turret.on_params(arm.params))
    if not on_earth:
        return bare
    wanted_Nm = compute_hardstop_loads(arm.params, World().gravity_N_m_s2).torque_Nm
    drawn = arm.model.description.poses
    poses = {name: getattr(drawn, f"bare_hardstop_{name}") for name in POSE_NAMES}
    guess = with_poses(bare.params, poses)
    return replace(bare, params=equalise_loads(guess, World("earth").gravity_N_m_s2, wanted_Nm))
