"""Checks of an arm in its plant: that it can be made, homed and stowed, and reaches its workspace."""

from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from math import degrees
from typing import Final

import numpy as np

from fsw.dictionary.commands import Calibrate, MoveJoint
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.executive.expansion import expand_calibrate_all
from fsw.executive.poses import MAX_GRAVITY_SHARE
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from sim.arm_model.description import BadArm
from sim.arm_model.load import ArmModel
from sim.clearance import ClearanceModel, Gap
from sim.frames import p_R_from_N
from sim.hardstop_loads import HARDSTOP_CLEARANCE_M, calibration_poses, sample_leg
from sim.workspace import approach_from, random_targets
from sim.world import World, check_plant

MARS: Final = World()
TARGETS: Final = 300
"""Number of random targets of which each tool must reach one: enough to find 1 % that it reaches."""


def check_arm(arm: ArmModel) -> None:
    """Check an arm in its plant on level Mars. Those of the project are checked in lint.

    Raises:
        BadArm: MuJoCo does not accept it, or it cannot be homed, stowed, or brought to its workspace.
    """
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
    gap = space.clearance(np.concatenate([sample_leg(*leg) for leg in pairwise(poses)], axis=1)).least
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
