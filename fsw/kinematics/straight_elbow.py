"""Roots with a nearly straight elbow, where two roots meet, and just beyond the reach of the orthogonal arm.

The fixed-point iteration starts from the roots of the orthogonal arm. With a straight elbow, both elbows may
lead to the same root of the real arm. The real arm may also reach targets that the orthogonal arm misses by
some millimetres. Newton's method finds both roots from a bent elbow on either side: it converges from the
convex side of the fold.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.branches import branch_index, fold_distances
from fsw.kinematics.closed_form import Roots, closed_form
from fsw.kinematics.newton import NewtonRoots, refine_roots
from fsw.kinematics.transforms import Array, Flags

ELBOW_BIT: Final = 2
"""Bit of the elbow in the index of a branch."""
BEND: Final = 0.15
"""Sine below which an elbow is nearly straight, and least bend at the start [rad]."""
MOST_MISSING_M: Final = 0.03
"""Distance beyond the reach of the orthogonal arm within which the real arm may reach a target.

The largest was 0.014 m, over 640,000 targets of twenty calibrated arms without gravity, on Mars and Earth.
"""


def find_straight(roots: Roots) -> Flags:
    """Find the roots of the orthogonal arm with a nearly straight elbow, in reach or nearly so.

    Args:
        roots: Roots of the orthogonal arm, batch (n,).

    Returns:
        Boolean flags, shape (8, n).
    """
    straight: Flags = (roots.from_fold[1] < BEND) & (roots.missing_m < MOST_MISSING_M)
    return straight


def solve_straight(
    arm: Arm, tool: str, p: Array, a: Array, gravity_R_m_s2: Array, straight: Flags
) -> NewtonRoots:
    """Find the roots of the real arm near roots of the orthogonal arm with a nearly straight elbow.

    Args:
        arm: Arm.
        tool: Name of the tool.
        p: Target positions in m in the rover frame, shape (3, n).
        a: Approach directions, unit vectors in the rover frame, shape (3, n).
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
        straight: Boolean flags of the roots of the orthogonal arm, shape (8, n).

    Returns:
        The roots in the order of the flags that are true, batch (k,). Only a root on the same side of the
        folds of shoulder and wrist as its start is one.
    """
    slot, target = np.nonzero(straight)
    some, own = np.unique(target, return_inverse=True)
    start = closed_form(arm, tool, p[:, some], a[:, some], BEND).output_rad[:, slot, own]
    found = refine_roots(arm, tool, p[:, target], a[:, target], gravity_R_m_s2, start)
    before, after = (branch_index(fold_distances(arm.orthogonal[tool], q)) for q in (start, found.output_rad))
    return replace(found, converged=found.converged & ((before ^ after) & ~ELBOW_BIT == 0))
