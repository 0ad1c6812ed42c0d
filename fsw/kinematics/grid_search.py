"""Starts for targets close to a singularity, where roots of the real arm meet, part or multiply.

With the azimuth and the pitch of the turret axis given, the rest of a pose follows: the turret looks as
nearly along the approach as it can, and the planar arm reaches the wrist. Two conditions are left: the
lateral one and that the turret axis is square to the approach. Both are looked at on a grid over the torus
of azimuth and pitch, at the real arm, and wherever their zero lines may both pass a node, the node is a
start.
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
"""How far from the pitch of a candidate with a wrist that is not free a node may be."""
LATERAL_M: Final = 0.1
"""How far from its lateral offset the wrist centre of a node may be."""
CLOSE_M: Final = 0.5
"""Closer to the azimuth axis than this, the shoulder's fold is near."""
REACH_M: Final = 0.1
"""How far out of the planar arm's reach a node may be."""
MOST_LEAN: Final = 0.35
"""How far from its angle with the approach (cosine) the turret axis of a node may be."""
LEAST_BEND_RAD: Final = 0.1
"""Starts keep the elbow this far from straight and folded, where the planar arm is singular."""
CLEAR_BEND_RAD: Final = 0.15
"""The same for the square arm's roots: from outside, on the convex side of the fold, Newton converges."""
LONGEST_STEP_RAD: Final = 0.3
AZIMUTH_AXIS, PITCH_AXIS = 2, 3
"""Of the grid (target, shoulder, azimuth, pitch, elbow)."""
SLACK: Final = 1.0
"""A zero line may pass a node if the value there is below this share of its change to the neighbours."""
BLOCK: Final = 2000
"""Nodes at a time, to bound the memory."""


@dataclass(frozen=True, slots=True)
class Grid:
    """How many nodes there are."""

    azimuths: int
    """Of either shoulder."""
    pitches: int

    def pitch_rad(self) -> Array:
        """(pitches,)."""
        return np.linspace(0.0, 2 * np.pi, self.pitches, endpoint=False)


@dataclass(frozen=True, slots=True, eq=False)
class NewtonStarts:
    """Where to begin, (k) last."""

    output_rad: Array
    """(5, k)."""
    target: NDArray[np.intp]
    """(k,): of which target."""


def search_grid(
    arm: Arm,
    tool: int,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    candidates: SingularityCandidates,
    grid: Grid,
) -> NewtonStarts:
    """Starts close to every root of targets (3, n) that is near one of the candidates."""
    nodes, at, on_grid = _nodes(arm.orthogonal[tool], p_RoTo_R_m, approach_R, candidates, grid)
    target = np.unravel_index(at, on_grid)[0]
    conditions = np.full((2, math.prod(on_grid)), np.nan)
    for block in np.split(np.arange(at.size), range(BLOCK, at.size, BLOCK)):
        p, a = p_RoTo_R_m[:, target[block]], approach_R[:, target[block]]
        nodes[:, block], conditions[:, at[block]] = _evaluate_nodes(
            arm, tool, p, a, gravity_R_m_s2, nodes[:, block]
        )
    near = _zero_lines_pass(conditions, at, on_grid)
    # where the elbow is nearly straight, few nodes can reach: the square arm's own roots, from either side
    bent = closed_form(arm, tool, p_RoTo_R_m, approach_R, CLEAR_BEND_RAD).output_rad[
        :, candidates.is_candidate
    ]
    return NewtonStarts(
        np.concatenate([bent, nodes[:, near]], axis=1),
        np.concatenate([np.nonzero(candidates.is_candidate)[1], target[near]]),
    )


def _nodes(
    s: OrthogonalArm, p_m: Array, approach: Array, candidates: SingularityCandidates, grid: Grid
) -> tuple[Array, NDArray[np.intp], tuple[int, ...]]:
    """Poses (5, k) of the square arm at the nodes worth a look, where on the grid they are, and its shape.

    The places are those on the flat grid. It has one azimuth more, which is empty, so that the indices of
    neighbours may wrap at both ends.
    """
    p, a = to_shoulder_frame(s, p_m, approach)
    q1 = _azimuths(s, p - s.radius_m * a, grid)[..., None]
    p, a = (v.reshape(3, -1, 1, 1, 1) for v in (p, a))
    t_e, t_z = -np.sin(grid.pitch_rad()), np.cos(grid.pitch_rad())
    lean = (a[0] * np.cos(q1) + a[1] * np.sin(q1)) * t_e + a[2] * t_z
    worth = (np.abs(lean - s.boresight_z) < MOST_LEAN) & _near_candidates(s, candidates, grid.pitch_rad())
    k, shoulder, azimuth, pitch = np.nonzero(worth)
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
    # far from the fold of the shoulder the lateral condition is nearly linear in the azimuth
    aside = np.where(np.hypot(foot_P[0], foot_P[1]) < CLOSE_M, 1.5 * LATERAL_M, 0.5 * LATERAL_M)
    near = np.flatnonzero((np.abs(lateral) < aside) & (reach.missing_m < REACH_M))
    elbows = [
        joint_angles(s, b_P[1], q1, t_e, t_z, sine, replace(reach, bend_rad=side * bend))[:, near]
        for side in (1, -1)
    ]
    on_grid = (*worth.shape[:2], grid.azimuths + 1, grid.pitches, 2)
    place = np.ravel_multi_index((k, shoulder, azimuth, pitch, np.zeros_like(k)), on_grid)[near]
    return np.concatenate(elbows, axis=1), np.concatenate([place, place + 1]), on_grid


def _near_candidates(s: OrthogonalArm, candidates: SingularityCandidates, pitch_rad: Array) -> Flags:
    """Which nodes, (n, shoulder, 1, pitch), have the shoulder of a scanned candidate and a pitch near its."""
    q = candidates.output_rad
    pitch = np.sum(q[Joint.ELEVATION : Joint.TURRET] + s.theta_rad[1:4, None, None], axis=0)
    apart = np.abs(wrap_angle(pitch_rad.reshape(-1, 1, 1) - pitch))
    near = candidates.is_searched & (candidates.wrist_is_free | (apart < PITCH_RANGE_RAD))
    by_shoulder: Flags = np.any(near.reshape(pitch_rad.size, 2, 4, -1), axis=2)
    return np.moveaxis(by_shoulder, (0, 2), (2, 0))[:, :, None]


def _azimuths(s: OrthogonalArm, foot: Array, grid: Grid) -> Array:
    """Azimuths (n, shoulder, azimuth) around those at which the foot is at its lateral offset."""
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


def _evaluate_nodes(arm: Arm, tool: int, p: Array, a: Array, gravity: Array, q: Array) -> tuple[Array, Array]:
    """Nodes (5, k) with planar arm and turret put right to first order, and the two conditions (2, k)."""
    tried = evaluate_pose(arm, tool, q, None, gravity)
    to_turret_axis, s = _toward_turret_axis(arm, tool), arm.orthogonal[tool]
    q1 = q[Joint.AZIMUTH] + s.theta_rad[Joint.AZIMUTH]

    def split(v: Array) -> tuple[Array, Array]:
        """In-plane position and look, to be put right; lateral position and turret axis, the conditions."""
        ((forward, lateral, down),) = to_arm_plane(q1, np.einsum("ji,j...->i...", s.X_R1.R, v[:3]))
        axis, look = np.einsum("ij,j...->i...", to_turret_axis, v[3:])
        return np.stack([forward, down, look]), np.stack([lateral, axis])

    residual, conditions = split(task_error(tried.X_RT, p, a))
    planar = [Joint.ELEVATION, Joint.ELBOW, Joint.TURRET]
    J, J_conditions = split(task_jacobian(tried.frames, tried.X_RT, a)[:, planar])
    step = -np.einsum("ij...,j...->i...", damped_inverse(J), residual)
    step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(np.max(np.abs(step), axis=0), 1e-300))
    q = q.copy()
    q[planar] += step
    return q, conditions + np.einsum("ij...,j...->i...", J_conditions, step)


def _toward_turret_axis(arm: Arm, tool: int) -> Array:
    """The rotation (2, 2) of the tool's y and z axes that brings the first nearest to the turret axis."""
    y, z = arm.X_FT[tool].R[2, 1:] / np.hypot(*arm.X_FT[tool].R[2, 1:])
    return np.array([[y, z], [z, -y]])


def _zero_lines_pass(conditions: Array, at: NDArray[np.intp], grid: tuple[int, ...]) -> Flags:
    """At which nodes (k,) of the flat grid both conditions (2, ...) may vanish close by."""
    here, place = conditions[:, at], np.array(np.unravel_index(at, grid))
    change = np.zeros_like(here)
    for axis in (AZIMUTH_AXIS, PITCH_AXIS):
        ahead = np.equal(np.arange(len(grid)), axis).astype(int)[:, None]
        sides = [np.ravel_multi_index(tuple(place + side * ahead), grid, mode="wrap") for side in (1, -1)]
        change += np.nan_to_num(np.fmax(*(np.abs(conditions[:, side] - here) for side in sides)))
    passes: Flags = np.all(np.abs(here) <= SLACK * change, axis=0)
    return passes
