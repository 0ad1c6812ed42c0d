"""Grid search: starts for targets close to a singularity, where roots of the real arm meet, part or multiply.

The azimuth and the pitch of the turret axis determine the rest of a pose. The turret points the tool as
nearly along the approach as possible, and the planar arm reaches the wrist. Two conditions remain: the
lateral position, and the angle between turret axis and approach. The search evaluates both for the real arm
on a grid over azimuth and pitch. Every node that both zero lines may pass is a start.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm, OrthogonalArm
from fsw.kinematics.closed_form import (
    closed_form,
    joint_angles,
    locate_wrist,
    to_arm_plane,
    to_shoulder_frame,
)
from fsw.kinematics.newton import damped_inverse
from fsw.kinematics.singularity_candidates import SingularityCandidates
from fsw.kinematics.task import evaluate_pose, task_error, task_jacobian
from fsw.kinematics.transforms import Array, Flags, norm, wrap_angle

PITCH_RANGE_RAD: Final = 1.0
"""Largest distance of a node from the pitch of a candidate whose wrist is not free."""
LATERAL_M: Final = 0.1
"""Largest distance of the wrist centre of a node from its lateral offset."""
CLOSE_M: Final = 0.5
"""Distance from the azimuth axis below which the fold of the shoulder is near."""
REACH_M: Final = 0.1
"""Largest distance of a node out of reach of the planar arm."""
MOST_LEAN: Final = 0.35
"""Largest error of the cosine between turret axis and approach at a node."""
LEAST_BEND_RAD: Final = 0.1
"""Least distance of a start's elbow from straight and folded, where the planar arm is singular."""
CLEAR_BEND_RAD: Final = 0.15
"""Least bend of the orthogonal arm's roots as starts.

Newton converges from the convex side of the fold, which is outside.
"""
LONGEST_STEP_RAD: Final = 0.3
"""Longest first-order correction of a node."""
AZIMUTH_AXIS, PITCH_AXIS = 2, 3
"""Axes of the grid (target, shoulder, azimuth, pitch, elbow)."""
SLACK: Final = 1.0
"""A zero line may pass a node whose value is below this share of its change to the neighbours."""
BLOCK: Final = 2000
"""Nodes per block, to bound the memory."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Numbers of nodes."""

    azimuths: int
    """Number of azimuths of each shoulder."""
    pitches: int
    """Number of pitches of the turret axis."""

    def pitch_rad(self) -> Array:
        """List the pitches.

        Returns:
            Angles, evenly over a turn, shape (k,).
        """
        return np.linspace(0.0, 2 * np.pi, self.pitches, endpoint=False)


@dataclass(frozen=True, slots=True, eq=False)
class NewtonStarts:
    """Starts of the Newton iteration, (k) last."""

    output_rad: Array
    """Output angles, (5, k)."""
    target: NDArray[np.intp]
    """Target index of each start, (k,)."""


def search_grid(
    arm: Arm,
    tool: str,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    candidates: SingularityCandidates,
    grid: Grid,
) -> NewtonStarts:
    """Find starts close to every root near the candidates.

    Args:
        arm: Arm.
        tool: Name of the tool.
        p_RoTo_R_m: Target positions in the rover frame, shape (3, n).
        approach_R: Approach directions, unit vectors in the rover frame, shape (3, n).
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
        candidates: Singularity candidates of these targets.
        grid: Numbers of nodes.

    Returns:
        The starts.
    """
    nodes, place, shape = _nodes(arm.orthogonal[tool], p_RoTo_R_m, approach_R, candidates, grid)
    target = np.unravel_index(place, shape)[0]
    conditions = np.full((2, math.prod(shape)), np.nan)
    for block in np.split(np.arange(place.size), range(BLOCK, place.size, BLOCK)):
        p, a = p_RoTo_R_m[:, target[block]], approach_R[:, target[block]]
        nodes[:, block], conditions[:, place[block]] = _evaluate_nodes(
            arm, tool, p, a, gravity_R_m_s2, nodes[:, block]
        )
    near = _zero_lines_pass(conditions, place, shape)
    # few nodes reach with a nearly straight elbow: the roots of the orthogonal arm serve as starts there
    orthogonal_rad = closed_form(arm, tool, p_RoTo_R_m, approach_R, CLEAR_BEND_RAD).output_rad[
        :, candidates.is_candidate
    ]
    return NewtonStarts(
        np.concatenate([orthogonal_rad, nodes[:, near]], axis=1),
        np.concatenate([np.nonzero(candidates.is_candidate)[1], target[near]]),
    )


def _nodes(
    s: OrthogonalArm, p_m: Array, approach: Array, candidates: SingularityCandidates, grid: Grid
) -> tuple[Array, NDArray[np.intp], tuple[int, ...]]:
    """Compute poses (5, k) of the orthogonal arm at relevant nodes, their flat indices, and the grid shape.

    The grid has one more azimuth, which is empty. The indices of neighbours may therefore wrap at both ends.
    """
    p, a = to_shoulder_frame(s, p_m, approach)
    q1 = _azimuths(s, p - s.radius_m * a, grid)[..., None]
    p, a = (v.reshape(3, -1, 1, 1, 1) for v in (p, a))
    t_e, t_z = -np.sin(grid.pitch_rad()), np.cos(grid.pitch_rad())
    lean = (a[0] * np.cos(q1) + a[1] * np.sin(q1)) * t_e + a[2] * t_z
    is_relevant = (np.abs(lean - s.boresight_z) < MOST_LEAN) & _near_candidates(
        s, candidates, grid.pitch_rad()
    )
    k, shoulder, azimuth, pitch = np.nonzero(is_relevant)
    p, a, q1 = p[:, k, 0, 0, 0], a[:, k, 0, 0, 0], q1[k, shoulder, azimuth, 0]
    t_e, t_z, lean = t_e[pitch], t_z[pitch], lean[k, shoulder, azimuth, pitch]
    z5 = np.stack([t_e * np.cos(q1), t_e * np.sin(q1), t_z])
    look = a - lean * z5
    b = s.boresight_z * z5 + np.sqrt(1 - s.boresight_z**2) / norm(look) * look
    foot_P, b_P = to_arm_plane(q1, p - s.radius_m * b, b)
    sine = b_P[0] * t_z - b_P[2] * t_e
    lateral = foot_P[1] + s.offset_m * sine - s.lateral_m
    reach = locate_wrist(s, foot_P, b_P, t_e, t_z)
    bend = np.clip(reach.bend_rad, LEAST_BEND_RAD, np.pi - LEAST_BEND_RAD)
    # far from the fold of the shoulder, the lateral condition is nearly linear in the azimuth
    lateral_bound = np.where(np.hypot(foot_P[0], foot_P[1]) < CLOSE_M, 1.5 * LATERAL_M, 0.5 * LATERAL_M)
    near = np.flatnonzero((np.abs(lateral) < lateral_bound) & (reach.missing_m < REACH_M))
    elbows = [
        joint_angles(s, b_P[1], q1, t_e, t_z, sine, replace(reach, bend_rad=side * bend))[:, near]
        for side in (1, -1)
    ]
    shape = (*is_relevant.shape[:2], grid.azimuths + 1, grid.pitches, 2)
    place = np.ravel_multi_index((k, shoulder, azimuth, pitch, np.zeros_like(k)), shape)[near]
    return np.concatenate(elbows, axis=1), np.concatenate([place, place + 1]), shape


def _near_candidates(s: OrthogonalArm, candidates: SingularityCandidates, pitch_rad: Array) -> Flags:
    """Find nodes (n, shoulder, 1, pitch) with the shoulder of a searched candidate and a pitch near it."""
    q = candidates.output_rad
    pitch = np.sum(q[Joint.ELEVATION : Joint.TURRET] + s.theta_rad[1:4, None, None], axis=0)
    distance = np.abs(wrap_angle(pitch_rad.reshape(-1, 1, 1) - pitch))
    near = candidates.is_searched & (candidates.wrist_is_free | (distance < PITCH_RANGE_RAD))
    by_shoulder: Flags = np.any(near.reshape(pitch_rad.size, 2, 4, -1), axis=2)
    return np.moveaxis(by_shoulder, (0, 2), (2, 0))[:, :, None]


def _azimuths(s: OrthogonalArm, foot: Array, grid: Grid) -> Array:
    """Compute azimuths (n, shoulder, azimuth) around those at which the foot has its lateral offset."""
    rho, heading = np.hypot(foot[0], foot[1]), np.arctan2(foot[1], foot[0])
    low, high = (
        np.arcsin(
            np.clip((s.lateral_m + side * (LATERAL_M + abs(s.offset_m))) / np.maximum(rho, 1e-9), -1.0, 1.0)
        )
        for side in (-1, 1)
    )
    lean = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, grid.azimuths)
    azimuth: Array = heading[:, None, None] + np.stack([lean, np.pi - lean], axis=1)
    return azimuth


def _evaluate_nodes(arm: Arm, tool: str, p: Array, a: Array, gravity: Array, q: Array) -> tuple[Array, Array]:
    """Correct nodes (5, k) in plane and turret to first order, and evaluate the two conditions (2, k)."""
    evaluation = evaluate_pose(arm, tool, q, None, gravity)
    to_turret_axis, s = _toward_turret_axis(arm, tool), arm.orthogonal[tool]
    q1 = q[Joint.AZIMUTH] + s.theta_rad[Joint.AZIMUTH]

    def split(v: Array) -> tuple[Array, Array]:
        """Split into in-plane position and turret error, and the two conditions."""
        ((forward, lateral, down),) = to_arm_plane(q1, np.einsum("ji,j...->i...", s.X_R1.R, v[:3]))
        axis, turret = np.einsum("ij,j...->i...", to_turret_axis, v[3:])
        return np.stack([forward, down, turret]), np.stack([lateral, axis])

    residual, conditions = split(task_error(evaluation.X_RT, p, a))
    planar = [Joint.ELEVATION, Joint.ELBOW, Joint.TURRET]
    J, J_conditions = split(task_jacobian(evaluation.frames, evaluation.X_RT, a)[:, planar])
    step = -np.einsum("ij...,j...->i...", damped_inverse(J), residual)
    step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(np.max(np.abs(step), axis=0), 1e-300))
    q = q.copy()
    q[planar] += step
    return q, conditions + np.einsum("ij...,j...->i...", J_conditions, step)


def _toward_turret_axis(arm: Arm, tool: str) -> Array:
    """Compute the rotation (2, 2) that turns the tool's y axis nearest to the turret axis."""
    y, z = arm.X_FT[tool].R[2, 1:] / np.hypot(*arm.X_FT[tool].R[2, 1:])
    return np.array([[y, z], [z, -y]])


def _zero_lines_pass(conditions: Array, flat_index: NDArray[np.intp], grid: tuple[int, ...]) -> Flags:
    """Find the nodes (k,) of the flat grid where both conditions (2, ...) may vanish nearby."""
    here, place = conditions[:, flat_index], np.array(np.unravel_index(flat_index, grid))
    change = np.zeros_like(here)
    for axis in (AZIMUTH_AXIS, PITCH_AXIS):
        step = np.equal(np.arange(len(grid)), axis).astype(int)[:, None]
        sides = [np.ravel_multi_index(tuple(place + side * step), grid, mode="wrap") for side in (1, -1)]
        change += np.nan_to_num(np.fmax(*(np.abs(conditions[:, side] - here) for side in sides)))
    passes: Flags = np.all(np.abs(here) <= SLACK * change, axis=0)
    return passes
