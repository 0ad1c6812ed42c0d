"""Holding the turret against gravity: the wrist and turret angles that lay it along a direction of a tool."""

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import Process
from fsw.dictionary.enums import Joint
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.soft_limits import wrap_into_limits
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, angle_between
from fsw.motion.compensation import Compensation
from fsw.motion.plan import Refusal, describe_worst_limit, worst_limit_excess

MAX_DEFLECTION_PASSES = 40
"""Of turning wrist and turret and bending the arm anew. Each takes off a factor of 80 or more, times the sine
of the angle of gravity to the plane of both axes: in that plane the two turns of the wrist meet."""
DIRECTION_TOLERANCE_RAD = 1e-9


def find_gravity_pose(config: Config, joints: JointEstimate, command: Process) -> Array | Refusal:
    """Outputs (5) that differ in wrist and turret from where they are, so that gravity lies along gravity_T.

    Of the two turns of the wrist that do, the nearer one within the limits.
    """
    compensation = Compensation(command.backlash, command.deflection)
    gravity = compensation.gravity(joints)
    down_R = joints.gravity_R_m_s2 / np.linalg.norm(joints.gravity_R_m_s2)
    down_T = np.array(command.gravity_T) / np.linalg.norm(command.gravity_T)
    poses = [_solve_side(config, joints, command, down_R, down_T, gravity, side) for side in (1.0, -1.0)]
    found = [pose for pose in poses if not isinstance(pose, Refusal)]
    inside = [pose for pose in found if worst_limit_excess(config, pose) <= 0]
    if inside:
        return min(inside, key=lambda pose: float(np.abs(pose - joints.output_rad).max()))
    return Refusal(describe_worst_limit(config, found[0])) if found else poses[0]


def _solve_side(
    config: Config,
    joints: JointEstimate,
    command: Process,
    down_R: Array,
    down_T: Array,
    gravity_R_m_s2: Array,
    side: float,
) -> Array | Refusal:
    """The pose with gravity on this side of the plane of wrist and turret axis."""
    arm, pose = config.arm, joints.output_rad.copy()
    for _ in range(MAX_DEFLECTION_PASSES):
        frames = settle_output(arm, pose, gravity_R_m_s2).frames
        R_RT = tool_pose(arm, frames, command.tool).R
        off_rad = float(np.linalg.norm(R_RT.T @ down_R - down_T))
        if off_rad < DIRECTION_TOLERANCE_RAD:
            return pose
        wrist_R, turret_R = frames.X_RL.R[:, 2, Joint.WRIST + 1], frames.X_RL.R[:, 2, Joint.TURRET + 1]
        pointed_R = R_RT @ down_T
        between_R = _intermediate_direction(wrist_R, turret_R, down_R, pointed_R, side)
        pose[Joint.WRIST] += _angle_about(wrist_R, between_R, down_R)
        pose[Joint.TURRET] += _angle_about(turret_R, pointed_R, between_R)
        pose[Joint.WRIST :] = wrap_into_limits(arm, pose, joints.output_rad)[Joint.WRIST :]
    return Refusal(
        _describe_wrist_range(wrist_R, turret_R, down_R, pointed_R)
        or f"no pose found: gravity would be {off_rad:.6g} rad off"
    )


def _intermediate_direction(
    wrist_R: Array, turret_R: Array, down_R: Array, pointed_R: Array, side: float
) -> Array:
    """What the turret can make of the pointed direction and the wrist can turn down; else what is nearest.

    It has the angle of down to the wrist axis and that of the pointed direction to the turret axis. The axes
    need not be square to each other.
    """
    cosine = float(wrist_R @ turret_R)
    square = 1.0 - cosine**2
    along_wrist, along_turret = float(wrist_R @ down_R), float(turret_R @ pointed_R)
    a, b = (along_wrist - cosine * along_turret) / square, (along_turret - cosine * along_wrist) / square
    in_plane = a * wrist_R + b * turret_R
    out = np.sqrt(max(1.0 - float(in_plane @ in_plane), 0.0) / square)
    between: Array = in_plane + side * out * np.cross(wrist_R, turret_R)
    return between


def _angle_about(axis_R: Array, start_R: Array, end_R: Array) -> float:
    """The angle about an axis from one direction to another, as seen along the axis."""
    along = float(axis_R @ start_R) * float(axis_R @ end_R)
    return float(np.arctan2(axis_R @ np.cross(start_R, end_R), start_R @ end_R - along))


def _describe_wrist_range(wrist_R: Array, turret_R: Array, down_R: Array, pointed_R: Array) -> str:
    """What the wrist can do, where that is not enough; else nothing."""
    wanted = angle_between(turret_R, pointed_R)
    to_down, to_turret = angle_between(wrist_R, down_R), angle_between(wrist_R, turret_R)
    least, most = abs(to_down - to_turret), np.pi - abs(np.pi - to_down - to_turret)
    if least <= wanted <= most:
        return ""
    return (
        f"gravity is {np.degrees(wanted):.1f} deg from the turret axis in what is asked; with this azimuth "
        f"the wrist can bring it to {np.degrees(least):.1f} .. {np.degrees(most):.1f} deg"
    )
