"""All roots of targets close to a singularity: scanned for, refined, told apart, put into slots."""

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
"""Roots closer than this are one root, found twice."""
CLOSE_RAD: Final = 1e-2
"""Roots closer than this may be one, if the pose between them is a root as well."""
CHECK_PASSES: Final = 4
MOST_ROOTS: Final = 8
"""Roots of one branch that are kept; more were never met."""
UNFOLLOWED_RAD: Final = 0.15
"""How far a root may be from the square arm's that was not followed, to be that one."""


@dataclass(frozen=True, slots=True)
class SearchEffort:
    """How hard to look."""

    grid: Grid
    patience: int


QUICK: Final = SearchEffort(Grid(azimuths=8, pitches=24), patience=15)
THOROUGH: Final = SearchEffort(Grid(azimuths=24, pitches=64), patience=40)


@dataclass(frozen=True, slots=True, eq=False)
class FoundRoots:
    """Roots in the slots of their branches, (..., slots, n); NaN where there is none."""

    output_rad: Array
    torque_Nm: Array
    error: Array


def find_near_singular_roots(
    arm: Arm,
    tool: int,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    candidates: SingularityCandidates,
    known: FoundRoots,
) -> FoundRoots:
    """The known roots of targets (3, n) and all others near candidates, as far as the scan resolves them.

    Roots come and go in pairs, so the real arm has an odd number of them near an odd number of candidates.
    Where it has not, one was missed, and the search is repeated thoroughly.
    """
    targets = _Targets(arm, tool, p_RoTo_R_m, approach_R, gravity_R_m_s2, candidates)
    found, odd = targets.search(QUICK, known)
    again = np.flatnonzero(odd)
    if not again.size:
        return found
    more, _ = targets.only(again).search(THOROUGH, select_targets(found, again))
    slots = max(found.error.shape[0], more.error.shape[0])
    return replace_targets(_pad_roots(found, slots), again, _pad_roots(more, slots))


def _pad_roots(found: FoundRoots, slots: int) -> FoundRoots:
    return FoundRoots(
        pad_slots(found.output_rad, slots, np.nan),
        pad_slots(found.torque_Nm, slots, 0.0),
        pad_slots(found.error, slots, np.nan),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Targets:
    """Targets (3, n) with candidates."""

    arm: Arm
    tool: int
    p: Array
    a: Array
    gravity_R_m_s2: Array
    candidates: SingularityCandidates

    def only(self, where: NDArray[np.intp]) -> "_Targets":
        """Some of them, every candidate to be scanned."""
        candidates = select_targets(self.candidates, where)
        every = replace(candidates, is_searched=candidates.is_candidate)
        return _Targets(self.arm, self.tool, self.p[:, where], self.a[:, where], self.gravity_R_m_s2, every)

    def search(self, search: SearchEffort, known: FoundRoots) -> tuple[FoundRoots, Flags]:
        """All roots, and which targets lack one; known roots that are no candidates stay as they are."""
        candidate = pad_slots(self.candidates.is_candidate, known.error.shape[0], True)
        is_known = np.isfinite(known.error) & np.isfinite(known.output_rad[0])
        trusted, doubtful = is_known & ~candidate, is_known & candidate
        starts = search_grid(
            self.arm, self.tool, self.p, self.a, self.gravity_R_m_s2, self.candidates, search.grid
        )
        start = np.concatenate([known.output_rad[:, doubtful], starts.output_rad], axis=1)
        of = np.concatenate([np.nonzero(doubtful)[1], starts.target])
        in_order = np.argsort(of, kind="stable")
        start, of = start[:, in_order], of[in_order]
        refined = refine_roots(
            self.arm, self.tool, self.p[:, of], self.a[:, of], self.gravity_R_m_s2, start, search.patience, of
        )
        new = refined.converged
        q = np.concatenate([known.output_rad[:, trusted], refined.output_rad[:, new]], axis=1)
        torque = np.concatenate([known.torque_Nm[:, trusted], refined.torque_Nm[:, new]], axis=1)
        error = np.concatenate([known.error[trusted], refined.error[new]])
        target = np.concatenate([np.nonzero(trusted)[1], of[new]])
        slot = np.concatenate([np.nonzero(trusted)[0], np.full(int(new.sum()), -1)])
        root = self._distinct(q, error, target, slot)
        q, torque, error, target, slot = (v[..., root] for v in (q, torque, error, target, slot))
        odd = self._is_odd(trusted, q[:, slot < 0], target[slot < 0])
        slot = _assign_slots(self.arm.orthogonal[self.tool], self.candidates, q, target, slot)
        return self._in_slots(q, torque, error, target, slot), odd

    def _distinct(
        self, q: Array, error: Array, target: NDArray[np.intp], slot: NDArray[np.int64]
    ) -> NDArray[np.intp]:
        """The indices of the different roots among (5, k), by target: of each the known one, or the best.

        Two are the same if they are as close as steps converge, or if the pose half way is a root too: around
        a double root all poses of a small stretch meet the target within rounding.
        """
        # one number a root, the same for the same root in any turn: neighbours in its order are compared
        weight = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0])
        index = np.lexsort((weight @ np.cos(q) + weight[::-1] @ np.sin(q), target))
        step = wrap_angle(np.diff(q[:, index]))
        apart = np.max(np.abs(step), axis=0, initial=0.0)
        same_target = np.diff(target[index]) == 0
        same = same_target & (apart < SAME_RAD)
        close = np.flatnonzero(same_target & ~same & (apart < CLOSE_RAD))
        if close.size:
            half_way = q[:, index[close]] + 0.5 * step[:, close]
            same[close] = self._meets(half_way, target[index[close]])
        cluster = np.concatenate([[0], np.cumsum(~same)])[: index.size]
        index = index[np.lexsort((error[index], slot[index] < 0, cluster))]
        _, first = np.unique(cluster, return_index=True)
        return index[first]

    def _meets(self, q: Array, target: NDArray[np.intp]) -> Flags:
        """Whether poses (5, k) are roots, within rounding."""
        strain = None
        for _ in range(CHECK_PASSES):
            tried = evaluate_pose(self.arm, self.tool, q, strain, self.gravity_R_m_s2)
            strain = tried.strain
        error = np.max(np.abs(task_error(tried.X_RT, self.p[:, target], self.a[:, target])), axis=0)
        meets: Flags = error < 2 * ROOT_TOLERANCE
        return meets

    def _is_odd(self, trusted: Flags, q: Array, target: NDArray[np.intp]) -> Flags:
        """Whether the number of new roots (5, k) of a target is not that of its candidates, but for pairs."""
        s = self.candidates
        unfollowed = s.exists & ~s.is_candidate & ~trusted[: len(BRANCHES)]
        is_one = (_distance_to_orthogonal(s, q, target) < UNFOLLOWED_RAD) & unfollowed[:, target].T
        number = np.bincount(target[~is_one.any(axis=1)], minlength=self.p.shape[1])
        odd: Flags = (number - (s.exists & s.is_candidate).sum(axis=0)) % 2 == 1
        return odd

    def _in_slots(
        self, q: Array, torque: Array, error: Array, target: NDArray[np.intp], slot: NDArray[np.int64]
    ) -> FoundRoots:
        """The roots (..., k) where they belong."""
        n, slots = self.p.shape[1], len(BRANCHES) * (1 + int(slot.max(initial=0)) // len(BRANCHES))
        nothing = FoundRoots(
            np.full((5, slots, n), np.nan), np.zeros((5, slots, n)), np.full((slots, n), np.nan)
        )
        kept = slot >= 0
        at = (slot[kept], target[kept])
        nothing.output_rad[:, *at], nothing.torque_Nm[:, *at] = q[:, kept], torque[:, kept]
        nothing.error[at] = error[kept]
        return nothing


def _distance_to_orthogonal(candidates: SingularityCandidates, q: Array, target: NDArray[np.intp]) -> Array:
    """(k, 8): how far poses (5, k) are from the square arm's roots of their targets."""
    square = np.swapaxes(candidates.output_rad[:, :, target], 1, 2)
    apart: Array = np.max(np.abs(wrap_angle(q[:, :, None] - square)), axis=0)
    return apart


def _assign_slots(
    s: OrthogonalArm,
    candidates: SingularityCandidates,
    q: Array,
    target: NDArray[np.intp],
    known: NDArray[np.int64],
) -> NDArray[np.int64]:
    """The slot of every root (5, k): that of a candidate, of its branch or near it, else a further one.

    Roots whose slot is known keep it. -1 where a branch is full.
    """
    slot = known.copy()
    new = np.flatnonzero(known < 0)
    apart = _distance_to_orthogonal(candidates, q[:, new], target[new])
    # a root that was not followed, as it is far outside the limits, may have been found by the way
    unfollowed = candidates.exists & ~candidates.is_candidate
    near_one: Flags = np.logical_and(unfollowed[:, target[new]].T, apart < UNFOLLOWED_RAD)
    apart[~(candidates.is_candidate[:, target[new]].T | near_one)] = np.inf
    home = branch_index(fold_distances(s, q[:, new]))
    of_branch: Flags = np.equal(np.arange(len(BRANCHES)), home[:, None])
    taken = {(int(k), int(branch)) for k, branch in zip(target[known >= 0], known[known >= 0], strict=True)}
    at_home: Flags = np.where(np.any(near_one, axis=1, keepdims=True), near_one, of_branch)
    for k, branch in sorted(np.ndindex(apart.shape), key=lambda at: (not at_home[at], float(apart[at]))):
        of = int(target[new[k]])
        if np.isfinite(apart[k, branch]) and slot[new[k]] < 0 and (of, branch) not in taken:
            slot[new[k]] = branch
            taken.add((of, branch))
    for k in np.flatnonzero(slot[new] < 0):
        of = int(target[new[k]])
        further = (int(home[k]) + len(BRANCHES) * count for count in range(1, MOST_ROOTS))
        slot[new[k]] = next((choice for choice in further if (of, choice) not in taken), -1)
        taken.add((of, int(slot[new[k]])))
    return slot
