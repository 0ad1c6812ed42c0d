"""Quasi-static moves: equilibria of motors, gears and springs, without time steps.

Flight software plans the move. Motors follow it, and the gears pull the outputs along.
"""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import BacklashMode
from fsw.dictionary.enums import Frame
from fsw.estimate.gear import LIKELY, bound_gear, bound_loads, clip_to_backlash
from fsw.estimate.joints import uninitialised_estimate
from fsw.estimate.reference import Reference
from fsw.kinematics.chain import frame_jacobian, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, screw_exp
from fsw.motion.plan import Compensation, JointPositions, plan_joint_move
from sim.record import MoveDisturbance, frame_body


@dataclass(frozen=True, slots=True, eq=False)
class StaticArm:
    """True arm, and the parameters that flight software has for it."""

    believed: Config
    true: Config
    reference: Reference
    off_rad: Array
    """True less estimated motor angles, shape (5,)."""


@dataclass(frozen=True, slots=True, eq=False)
class QuasiStaticMove:
    """Arm at rest after a move."""

    X_RT: Pose
    backlash_rad: Array
    """Positions of the outputs in their backlash, shape (5,)."""


def solve_quasi_static_move(
    arm: StaticArm,
    start_rad: Array,
    pose_rad: Array,
    tool: str,
    gravity_R_m_s2: Array,
    backlash: BacklashMode,
    disturbance: MoveDisturbance,
) -> QuasiStaticMove:
    """Compute the arm at rest after a move.

    Displaced frames are small, so that they move the tool in proportion.

    Args:
        arm: True arm and what flight software knows about it.
        start_rad: Estimated output angles before the move, shape (5,).
        pose_rad: Commanded output angles, shape (5,).
        tool: Tool of the returned pose.
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
        disturbance: Displacements of frames, gears and motors in this move.
    """
    believed, true, reference = arm.believed, arm.true, arm.reference
    deflected = settle_output(believed.arm, pose_rad, gravity_R_m_s2)
    loads = bound_loads(believed, deflected.torque_Nm, gravity_R_m_s2)
    gear_bounds = bound_gear(believed, reference.half_backlash_rad, loads)
    start = JointPositions(start_rad - gear_bounds.lowest_rad[:, LIKELY], gear_bounds.lowest_rad[:, LIKELY])
    joints = replace(
        uninitialised_estimate(believed, reference),
        initialised=True,
        motor_rad=start.motor_rad,
        imu_R_m_s2=gravity_R_m_s2,
    )
    plan = plan_joint_move(believed, joints, start, pose_rad, deflected.torque_Nm, Compensation(backlash))
    off_rad = arm.off_rad + disturbance.motor_rad
    motor = start.motor_rad + off_rad
    torque = settle_output(true.arm, pose_rad, gravity_R_m_s2).torque_Nm
    gear = start.gear_rad
    bounds = bound_gear(true, true.half_backlash_rad, torque)
    for waypoint_rad in (*(path.at(path.duration_s).motor_rad for path in plan.paths), plan.end.motor_rad):
        gear = np.clip(gear - (waypoint_rad + off_rad - motor), bounds.lowest_rad, bounds.highest_rad)
        motor = waypoint_rad + off_rad
    frames = settle_output(true.arm, motor + gear + disturbance.gear_rad, gravity_R_m_s2).frames
    X_RT = tool_pose(true.arm, frames, tool)
    screws = np.stack([disturbance.screw(frame_body(frame, tool)) for frame in Frame], axis=1)
    J = frame_jacobian(frames, X_RT)
    shift = np.einsum("ikj,kj->i", J, screws)
    moved = screw_exp(np.concatenate([shift[:3], np.zeros(3)]))
    return QuasiStaticMove(
        Pose(moved.R @ X_RT.R, X_RT.p + shift[3:]), clip_to_backlash(true.half_backlash_rad, gear)
    )
