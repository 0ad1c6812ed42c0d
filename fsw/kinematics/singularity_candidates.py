"""Singularity candidates: orthogonal roots near which the real arm may have other roots, or none."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm
from fsw.kinematics.branches import fold_distances
from fsw.kinematics.closed_form import Roots, closed_form_branch
from fsw.kinematics.fixed_point import FixedPointRoots, root_tolerance
from fsw.kinematics.task import evaluate_pose
from fsw.kinematics.transforms import Array, Flags, norm

NEAR_LIMITS_RAD: Final = 0.35
"""Excess over the limits up to which a root of the orthogonal arm is considered."""
CANDIDATE_MARGIN: Final = 0.04
ERROR_FACTOR: Final = 3.0
"""Distance from a fold below which a root is a candidate: CANDIDATE_MARGIN + ERROR_FACTOR * change.

For the folds of shoulder [m] and elbow [sine], the change is the motion of the wrist after the first
iteration. For an approach near the pitch axes [sine], it is the error of that iteration.
"""
RIGID_ERROR: Final = 0.01
ERROR_S2: Final = 0.01
"""Error assumed where no iteration was made: RIGID_ERROR + ERROR_S2 * gravity in m/s2."""
FAR_M: Final = 0.5
"""Beyond this distance out of reach, neither deflection nor a free wrist brings a target into reach."""
REACH_FACTOR: Final = 2.0
"""A target is out of reach if it misses by more than this factor times the motion of the wrist."""
ITERATIONS: Final = 2
"""Iterations of the reach check."""
SECOND_ORDER: Final = 2.0
NEARLY_M: Final = 2e-3
"""A target is out of reach if it then misses by more than NEARLY_M + SECOND_ORDER * last change."""
FAR_MOVED_M: Final = 0.05
"""If the wrist moves by more than this, the iterations decide nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class SingularityCandidates:
    """Roots of the orthogonal arm with their distance from singularities, (..., 8, n)."""

    output_rad: Array
    """Output angles, (5, 8, n)."""
    from_fold: Array
    """Distances from the folds as in Roots, (3, 8, n)."""
    exists: Flags
    """True if the orthogonal arm reaches the target."""
    is_candidate: Flags
    """True if the root is a candidate."""
    is_searched: Flags
    """True for candidates of the grid search; a nearly straight elbow alone needs none."""
    wrist_is_free: Flags
    """True if the approach is nearly parallel to the pitch axes: any wrist pitch is possible."""


def find_singularity_candidates(
    arm: Arm,
    tool: str,
    p: Array,
    a: Array,
    roots: Roots,
    fixed_point: FixedPointRoots,
    over: Array,
    gravity_R_m_s2: Array,
) -> SingularityCandidates:
    """Find the roots of the orthogonal arm that are close to a singularity.

    Args:
        arm: Arm.
        tool: Name of the tool.
        p: Target position of each root in m in the rover frame, shape (3, k), k = 8 n.
        a: Approach direction of each root, unit vector in the rover frame, shape (3, k).
        roots: Roots of the orthogonal arm, batch (n,).
        fixed_point: Roots of the real arm, batch (k,).
        over: Excess of the orthogonal arm's roots over their limits in rad, shape (k,).
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).

    Returns:
        The candidates of each target.
    """
    batch = roots.missing_m.shape
    missing, sine = roots.missing_m.reshape(-1), roots.wrist_sine.reshape(-1)
    shape, start = arm.orthogonal[tool], roots.output_rad.reshape(5, -1)
    from_fold = roots.from_fold.reshape(3, -1)
    shoulder, elbow, _ = np.minimum(from_fold, np.abs(fold_distances(shape, fixed_point.output_rad)))
    likely = RIGID_ERROR + ERROR_S2 * norm(gravity_R_m_s2)
    error = fixed_point.first_error.reshape(batch).max(axis=0)
    error = np.broadcast_to(np.where(error > 0, error, likely), batch).reshape(-1)
    # a lateral error turns the plane of the arm, more so near the fold of the shoulder; the turret axis then
    # turns back towards the approach, more so near the pitch axes; and the wrist moves with it
    turn = error * (1.0 + 1.0 / np.maximum(shoulder, error))
    moved = error + np.hypot(shape.wrist_m, shape.along_m) * turn / np.maximum(sine, error)
    near, near_pitch_axes = CANDIDATE_MARGIN + ERROR_FACTOR * moved, CANDIDATE_MARGIN + ERROR_FACTOR * error
    matters = over < NEAR_LIMITS_RAD
    lost = fixed_point.followed & (fixed_point.error >= root_tolerance(gravity_R_m_s2))
    free: Flags = (missing < FAR_M) & (sine < near_pitch_axes + turn)
    searched: Flags = lost | free | ((missing < FAR_M) & (shoulder < near))
    candidate: Flags = searched | (matters & (missing == 0) & (elbow < near))
    beyond = np.flatnonzero(matters & (missing > 0) & (missing < REACH_FACTOR * moved) & ~candidate)
    if beyond.size:
        at = (p[:, beyond], a[:, beyond], start[:, beyond], missing[beyond])
        candidate[beyond] = (moved[beyond] > FAR_MOVED_M) | _may_reach(arm, tool, *at, gravity_R_m_s2)
    flags = (missing == 0, candidate, searched, free)
    return SingularityCandidates(
        roots.output_rad, roots.from_fold, *(each_root.reshape(batch) for each_root in flags)
    )


def _may_reach(arm: Arm, tool: str, p: Array, a: Array, q: Array, missing_m: Array, gravity: Array) -> Flags:
    """Find targets (3, k) that the real arm may reach but the orthogonal arm, nearest at (5, k), does not.

    Fixed-point iterations, aimed at what the orthogonal arm can reach, give the distance that then remains.
    """
    virtual_p, virtual_a, change = p, a, missing_m
    for _ in range(ITERATIONS):
        evaluation = evaluate_pose(arm, tool, q, None, gravity)
        shoulder, wrist = (
            evaluation.frames.X_RL.p[:, link] for link in (Joint.ELEVATION + 1, Joint.WRIST + 1)
        )
        reached = virtual_p - missing_m * (wrist - shoulder) / norm(wrist - shoulder)
        virtual_p, virtual_a = p + reached - evaluation.X_RT.p, a + virtual_a - evaluation.X_RT.R[:, 0]
        virtual_a = virtual_a / norm(virtual_a)
        q, now_missing_m = closed_form_branch(arm.orthogonal[tool], virtual_p, virtual_a, q)
        change, missing_m = np.abs(now_missing_m - missing_m), now_missing_m
    may: Flags = missing_m < SECOND_ORDER * change + NEARLY_M
    return may
