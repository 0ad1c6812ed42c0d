"""Roots of the square arm so close to a singularity that the real arm may have others there, or none."""

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
"""How far outside the limits a root of the square arm may be and still matter."""
CANDIDATE_MARGIN: Final = 0.04
ERROR_FACTOR: Final = 3.0
"""A root this close to a fold of the shoulder [m] or elbow [sine], or an approach this close to the pitch
axes [sine] is a candidate: that much, and so many times what the wrist has to move after the first iteration,
or for the pitch axes the error of that iteration."""
RIGID_ERROR: Final = 0.01
ERROR_S2: Final = 0.01
"""Where there was no shot, what it is taken to miss: that much, and so much for each m/s2 of gravity."""
FAR_M: Final = 0.5
"""Farther out of the square arm's reach than this, no deflection and no free wrist brings a target."""
REACH_FACTOR: Final = 2.0
"""A target is out of reach if more is missing than so many times what the wrist has to move, ..."""
ITERATIONS: Final = 2
SECOND_ORDER: Final = 2.0
NEARLY_M: Final = 2e-3
"""... or if after some shots more is missing than this and so many times what the last shot changed; ..."""
FAR_MOVED_M: Final = 0.05
"""... but where the wrist has to move by more than this, shots do not tell."""


@dataclass(frozen=True, slots=True, eq=False)
class SingularityCandidates:
    """The square arm's roots of targets, and what makes them suspicious; (..., 8, n)."""

    output_rad: Array
    from_fold: Array
    """(3, 8, n), as in Roots."""
    exists: Flags
    """The square arm reaches the target."""
    is_candidate: Flags
    is_searched: Flags
    """Suspects that are more than close to a straight elbow, which is a plain fold with two sides."""
    wrist_is_free: Flags
    """The approach is nearly parallel to the pitch axes: the wrist may have any pitch."""


def find_singularity_candidates(
    arm: Arm,
    tool: int,
    p: Array,
    a: Array,
    roots: Roots,
    fixed_point: FixedPointRoots,
    over: Array,
    gravity_R_m_s2: Array,
) -> SingularityCandidates:
    """Which of the square arm's roots are so close to a singularity that the real ones are scanned for.

    Targets (3, 8 n), one for each root; so are the roots that aiming off led to, and `over`, by how much the
    square arm's are beyond their limits.
    """
    each = roots.missing_m.shape
    missing, sine = roots.missing_m.reshape(-1), roots.wrist_sine.reshape(-1)
    shape, start = arm.orthogonal[tool], roots.output_rad.reshape(5, -1)
    from_fold = roots.from_fold.reshape(3, -1)
    shoulder, elbow, _ = np.minimum(from_fold, np.abs(fold_distances(shape, fixed_point.output_rad)))
    likely = RIGID_ERROR + ERROR_S2 * norm(gravity_R_m_s2)
    miss = fixed_point.first_error.reshape(each).max(axis=0)
    miss = np.broadcast_to(np.where(miss > 0, miss, likely), each).reshape(-1)
    # a miss to the side turns the arm's plane, more so close to the fold of the shoulder; to look along the
    # approach again the turret axis turns, more so close to the pitch axes; and the wrist moves with it
    turned = miss * (1.0 + 1.0 / np.maximum(shoulder, miss))
    moved = miss + np.hypot(shape.wrist_m, shape.along_m) * turned / np.maximum(sine, miss)
    near, near_pitch_axes = CANDIDATE_MARGIN + ERROR_FACTOR * moved, CANDIDATE_MARGIN + ERROR_FACTOR * miss
    matters = over < NEAR_LIMITS_RAD
    lost = fixed_point.followed & (fixed_point.error >= root_tolerance(gravity_R_m_s2))
    free: Flags = (missing < FAR_M) & (sine < near_pitch_axes + turned)
    scanned: Flags = lost | free | ((missing < FAR_M) & (shoulder < near))
    candidate: Flags = scanned | (matters & (missing == 0) & (elbow < near))
    beyond = np.flatnonzero(matters & (missing > 0) & (missing < REACH_FACTOR * moved) & ~candidate)
    if beyond.size:
        at = (p[:, beyond], a[:, beyond], start[:, beyond], missing[beyond])
        candidate[beyond] = (moved[beyond] > FAR_MOVED_M) | _may_reach(arm, tool, *at, gravity_R_m_s2)
    flags = (missing == 0, candidate, scanned, free)
    return SingularityCandidates(
        roots.output_rad, roots.from_fold, *(each_root.reshape(each) for each_root in flags)
    )


def _may_reach(arm: Arm, tool: int, p: Array, a: Array, q: Array, missing_m: Array, gravity: Array) -> Flags:
    """Whether the real arm may reach targets (3, k) that the square one, at its nearest (5, k), does not.

    Shots as in aiming off, with the square arm aimed at what it can reach, tell how much is missing then.
    """
    aim_p, aim_a, change = p, a, missing_m
    for _ in range(ITERATIONS):
        bent = evaluate_pose(arm, tool, q, None, gravity)
        shoulder, wrist = (bent.frames.X_RL.p[:, link] for link in (Joint.ELEVATION + 1, Joint.WRIST + 1))
        reached = aim_p - missing_m * (wrist - shoulder) / norm(wrist - shoulder)
        aim_p, aim_a = p + reached - bent.X_RT.p, a + aim_a - bent.X_RT.R[:, 0]
        aim_a = aim_a / norm(aim_a)
        q, now_missing_m = closed_form_branch(arm.orthogonal[tool], aim_p, aim_a, q)
        change, missing_m = np.abs(now_missing_m - missing_m), now_missing_m
    may: Flags = missing_m < SECOND_ORDER * change + NEARLY_M
    return may
