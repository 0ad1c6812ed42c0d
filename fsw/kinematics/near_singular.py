"""Roots of targets close to a singularity: searched, refined, separated and assigned to slots."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm, OrthogonalArm
from fsw.kinematics.batch import pad_slots, replace_targets, select_targets
from fsw.kinematics.branches import BRANCHES, branch_index, fold_distances
from fsw.kinematics.grid_search import Grid, search_grid
from fsw.kinematics.newton import refine_roots
from fsw.kinematics.singularity_candidates import SingularityCandidates
from fsw.kinematics.task import ROOT_TOLERANCE, evaluate_pose, task_error
from fsw.kinematics.transforms import Array, Flags, wrap_angle

SAME_RAD: Final = 2e-5
"""Roots closer than this are one root."""
CLOSE_RAD: Final = 1e-2
"""Roots closer than this are one root if the pose halfway is a root as well."""
CHECK_PASSES: Final = 4
"""Evaluations of load and deflection in that check."""
MOST_ROOTS: Final = 8
"""Largest number of roots kept per branch; more never occurred."""
UNFOLLOWED_RAD: Final = 0.15
"""A root within this angle of an orthogonal arm's root that was not followed belongs to it."""


@dataclass(frozen=True, slots=True)
class SearchEffort:
    """Grid and number of Newton steps of a search."""

    grid: Grid
    patience: int


QUICK: Final = SearchEffort(Grid(azimuths=8, pitches=24), patience=15)
THOROUGH: Final = SearchEffort(Grid(azimuths=24, pitches=64), patience=40)


@dataclass(frozen=True, slots=True, eq=False)
class FoundRoots:
    """Roots in the slots of their branches, (..., slots, n); NaN where there is none."""

    output_rad: Array
    """Output angles, (5, slots, n)."""
    torque_Nm: Array
    """Torque of the load on each output, (5, slots, n)."""
    error: Array
    """Larger of position error [m] and axis error [rad], (slots, n)."""


def find_near_singular_roots(
    arm: Arm,
    tool: str,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    candidates: SingularityCandidates,
    known: FoundRoots,
) -> FoundRoots:
    """Find all roots near singularity candidates, as far as the grid resolves them.

    Roots appear and vanish in pairs. The real arm therefore has an odd number of roots near an odd number of
    candidates. If the parity is wrong, a root was missed, and a finer search follows.

    Args:
        arm: Arm.
        tool: Name of the tool.
        p_RoTo_R_m: Target positions in the rover frame, shape (3, n).
        approach_R: Approach directions, unit vectors in the rover frame, shape (3, n).
        gravity_R_m_s2: Gravity in the rover frame, shape (3,).
        candidates: Singularity candidates of these targets.
        known: Roots of the fixed-point iteration.

    Returns:
        The known roots and those found near the candidates.
    """
    targets = _Targets(arm, tool, p_RoTo_R_m, approach_R, gravity_R_m_s2, candidates)
    found, is_odd = targets.search(QUICK, known)
    repeated = np.flatnonzero(is_odd)
    if not repeated.size:
        return found
    further, _ = targets.only(repeated).search(THOROUGH, select_targets(found, repeated))
    slots = max(found.error.shape[0], further.error.shape[0])
    return replace_targets(_pad_roots(found, slots), repeated, _pad_roots(further, slots))


def _pad_roots(found: FoundRoots, slots: int) -> FoundRoots:
    """Pad roots to a least number of slots."""
    return FoundRoots(
        pad_slots(found.output_rad, slots, np.nan),
        pad_slots(found.torque_Nm, slots, 0.0),
        pad_slots(found.error, slots, np.nan),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Targets:
    """Targets (3, n) with singularity candidates."""

    arm: Arm
    tool: str
    p: Array
    a: Array
    gravity_R_m_s2: Array
    candidates: SingularityCandidates

    def only(self, where: NDArray[np.intp]) -> "_Targets":
        """Select some targets, with the grid search of every candidate."""
        candidates = select_targets(self.candidates, where)
        all_searched = replace(candidates, is_searched=candidates.is_candidate)
        return _Targets(
            self.arm, self.tool, self.p[:, where], self.a[:, where], self.gravity_R_m_s2, all_searched
        )

    def search(self, effort: SearchEffort, known: FoundRoots) -> tuple[FoundRoots, Flags]:
        """Find the roots, and the targets with a wrong parity; known roots that are no candidates stay."""
        candidate = pad_slots(self.candidates.is_candidate, known.error.shape[0], True)
        is_known = np.isfinite(known.error) & np.isfinite(known.output_rad[0])
        kept, repeated = is_known & ~candidate, is_known & candidate
        starts = search_grid(
            self.arm, self.tool, self.p, self.a, self.gravity_R_m_s2, self.candidates, effort.grid
        )
        start = np.concatenate([known.output_rad[:, repeated], starts.output_rad], axis=1)
        start_target = np.concatenate([np.nonzero(repeated)[1], starts.target])
        in_order = np.argsort(start_target, kind="stable")
        start, start_target = start[:, in_order], start_target[in_order]
        refined = refine_roots(
            self.arm,
            self.tool,
            self.p[:, start_target],
            self.a[:, start_target],
            self.gravity_R_m_s2,
            start,
            effort.patience,
            start_target,
        )
        new = refined.converged
        q = np.concatenate([known.output_rad[:, kept], refined.output_rad[:, new]], axis=1)
        torque = np.concatenate([known.torque_Nm[:, kept], refined.torque_Nm[:, new]], axis=1)
        error = np.concatenate([known.error[kept], refined.error[new]])
        target = np.concatenate([np.nonzero(kept)[1], start_target[new]])
        slot = np.concatenate([np.nonzero(kept)[0], np.full(int(new.sum()), -1)])
        root = self._distinct(q, error, target, slot)
        q, torque, error, target, slot = (v[..., root] for v in (q, torque, error, target, slot))
        is_odd = self._is_odd(kept, q[:, slot < 0], target[slot < 0])
        slot = _assign_slots(self.arm.orthogonal[self.tool], self.candidates, q, target, slot)
        return self._in_slots(q, torque, error, target, slot), is_odd

    def _distinct(
        self, q: Array, error: Array, target: NDArray[np.intp], slot: NDArray[np.int64]
    ) -> NDArray[np.intp]:
        """Find the indices of the distinct roots among (5, k), sorted by target.

        Two roots are equal if they agree within the accuracy of the steps, or if the pose halfway is a root
        too. Around a double root, all poses of a short interval meet the target within rounding. Of equal
        roots the known one counts, else the most accurate.
        """
        # one number per root that whole turns do not change: only neighbours in its order are compared
        weight = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0])
        index = np.lexsort((weight @ np.cos(q) + weight[::-1] @ np.sin(q), target))
        step = wrap_angle(np.diff(q[:, index]))
        distance = np.max(np.abs(step), axis=0, initial=0.0)
        same_target = np.diff(target[index]) == 0
        same = same_target & (distance < SAME_RAD)
        close = np.flatnonzero(same_target & ~same & (distance < CLOSE_RAD))
        if close.size:
            half_way = q[:, index[close]] + 0.5 * step[:, close]
            same[close] = self._meets(half_way, target[index[close]])
        cluster = np.concatenate([[0], np.cumsum(~same)])[: index.size]
        index = index[np.lexsort((error[index], slot[index] < 0, cluster))]
        _, first = np.unique(cluster, return_index=True)
        return index[first]

    def _meets(self, q: Array, target: NDArray[np.intp]) -> Flags:
        """Check that poses (5, k) are roots, within rounding."""
        strain = None
        for _ in range(CHECK_PASSES):
            evaluation = evaluate_pose(self.arm, self.tool, q, strain, self.gravity_R_m_s2)
            strain = evaluation.strain
        error = np.max(np.abs(task_error(evaluation.X_RT, self.p[:, target], self.a[:, target])), axis=0)
        meets: Flags = error < 2 * ROOT_TOLERANCE
        return meets

    def _is_odd(self, kept: Flags, q: Array, target: NDArray[np.intp]) -> Flags:
        """Find targets whose number of new roots (5, k) differs from that of candidates by an odd number."""
        candidates = self.candidates
        unfollowed = candidates.exists & ~candidates.is_candidate & ~kept[: len(BRANCHES)]
        is_one = (_distance_to_orthogonal(candidates, q, target) < UNFOLLOWED_RAD) & unfollowed[:, target].T
        number = np.bincount(target[~is_one.any(axis=1)], minlength=self.p.shape[1])
        odd: Flags = (number - (candidates.exists & candidates.is_candidate).sum(axis=0)) % 2 == 1
        return odd

    def _in_slots(
        self, q: Array, torque: Array, error: Array, target: NDArray[np.intp], slot: NDArray[np.int64]
    ) -> FoundRoots:
        """Arrange the roots (..., k) in slots."""
        n, slots = self.p.shape[1], len(BRANCHES) * (1 + int(slot.max(initial=0)) // len(BRANCHES))
        roots = FoundRoots(
            np.full((5, slots, n), np.nan), np.zeros((5, slots, n)), np.full((slots, n), np.nan)
        )
        kept = slot >= 0
        at = (slot[kept], target[kept])
        roots.output_rad[:, *at], roots.torque_Nm[:, *at] = q[:, kept], torque[:, kept]
        roots.error[at] = error[kept]
        return roots


def _distance_to_orthogonal(candidates: SingularityCandidates, q: Array, target: NDArray[np.intp]) -> Array:
    """Compute the distance [rad] of poses (5, k) from the orthogonal roots of their targets, (k, 8)."""
    orthogonal = np.swapaxes(candidates.output_rad[:, :, target], 1, 2)
    distance: Array = np.max(np.abs(wrap_angle(q[:, :, None] - orthogonal)), axis=0)
    return distance


def _assign_slots(
    s: OrthogonalArm,
    candidates: SingularityCandidates,
    q: Array,
    target: NDArray[np.intp],
    known: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Assign a slot to every root (5, k): that of a candidate of its branch or near it, else a further one.

    Roots with a known slot keep it. A root gets -1 if its branch is full.
    """
    slot = known.copy()
    new = np.flatnonzero(known < 0)
    distance = _distance_to_orthogonal(candidates, q[:, new], target[new])
    # the search may also find a root that was not followed because it is far outside the limits
    unfollowed = candidates.exists & ~candidates.is_candidate
    near_one: Flags = np.logical_and(unfollowed[:, target[new]].T, distance < UNFOLLOWED_RAD)
    distance[~(candidates.is_candidate[:, target[new]].T | near_one)] = np.inf
    own_branch = branch_index(fold_distances(s, q[:, new]))
    of_branch: Flags = np.equal(np.arange(len(BRANCHES)), own_branch[:, None])
    taken = {(int(k), int(branch)) for k, branch in zip(target[known >= 0], known[known >= 0], strict=True)}
    is_preferred: Flags = np.where(np.any(near_one, axis=1, keepdims=True), near_one, of_branch)
    for k, branch in sorted(
        np.ndindex(distance.shape), key=lambda at: (not is_preferred[at], float(distance[at]))
    ):
        its_target = int(target[new[k]])
        if np.isfinite(distance[k, branch]) and slot[new[k]] < 0 and (its_target, branch) not in taken:
            slot[new[k]] = branch
            taken.add((its_target, branch))
    for k in np.flatnonzero(slot[new] < 0):
        its_target = int(target[new[k]])
        further = (int(own_branch[k]) + len(BRANCHES) * count for count in range(1, MOST_ROOTS))
        slot[new[k]] = next((choice for choice in further if (its_target, choice) not in taken), -1)
        taken.add((its_target, int(slot[new[k]])))
    return slot
