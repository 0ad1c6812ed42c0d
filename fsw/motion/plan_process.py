"""Holding the turret against gravity: the wrist and turret angles that lay it along a direction of a tool."""

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import Process
from fsw.dictionary.joints import Joint
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.limits import into_limits
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array
from fsw.motion.compensation import Compensation
from fsw.motion.plan import Refusal, over_limits, worst_limit

PASSES = 6
"""Of turning the wanted direction by what the arm bends; each takes off a factor of twenty or more."""
CLOSE_RAD = 1e-5


def gravity_pose(config: Config, joints: JointEstimate, command: Process) -> Array | Refusal:
    """Outputs (5) that differ in wrist and turret from where they are, so that gravity lies along gravity_T.

    Of the two turns of the wrist that do, the nearer one within the limits.
    """
    compensation = Compensation(command.backlash, command.deflection)
    gravity = compensation.gravity(joints)
    down_R = joints.gravity_R_m_s2 / np.linalg.norm(joints.gravity_R_m_s2)
    down_T = np.array(command.gravity_T) / np.linalg.norm(command.gravity_T)
    poses = [_pose(config, joints, command, down_R, down_T, gravity, turn) for turn in (1.0, -1.0)]
    found = [pose for pose in poses if not isinstance(pose, Refusal)]
    inside = [pose for pose in found if over_limits(config, pose) <= 0]
    if inside:
        return min(inside, key=lambda pose: float(np.abs(pose - joints.output_rad).max()))
    return Refusal(worst_limit(config, found[0])) if found else poses[0]


def _pose(
    config: Config,
    joints: JointEstimate,
    command: Process,
    down_R: Array,
    down_T: Array,
    gravity_R_m_s2: Array,
    turn: float,
) -> Array | Refusal:
    arm, pose, wanted = config.arm, joints.output_rad.copy(), down_R
    for _ in range(PASSES):
        angles = _wrist_and_turret(config, pose, wanted, down_T, command.tool, turn)
        if isinstance(angles, Refusal):
            return angles
        pose[Joint.WRIST :] = into_limits(arm, angles, joints.output_rad)[Joint.WRIST :]
        rigid = tool_pose(arm, forward(arm, pose), command.tool).R
        bent = tool_pose(arm, rest(arm, pose, gravity_R_m_s2).frames, command.tool).R
        wanted = rigid @ bent.T @ down_R
    off_rad = float(np.linalg.norm(bent.T @ down_R - down_T))
    return pose if off_rad < CLOSE_RAD else Refusal(f"no pose found: gravity would be {off_rad:.6f} rad off")


def _wrist_and_turret(
    config: Config, pose_rad: Array, down_R: Array, down_T: Array, tool: int, turn: float
) -> Array | Refusal:
    """The pose (5) of the rigid arm: the wrist lays the turret axis, the turret turns the direction in."""
    frames = forward(config.arm, pose_rad)
    X_FT = config.arm.X_FT[tool]
    along = float((X_FT.R @ down_T)[2])
    axis_R, turret_R = frames.X_RL.R[:, 2, Joint.WRIST + 1], frames.X_RL.R[:, 2, Joint.TURRET + 1]
    # turned about the wrist's axis by a: down . turret = level + ahead cos a + across sin a
    level = float(axis_R @ turret_R) * float(axis_R @ down_R)
    flat = turret_R - axis_R * float(axis_R @ turret_R)
    ahead, across = float(flat @ down_R), float(np.cross(axis_R, flat) @ down_R)
    size = float(np.hypot(ahead, across))
    if abs(along - level) > size:
        best = np.degrees(np.arccos(np.clip([level + size, level - size], -1.0, 1.0)))
        return Refusal(
            f"gravity is {np.degrees(np.arccos(along)):.1f} deg from the turret axis in what is asked; with "
            f"this azimuth the wrist can bring it to {best[0]:.1f} .. {best[1]:.1f} deg"
        )
    angle = np.arctan2(across, ahead) + turn * np.arccos((along - level) / size)
    turned = pose_rad.copy()
    turned[Joint.WRIST] += angle
    R_RT = forward(config.arm, turned).X_RF.R[:, :, 5] @ X_FT.R
    have, want = X_FT.R @ (R_RT.T @ down_R), X_FT.R @ down_T
    turned[Joint.TURRET] += np.arctan2(have[1], have[0]) - np.arctan2(want[1], want[0])
    return turned
