"""Fixed-point iteration to the roots of the deflected arm that are far from every singularity.

The first iteration solves the orthogonal rigid arm for a virtual target: the true target, corrected by the
error of the real arm. The others are Newton steps with the springs held. The load changes little between
iterations, so few suffice; each costs one evaluation of the real arm.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.branches import fold_distances
from fsw.kinematics.closed_form import closed_form_branch
from fsw.kinematics.newton import damped_solution
from fsw.kinematics.soft_limits import limit_excess, wrap_into_limits
from fsw.kinematics.task import approach_jacobian, evaluate_pose
from fsw.kinematics.transforms import Array, Flags, norm

DEFLECTED_TOLERANCE: Final = 2e-8
"""Tolerance of a root of the deflected arm: position [m], axis [rad] and change of strain."""
RIGID_TOLERANCE: Final = 2e-10
"""Tolerance of a root of the rigid arm, same units."""
CLEAR_OF_FOLD: Final = 0.3
"""Fold distance below which the tolerance falls with its square.

There the joint angles change by more than the tool does.
"""
MAX_ITERATIONS: Final = 20
LIMIT_MARGIN_RAD: Final = 0.03
"""Excess over the limits up to which a root is followed after the first iteration."""
NEAR_FOLD: Final = 0.2
"""The same excess for a root this close to a fold [m, sine]: one iteration is less accurate."""
BLOCK: Final = 6000
"""Roots per block, to bound the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class FixedPointRoots:
    """Roots of the real arm, with the targets (n,) on the last axis."""

    output_rad: Array
    """Output angles, (5, n)."""
    torque_Nm: Array
    """Torque of the load on each output, (5, n)."""
    error: Array
    """Larger of position error [m] and axis error [rad], (n,); infinite if not selected."""
    followed: Flags
    """True if the iteration went on after its first step, (n,)."""
    converged: Flags
    """True if the error is within the tolerance, (n,)."""


def solve_fixed_point(
    arm: Arm,
    tool: str,
    p: Array,
    a: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
    fold_distance: Array,
    selected: Flags,
) -> FixedPointRoots:
    """Find the roots of the real arm on the branches of the orthogonal arm's roots.

    Args:
        arm: Arm.
        tool: Name of the tool.
        p: Target positions in m in the rover frame, shape (3, n).
        a: Approach directions, unit vectors in the rover frame, shape (3, n).
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
        start_rad: Output angles of the orthogonal arm's roots, shape (5, n).
        fold_distance: Distance of these roots from the nearest fold, in m or as a unitless sine, shape (n,).
        selected: Boolean flags of the roots to solve, shape (n,).

    Returns:
        The roots of the real arm.
    """
    n = selected.size
    tolerance = root_tolerance(gravity_R_m_s2) * np.minimum(fold_distance / CLEAR_OF_FOLD, 1.0) ** 2
    roots = FixedPointRoots(
        start_rad.copy(), np.zeros_like(start_rad), np.full(n, np.inf), selected.copy(), np.zeros(n, bool)
    )
    indices = np.flatnonzero(selected)
    for block in np.split(indices, range(BLOCK, indices.size, BLOCK)):
        targets = p.take(block, axis=-1), a.take(block, axis=-1)
        _solve_block(arm, tool, *targets, gravity_R_m_s2, tolerance[block], block, roots)
    return replace(roots, converged=roots.error < tolerance)


def root_tolerance(gravity_R_m_s2: Array) -> float:
    """Return the tolerance of a root.

    Args:
        gravity_R_m_s2: Gravity in the rover frame, shape (3,); zero for the rigid arm.

    Returns:
        Bound of position error [m], axis error [rad] and change of strain.
    """
    return DEFLECTED_TOLERANCE if gravity_R_m_s2.any() else RIGID_TOLERANCE


def _solve_block(
    arm: Arm,
    tool: str,
    p: Array,
    a: Array,
    gravity: Array,
    tolerance: Array,
    where: NDArray[np.intp],
    roots: FixedPointRoots,
) -> None:
    """Iterate the targets `where` until their error is below tolerance; write into `roots`.

    `take` and `compress` leave the roots next to each other in memory, which an index does not.
    """
    q, strain = roots.output_rad.take(where, axis=-1), None
    for iteration in range(MAX_ITERATIONS):
        evaluation = evaluate_pose(arm, tool, q, strain, gravity)
        X_RT, strain = evaluation.X_RT, evaluation.strain
        miss = np.concatenate([X_RT.p - p, X_RT.R[:, 0] - a])
        error = np.maximum(np.max(np.abs(miss), axis=0), evaluation.strain_change)
        roots.torque_Nm[:, where], roots.error[where] = evaluation.torque_Nm, error
        active = error >= tolerance
        if not active.any():
            return
        if iteration == 0:
            virtual_p, virtual_a = p - miss[:3], a - miss[3:]
            q, _ = closed_form_branch(arm.orthogonal[tool], virtual_p, virtual_a / norm(virtual_a), q)
        else:
            q = q - damped_solution(approach_jacobian(evaluation.frames, X_RT), miss)
        if not active.all():
            where, tolerance = where[active], tolerance[active]
            p, a, q, strain = (v.compress(active, axis=-1) for v in (p, a, q, strain))
        roots.output_rad[:, where] = q
        if iteration == 0:
            follow = _may_enter_limits(arm, tool, q)
            roots.followed[where] = follow
            if not follow.any():
                return
            where, tolerance = where[follow], tolerance[follow]
            p, a, q, strain = (v.compress(follow, axis=-1) for v in (p, a, q, strain))


def _may_enter_limits(arm: Arm, tool: str, q: Array) -> Flags:
    """Find the roots (5, k) that may be inside the limits, judged after one iteration."""
    fold_distance = np.abs(fold_distances(arm.orthogonal[tool], q)).min(axis=0)
    margin = np.where(fold_distance < NEAR_FOLD, NEAR_FOLD, LIMIT_MARGIN_RAD)
    may: Flags = limit_excess(arm, wrap_into_limits(arm, q)).max(axis=0) < margin
    return may
