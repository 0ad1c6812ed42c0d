"""Static equilibrium of the compliant arm, and the error of a tool against its target with a derivative.

Gravity load, deflection and wind-up; relative compensation counts only the difference of deflection between
two poses.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import (
    Frames,
    LinkPose,
    collect_frames,
    forward,
    joint_jacobian,
    load_links,
    place_pose,
    spring_moments,
    tool_pose,
)
from fsw.kinematics.transforms import (
    Array,
    Flags,
    Pose,
    compose,
    cross,
    dot,
    multiply_per_link,
    rotate,
    rotate_back,
)

EQUILIBRIUM_TOLERANCE = 1e-11
"""Largest change of strain [rad, m] and angle [rad] in the last pass of a converged iteration."""
MAX_PASSES = 30
LARGEST_STRAIN: Final = 1.0
"""Rotation [rad] or shift [m] of a link at which the arm counts as without equilibrium. Its springs are
linear for small angles; an iteration that diverges would overflow."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolForce:
    """Contact force on the arm at the origin of a tool."""

    tool: str
    force_R_N: Array
    """Force on the arm in the rover frame, (3,) or (3, ...)."""


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """State of the arm at rest under gravity and a contact force."""

    output_rad: Array
    """Output angles, (5, ...)."""
    strain: Array
    """Spring displacements, (6, 6, ...), rotation first, links second."""
    torque_Nm: Array
    """Torque of the load on the output of each joint, (5, ...)."""
    frames: Frames
    """Frames of the deflected arm."""
    converged: Array
    """True where the iteration converged, (...)."""


def settle(arm: Arm, motor_rad: Array, backlash_rad: Array, gravity_R_m_s2: Array) -> Equilibrium:
    """Find the static equilibrium for given motor angles: output = motor + backlash + torque / stiffness.

    Args:
        backlash_rad: Position of each output inside its backlash, shape (5, ...).
    """
    return _equilibrium(arm, motor_rad + backlash_rad, 1.0 / arm.gear_stiffness_Nm_rad, gravity_R_m_s2, None)


def settle_output(
    arm: Arm, output_rad: Array, gravity_R_m_s2: Array, push: ToolForce | None = None
) -> Equilibrium:
    """Find the static equilibrium for given output angles."""
    return _equilibrium(arm, output_rad, np.zeros_like(arm.gear_stiffness_Nm_rad), gravity_R_m_s2, push)


def _equilibrium(
    arm: Arm, anchor_rad: Array, gear_rad_Nm: Array, gravity_R_m_s2: Array, push: ToolForce | None
) -> Equilibrium:
    """Iterate load and strain; each pass reduces the error by a factor of twenty or more."""
    batch = anchor_rad.shape[1:]
    gear = gear_rad_Nm.reshape(5, *(1,) * len(batch))
    strain = np.zeros((6, 6, *batch))
    output = anchor_rad
    for _ in range(MAX_PASSES):
        _, new_strain, torque = _place_and_load(arm, output, strain, gravity_R_m_s2, push)
        new_output = anchor_rad + torque * gear
        new_strain = np.clip(new_strain, -LARGEST_STRAIN, LARGEST_STRAIN)
        step = np.maximum(
            np.abs(new_strain - strain).max(axis=(0, 1)), np.abs(new_output - output).max(axis=0)
        )
        strain, output = new_strain, new_output
        if (step < EQUILIBRIUM_TOLERANCE).all():
            break
    is_small = np.abs(strain).max(axis=(0, 1)) < LARGEST_STRAIN
    converged = (step < EQUILIBRIUM_TOLERANCE) & is_small
    return Equilibrium(output, strain, torque, forward(arm, output, strain), converged)


def load_arm(
    arm: Arm, output_rad: Array, strain: Array | None, gravity_R_m_s2: Array, push: ToolForce | None = None
) -> tuple[Frames, Array, Array]:
    """Compute spring strains and joint torques under the load: equations 4 and 5 of the paper.

    The load is taken at the deflected pose.

    Returns:
        Frames under the given strain, new strain in rad and m, shape (6, 6, ...), and torque of the load in
        N m, shape (5, ...).
    """
    placed, new_strain, torque_Nm = _place_and_load(arm, output_rad, strain, gravity_R_m_s2, push)
    return placed if isinstance(placed, Frames) else collect_frames(placed), new_strain, torque_Nm


def _place_and_load(
    arm: Arm, output_rad: Array, strain: Array | None, gravity_R_m_s2: Array, push: ToolForce | None
) -> tuple[Frames | list[LinkPose], Array, Array]:
    """Compute what `load_arm` does, with the poses of the links as they come out of it."""
    if output_rad.ndim > 1:
        frames = forward(arm, output_rad, strain)
        return frames, *_load_batch(arm, frames, gravity_R_m_s2, push)
    placed, on_tool = place_pose(arm, output_rad, strain), None
    if push is not None:
        X_RT = tool_pose(arm, collect_frames(placed), push.tool)
        on_tool = tuple(push.force_R_N.tolist()), tuple(X_RT.p.tolist())
    new_strain, torque_Nm = load_links(arm.links, placed, tuple(gravity_R_m_s2.tolist()), on_tool)
    return placed, np.array(new_strain).T, np.array(torque_Nm[1:])


def _load_batch(
    arm: Arm, frames: Frames, gravity_R_m_s2: Array, push: ToolForce | None
) -> tuple[Array, Array]:
    """Compute strain (6, 6, ...) and torque (5, ...) of a batch at the frames of the deflected arm."""
    ones = (1,) * (frames.X_RF.p.ndim - 2)
    g = gravity_R_m_s2.reshape(3, 1, *(gravity_R_m_s2.shape[1:] or ones))
    R_RL, X_LD, origin = frames.X_RL.R, frames.X_LD, frames.X_RL.p
    near_kg, far_kg, carried_kg = (kg.reshape(6, *ones) for kg in (arm.near_kg, arm.far_kg, arm.carried_kg))
    beyond_kg = carried_kg - near_kg
    # first moments of mass: of each link about its origin, then of all that it carries about the rover origin
    near_L_kg_m = near_kg * arm.near_p_L_m.reshape(3, 6, *ones)
    own_L_kg_m = np.einsum("ijl...,jl->il...", X_LD.R, arm.far_kg * arm.far_p_C_m)
    own_L_kg_m += far_kg * X_LD.p + near_L_kg_m
    carried_kg_m = rotate(R_RL, own_L_kg_m)
    carried_kg_m += (near_kg + far_kg) * origin
    # of each link and of all links beyond it
    carried_kg_m = np.add.accumulate(carried_kg_m[:, ::-1], axis=1)[:, ::-1]
    # torque about the joint axis in the link frame, then the load on the spring
    carried_kg_m -= carried_kg * origin
    lever_L_kg_m, g_L = rotate_back(R_RL, carried_kg_m), rotate_back(R_RL, g)
    torque = lever_L_kg_m[0, 1:] * g_L[1, 1:] - lever_L_kg_m[1, 1:] * g_L[0, 1:]
    lever_L_kg_m -= near_L_kg_m + beyond_kg * X_LD.p
    moment_L, force_L = cross(lever_L_kg_m, g_L), beyond_kg * g_L
    if push is not None:
        force_N = push.force_R_N.reshape(3, 1, *(push.force_R_N.shape[1:] or ones))
        push_L = rotate_back(R_RL, force_N)
        arm_L_m = rotate_back(R_RL, tool_pose(arm, frames, push.tool).p[:, None] - origin)
        torque += arm_L_m[0, 1:] * push_L[1, 1:] - arm_L_m[1, 1:] * push_L[0, 1:]
        moment_L += cross(arm_L_m - X_LD.p, push_L)
        force_L += push_L
    return _deflect_springs(arm, frames, moment_L, force_L), torque


def push_torque(arm: Arm, frames: Frames, push: ToolForce) -> Array:
    """Compute the torques (5,) [N m] of a contact force (3,) on a tool on the joints of a single pose."""
    J = joint_jacobian(frames, tool_pose(arm, frames, push.tool).p)
    torque: Array = push.force_R_N @ J[3:]
    return torque


def _deflect_springs(arm: Arm, frames: Frames, moment_L: Array, force_L: Array) -> Array:
    """Compute the strain of the springs under a load: compliance times load in the spring's coordinates."""
    wrench = np.empty((6, *force_L.shape[1:]))
    z_axis = frames.X_LD.R[:, 2]
    wrench[:3] = spring_moments((z_axis[0], z_axis[1], z_axis[2]), (moment_L[0], moment_L[1], moment_L[2]))
    wrench[3:] = force_L
    return multiply_per_link(arm.compliance, wrench.reshape(6, 6, -1)).reshape(wrench.shape)


def relative_target(
    arm: Arm,
    reference_tool: str,
    reference_rad: Array,
    gravity_R_m_s2: Array,
    p_RoTo_R_m: Array,
    approach_R: Array,
) -> tuple[Array, Array]:
    """Compute the absolute target for which only the change of deflection from a reference pose counts.

    The reference tool is known to be in place at the reference pose. The deflection there moves it from its
    rigid to its deflected pose. The target moves by the same displacement.

    Args:
        reference_rad: Output angles of the reference pose, shape (5,).

    Returns:
        Positions in m and unit approach vectors to give to the inverse kinematics, shape (3, ...) each.
    """
    rigid = tool_pose(arm, forward(arm, reference_rad), reference_tool)
    deflected = tool_pose(arm, settle_output(arm, reference_rad, gravity_R_m_s2).frames, reference_tool)
    turn = compose(deflected.R, np.swapaxes(rigid.R, 0, 1))
    ones = (1,) * (p_RoTo_R_m.ndim - 1)
    pivot, shifted = rigid.p.reshape(3, *ones), deflected.p.reshape(3, *ones)
    turn = turn.reshape(3, 3, *ones)
    return rotate(turn, p_RoTo_R_m - pivot) + shifted, rotate(turn, approach_R)


def held_on_flank(
    half_backlash_rad: Array, lowest_rad: Array, highest_rad: Array, margin_rad: Array
) -> Flags:
    """Return which outputs their load holds on a flank of the backlash.

    Args:
        lowest_rad: Lowest gear angle, output less motor, at which friction can hold the output, shape (5,).
        highest_rad: Highest such gear angle, shape (5,).
        margin_rad: Wind-up that the load must have to spare, shape (5,).

    Returns:
        True for outputs held on either flank, shape (5,).
    """
    beyond = half_backlash_rad + margin_rad
    held: Flags = (lowest_rad > beyond) | (highest_rad < -beyond)
    return held


ROOT_TOLERANCE: Final = 5e-10
"""Bound of the forward check of a root: position [m] and axis [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseEvaluation:
    """Tool pose and load of the deflected arm at given joint angles, batch (n,)."""

    frames: Frames
    """Frames under the assumed strain."""
    X_RT: Pose
    """Tool pose under the new strain, to first order."""
    strain: Array
    """Strain under the load of these frames, (6, 6, n)."""
    torque_Nm: Array
    """Torque of the load on each output, (5, n)."""
    strain_change: Array
    """Largest difference between new and assumed strain, (n,)."""


def evaluate_pose(
    arm: Arm, tool: str, output_rad: Array, strain: Array | None, gravity_R_m_s2: Array
) -> PoseEvaluation:
    """Evaluate load and deflection once at given angles: tool pose, new strain and joint torques."""
    n = output_rad.shape[1]
    if not gravity_R_m_s2.any():
        frames = forward(arm, output_rad, strain)
        X_RT = tool_pose(arm, frames, tool)
        return PoseEvaluation(frames, X_RT, np.zeros((6, 6, n)), np.zeros_like(output_rad), np.zeros(n))
    frames, new_strain, torque = load_arm(arm, output_rad, strain, gravity_R_m_s2)
    X_RT = tool_pose(arm, frames, tool)
    change = new_strain if strain is None else new_strain - strain
    strain_change = np.abs(change).reshape(36, n).max(axis=0)
    return PoseEvaluation(frames, _deflect_tool(frames, change, X_RT), new_strain, torque, strain_change)


def _deflect_tool(frames: Frames, change: Array, X_RT: Pose) -> Pose:
    """Compute the tool pose after a small change of strain (6, 6, n), to first order."""
    R_RL = frames.X_RL.R
    lever_L_m = rotate_back(R_RL, X_RT.p[:, None] - frames.X_RL.p) - frames.X_LD.p
    screw_L = change.reshape(2, 3, *change.shape[1:]).copy()
    screw_L[1] += cross(screw_L[0], lever_L_m)
    turn, shift_m = np.einsum("ijl...,kjl...->ki...", R_RL, screw_L)
    return Pose(X_RT.R + cross(turn[:, None], X_RT.R), X_RT.p + shift_m)


def task_error(X_RT: Pose, p_RoTo_R_m: Array, approach_R: Array) -> Array:
    """Compute the task error of tool poses.

    Returns:
        Position error in m, then the approach along the y and z axes of the tool in rad, shape (5, ...).
    """
    miss = X_RT.p - p_RoTo_R_m
    along = np.einsum("ij...,i...->j...", X_RT.R, np.broadcast_to(approach_R, miss.shape))
    # the opposite direction has the same zero components: a large error excludes it
    opposite = np.copysign(along[:1] < 0, along[1:2])
    return np.concatenate([miss, along[1:2] + opposite, along[2:]])


def task_jacobian(frames: Frames, X_RT: Pose, approach_R: Array) -> Array:
    """Compute the derivative (5, 5, ...) of task_error by the joint angles, with the springs held."""
    J = joint_jacobian(frames, X_RT.p)
    a = np.broadcast_to(approach_R, X_RT.p.shape)
    # (w x y) . a = w . (y x a)
    turning = [dot(cross(X_RT.R[:, k], a)[:, None], J[:3]) for k in (1, 2)]
    return np.concatenate([J[3:], np.stack(turning)])


def approach_jacobian(frames: Frames, X_RT: Pose) -> Array:
    """Compute the derivative (6, 5, ...) of position and approach of a tool by the angles, springs held."""
    J = joint_jacobian(frames, X_RT.p)
    return np.concatenate([J[3:], cross(J[:3], X_RT.R[:, :1])])
