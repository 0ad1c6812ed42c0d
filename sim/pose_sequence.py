"""Moves in free air: runs that end at rest, poses of the workspace, and quasi-static moves.

Quasi-static moves compute the rest without time steps, from equilibria of motors, gears and springs. Flight
software plans the move. Motors follow it, and the gears pull the outputs along.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.commands import BacklashMode, Command
from fsw.dictionary.enums import Frame
from fsw.dictionary.evrs import CommandCompleted, Severity
from fsw.estimate.gear import LIKELY, bound_gear, bound_loads, clip_to_backlash
from fsw.estimate.joints import uninitialised_estimate
from fsw.estimate.reference import no_reference
from fsw.kinematics.chain import frame_jacobian, tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, screw_exp
from fsw.motion.plan import Compensation, JointPositions, plan_joint_move
from sim.arms import BuiltArm
from sim.effects.environment import NothingToTouch
from sim.frames import PRIMARY, Workspace, approach_from, p_R_from_N, random_targets
from sim.loop import ClosedLoop, Setup
from sim.record import MoveDisturbance, frame_body
from sim.sequence import run_sequence

WAKE_S: Final = 1.0
"""Time before the first move, in which flight software measures gravity."""
REST_S: Final = 2.0
"""Time on the brakes before a rest position is measured."""
SOFT_LIMIT_MARGIN_RAD: Final = 0.02
"""Least distance of drawn poses from the soft limits."""


def free_air_loop(setup: Setup) -> ClosedLoop:
    """Start a run without contacts with rover, ground and rocks, which flight software knows."""
    free = NothingToTouch()
    arm = replace(setup.arm, params=free.on_params(setup.arm.params))
    loop = ClosedLoop(replace(setup, arm=arm, effects=(*setup.effects, free)))
    _run_idle(loop, WAKE_S)
    return loop


def run_and_rest(loop: ClosedLoop, command: Command) -> str | None:
    """Run a command and let the arm rest; return the warnings that prevented completion, or None."""
    evrs = [evr for record in run_sequence(loop, (command,)) for evr in record.outputs.evrs]
    if CommandCompleted(type(command).__name__) not in evrs:
        warnings = [evr.message for evr in evrs if evr.severity >= Severity.WARNING_LO]
        return "; ".join(warnings) or "it was not completed"
    _run_idle(loop, REST_S)
    return None


def _run_idle(loop: ClosedLoop, duration_s: float) -> None:
    for _ in range(round(duration_s * CYCLE_HZ)):
        loop.cycle()


def describe_no_way(arm: BuiltArm, pose_rad: Array, problem: str) -> str:
    """Say that an arm did not come to a pose, shape (5,), and why."""
    return f"{arm.name}: no way to {np.degrees(pose_rad).round(1)} deg: {problem}"


def pose_in_workspace(
    config: Config,
    rng: np.random.Generator,
    tool: str,
    branches: Collection[str],
    workspace: Workspace = PRIMARY,
) -> Array:
    """Draw targets of the workspace until one of these branches is valid; return its pose, (5,) [rad]."""
    wanted = np.array([name in branches for name in BRANCHES])
    while True:
        p_N_m, angles = random_targets(rng, 1, workspace)
        approach = approach_from(angles)[:, 0]
        solutions = inverse_kinematics(
            config.arm, tool, p_R_from_N(p_N_m[:, 0]), approach, np.zeros(3), np.zeros(5)
        )
        first_roots = solutions.verdict[: len(BRANCHES)]
        valid = np.flatnonzero(wanted & (first_roots == BranchVerdict.VALID))
        if valid.size:
            low_rad, high_rad = usual_limits_rad(config)
            return np.clip(solutions.output_rad[:, rng.choice(valid)], low_rad, high_rad)


def usual_limits_rad(config: Config) -> tuple[Array, Array]:
    """Return the least and largest output angles of drawn poses, (5,) each."""
    arm = config.arm
    return arm.soft_min_rad + SOFT_LIMIT_MARGIN_RAD, arm.soft_max_rad - SOFT_LIMIT_MARGIN_RAD


def solve_quasi_static_move(
    believed: Config,
    true: Config,
    start_rad: Array,
    pose_rad: Array,
    tool: str,
    gravity_R_m_s2: Array,
    backlash: BacklashMode,
    disturbance: MoveDisturbance,
) -> tuple[Pose, Array]:
    """Compute the pose X_RT of the tool at rest after a move, and the outputs in their backlash, (5,).

    It begins after an initialisation without errors. The disturbance displaces frames, gears and motors.
    Displaced frames are small, so that they move the tool in proportion.
    """
    reference = no_reference(believed)
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
    off_rad = true.hardstop_rad - believed.hardstop_rad + disturbance.motor_rad
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
    return Pose(moved.R @ X_RT.R, X_RT.p + shift[3:]), clip_to_backlash(true.half_backlash_rad, gear)
