"""Aiming off: roots of the real, hanging arm that are clear of every singularity.

The square rigid arm is told a target beside the true one, by as much as the real arm misses it. The load
changes little with the aim, so a few shots are enough, and every shot costs one closed form and one look at
the real arm.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm
from fsw.kinematics.closed_form import closed_form_branch
from fsw.kinematics.soft_limits import limit_excess, wrap_into_limits
from fsw.kinematics.task import evaluate_pose
from fsw.kinematics.transforms import Array, Flags, norm

DEFLECTED_TOLERANCE: Final = 2e-8
RIGID_TOLERANCE: Final = 2e-10
"""Of a root: position [m], axis [rad] and what strains still change. Less, by the square, where it is ..."""
CLEAR_OF_FOLD: Final = 0.3
"""... not so far from every fold, for there the angles follow the tool by more."""
MAX_ITERATIONS: Final = 12
LIMIT_MARGIN_RAD: Final = 0.03
"""After the first shot, how far outside the limits a root may be and still come in."""
NEAR_FOLD: Final = 0.2
"""The same with the elbow this close to straight or folded [sine], where one shot tells less."""
BLOCK: Final = 6000
"""Roots at a time, to bound the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class FixedPointRoots:
    """Roots of the real arm, (n,) last."""

    output_rad: Array
    """(5, n)."""
    torque_Nm: Array
    """(5, n)."""
    error: Array
    """(n,): the larger of position error [m] and axis error [rad]; infinite where not tried."""
    followed: Flags
    """Not given up after the first shot."""
    first_error: Array
    """(n,): the error of the first shot: how far the real arm is from the square one there; else 0."""


def solve_fixed_point(
    arm: Arm,
    tool: int,
    p: Array,
    a: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
    clear: Array,
    wanted: Flags,
) -> FixedPointRoots:
    """The roots of targets (3, n) on the branches of the square arm's roots (5, n), where wanted.

    `clear` (n,) is how far these are from the nearest fold.
    """
    n = wanted.size
    allowed = root_tolerance(gravity_R_m_s2) * np.minimum(clear / CLEAR_OF_FOLD, 1.0) ** 2
    aimed = FixedPointRoots(
        start_rad.copy(), np.zeros_like(start_rad), np.full(n, np.inf), wanted.copy(), np.zeros(n)
    )
    chosen = np.flatnonzero(wanted)
    for block in np.split(chosen, range(BLOCK, chosen.size, BLOCK)):
        _solve_block(arm, tool, p[:, block], a[:, block], gravity_R_m_s2, allowed[block], block, aimed)
    return aimed


def root_tolerance(gravity_R_m_s2: Array) -> float:
    """Of the roots of an arm that hangs or, without gravity, is rigid."""
    return DEFLECTED_TOLERANCE if gravity_R_m_s2.any() else RIGID_TOLERANCE


def _solve_block(
    arm: Arm,
    tool: int,
    p: Array,
    a: Array,
    gravity: Array,
    allowed: Array,
    where: NDArray[np.intp],
    aimed: FixedPointRoots,
) -> None:
    """Shots at the targets `where`, written into `aimed`, until they miss by less than allowed."""
    q, aim = aimed.output_rad[:, where], np.concatenate([p, a])
    strain = None
    for shot in range(MAX_ITERATIONS):
        tried = evaluate_pose(arm, tool, q, strain, gravity)
        miss = np.concatenate([tried.X_RT.p - p, tried.X_RT.R[:, 0] - a])
        error = np.maximum(np.max(np.abs(miss), axis=0), tried.strain_change)
        aimed.torque_Nm[:, where], aimed.error[where] = tried.torque_Nm, error
        going = error >= allowed
        if not going.any():
            return
        strain = tried.strain
        if not going.all():
            where, allowed = where[going], allowed[going]
            p, a, aim, miss, q, strain = (v[..., going] for v in (p, a, aim, miss, q, strain))
        aim = aim - miss
        q, _ = closed_form_branch(arm.orthogonal[tool], aim[:3], aim[3:] / norm(aim[3:]), q)
        aimed.output_rad[:, where] = q
        if shot == 0:
            aimed.first_error[where] = error[going]
            follow = _may_enter_limits(arm, tool, q)
            aimed.followed[where] = follow
            if not follow.any():
                return
            where, allowed = where[follow], allowed[follow]
            p, a, aim, q, strain = (v[..., follow] for v in (p, a, aim, q, strain))


def _may_enter_limits(arm: Arm, tool: int, q: Array) -> Flags:
    """Which roots (5, k), known to one shot, may be inside the limits."""
    elbow = np.sin(q[Joint.ELBOW] + arm.orthogonal[tool].theta_rad[Joint.ELBOW])
    margin = np.where(np.abs(elbow) < NEAR_FOLD, NEAR_FOLD, LIMIT_MARGIN_RAD)
    may: Flags = limit_excess(arm, wrap_into_limits(arm, q)).max(axis=0) < margin
    return may
