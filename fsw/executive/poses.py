"""Poses that a command needs: those in which a joint may run to its hardstop, and that of a process.

In the pose of a process, gravity has a given direction in a tool.
"""

from dataclasses import replace
from math import degrees
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import Process
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import cycle_record
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.arm import wrap_into_limits
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, angle_between
from fsw.motion.plan import Compensation, Refusal, describe_worst_limit, worst_limit_excess
from fsw.motion.work import Work

HOMED_TWICE: Final = Joint.ELEVATION
"""Joint that is homed a second time, in a pose in which its load is as wanted."""
MAX_GRAVITY_SHARE: Final = 0.6
"""Greatest share of the pressing torque that gravity may supply."""


def homing_start_poses(params: Params, joint: Joint) -> tuple[Array, ...]:
    """Return the poses, (5,) [rad] each, in which the homing of a joint begins, one for each homing of it.

    In the first pose the joints homed before it are at their parking angles; all others are at their start.
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


MAX_DEFLECTION_PASSES = 40
"""Largest number of passes that turn wrist and turret and compute the deflection again.

Each pass divides the error by at least 80 sin(a); a is the angle of gravity to the plane of both axes. In
that plane the two solutions of the wrist coincide.
"""
DIRECTION_TOLERANCE_RAD = 1e-9
SIDES: Final = (1.0, -1.0)
"""Sides of the plane of wrist and turret axis, on which the two solutions are."""


@cycle_record
class GravityPoseSearch(Work[Array | Refusal]):
    """Search of outputs, (5,) [rad], with gravity along `gravity_T` of the tool, by wrist and turret only.

    The wrist has two solutions; the nearer one within the soft limits is taken. Else it is a refusal.
    """

    joints: JointEstimate
    command: Process
    pose_rad: Array
    """Present pose of the solution that is searched, (5,)."""
    passes: int = 0
    """Passes that turned wrist and turret of this solution."""
    found: tuple[Array | Refusal, ...] = ()
    """Results of the solutions that were searched."""

    def advance(self, config: Config) -> "GravityPoseSearch | Array | Refusal":
        """Turn wrist and turret once, with the deflection of the present pose."""
        turned = self._turn(config)
        if isinstance(turned, GravityPoseSearch):
            return turned
        found = (*self.found, turned)
        if len(found) < len(SIDES):
            return GravityPoseSearch(self.joints, self.command, self.joints.output_rad, found=found)
        return self._choose(config, found)

    def _turn(self, config: Config) -> "GravityPoseSearch | Array | Refusal":
        joints, command, side = self.joints, self.command, SIDES[len(self.found)]
        gravity = Compensation(command.backlash, command.deflection).gravity(joints)
        down_R = joints.gravity_R_m_s2 / np.linalg.norm(joints.gravity_R_m_s2)
        down_T = np.array(command.gravity_T) / np.linalg.norm(command.gravity_T)
        frames = settle_output(config.arm, self.pose_rad, gravity).frames
        R_RT = tool_pose(config.arm, frames, command.tool).R
        error_rad = float(np.linalg.norm(R_RT.T @ down_R - down_T))
        if error_rad < DIRECTION_TOLERANCE_RAD:
            return self.pose_rad
        wrist_R, turret_R = frames.X_RL.R[:, 2, Joint.WRIST + 1], frames.X_RL.R[:, 2, Joint.TURRET + 1]
        pointed_R = R_RT @ down_T
        if self.passes == MAX_DEFLECTION_PASSES:
            return Refusal(
                _describe_wrist_range(wrist_R, turret_R, down_R, pointed_R)
                or f"no pose found: gravity would be {error_rad:.6g} rad off"
            )
        pose = self.pose_rad.copy()
        between_R = _intermediate_direction(wrist_R, turret_R, down_R, pointed_R, side)
        pose[Joint.WRIST] += _angle_about(wrist_R, between_R, down_R)
        pose[Joint.TURRET] += _angle_about(turret_R, pointed_R, between_R)
        pose[Joint.WRIST :] = wrap_into_limits(config.arm, pose, joints.output_rad)[Joint.WRIST :]
        return replace(self, pose_rad=pose, passes=self.passes + 1)

    def _choose(self, config: Config, results: tuple[Array | Refusal, ...]) -> Array | Refusal:
        """Choose the nearest pose within the soft limits."""
        found = [pose for pose in results if not isinstance(pose, Refusal)]
        inside = [pose for pose in found if worst_limit_excess(config, pose) <= 0]
        if inside:
            return min(inside, key=lambda pose: float(np.abs(pose - self.joints.output_rad).max()))
        return Refusal(describe_worst_limit(config, found[0])) if found else results[0]


def find_gravity_pose(joints: JointEstimate, command: Process) -> GravityPoseSearch:
    """Begin the search of the pose of a process."""
    return GravityPoseSearch(joints, command, joints.output_rad)


def _intermediate_direction(
    wrist_R: Array, turret_R: Array, down_R: Array, pointed_R: Array, side: float
) -> Array:
    """Find the direction to which the turret turns the pointed one, and which the wrist then turns down.

    Its angle to the wrist axis is that of `down_R`; its angle to the turret axis is that of `pointed_R`. The
    axes need not be perpendicular. If there is no such direction, the result is the nearest one.
    """
    cosine = float(wrist_R @ turret_R)
    sine_squared = 1.0 - cosine**2
    along_wrist, along_turret = float(wrist_R @ down_R), float(turret_R @ pointed_R)
    a = (along_wrist - cosine * along_turret) / sine_squared
    b = (along_turret - cosine * along_wrist) / sine_squared
    in_plane = a * wrist_R + b * turret_R
    out_of_plane = np.sqrt(max(1.0 - float(in_plane @ in_plane), 0.0) / sine_squared)
    between: Array = in_plane + side * out_of_plane * np.cross(wrist_R, turret_R)
    return between


def _angle_about(axis_R: Array, start_R: Array, end_R: Array) -> float:
    """Compute the angle about an axis from one direction to another, both projected along the axis."""
    along = float(axis_R @ start_R) * float(axis_R @ end_R)
    return float(np.arctan2(axis_R @ np.cross(start_R, end_R), start_R @ end_R - along))


def _describe_wrist_range(wrist_R: Array, turret_R: Array, down_R: Array, pointed_R: Array) -> str:
    """Describe the range of the wrist if it does not suffice; else return an empty text."""
    wanted = angle_between(turret_R, pointed_R)
    to_down, to_turret = angle_between(wrist_R, down_R), angle_between(wrist_R, turret_R)
    least, most = abs(to_down - to_turret), np.pi - abs(np.pi - to_down - to_turret)
    if least <= wanted <= most:
        return ""
    return (
        f"gravity is {np.degrees(wanted):.1f} deg from the turret axis in what is asked; with this azimuth "
        f"the wrist can bring it to {np.degrees(least):.1f} .. {np.degrees(most):.1f} deg"
    )
