"""The grid search near singularities: starts close to every root, and the roots from them."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.kinematics.closed_form import closed_form
from fsw.kinematics.grid_search import search_grid
from fsw.kinematics.near_singular import MOST_ROOTS, QUICK, FoundRoots, find_near_singular_roots
from fsw.kinematics.singularity_candidates import SingularityCandidates
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.kinematics.lab import CLEAR_SIGMA, SAME_RAD, near_double_roots

N = 60
CASES = pytest.mark.parametrize(
    ("name", "gravity"), [("nominal", "mars"), ("calibrated:3", "rigid"), ("calibrated:3", "tilted")]
)


def all_candidates(solved):
    roots = closed_form(solved.trial.arm, solved.trial.tool, solved.p, solved.a)
    every = np.ones(roots.missing_m.shape, bool)
    return SingularityCandidates(roots.output_rad, roots.from_fold, roots.missing_m == 0, every, every, every)


def gravity_of(solved):
    return np.zeros(3) if solved.trial.gravity_R_m_s2 is None else solved.trial.gravity_R_m_s2


def nothing_known(n):
    return FoundRoots(np.full((5, 8, n), np.nan), np.zeros((5, 8, n)), np.full((8, n), np.nan))


@CASES
def test_there_are_starts_for_every_target_and_one_near_every_original_pose(name, gravity):
    solved = near_double_roots(name, gravity, "drill", N)
    starts = search_grid(
        solved.trial.arm,
        "drill",
        solved.p,
        solved.a,
        gravity_of(solved),
        all_candidates(solved),
        QUICK.grid,
    )
    assert np.isfinite(starts.output_rad).all()
    assert set(starts.target) == set(range(N))
    nearest = [
        np.abs(wrap_angle(starts.output_rad[:, starts.target == k] - solved.q[:, [k]])).max(axis=0).min()
        for k in range(N)
    ]
    assert max(nearest) < 0.6


def test_without_candidates_there_are_no_starts():
    solved = near_double_roots("nominal", "mars", "drill", N)
    none = np.zeros((8, N), bool)
    candidates = replace(all_candidates(solved), is_candidate=none, is_searched=none, wrist_is_free=none)
    starts = search_grid(
        solved.trial.arm, "drill", solved.p, solved.a, gravity_of(solved), candidates, QUICK.grid
    )
    assert starts.output_rad.shape == (5, 0)
    assert starts.target.shape == (0,)


@CASES
def test_with_nothing_known_the_original_poses_are_found(name, gravity):
    solved = near_double_roots(name, gravity, "drill", N)
    found = find_near_singular_roots(
        solved.trial.arm,
        "drill",
        solved.p,
        solved.a,
        gravity_of(solved),
        all_candidates(solved),
        nothing_known(N),
    )
    slots = found.error.shape[0]
    assert slots in range(8, 8 * MOST_ROOTS + 1, 8)
    distance = np.abs(wrap_angle(found.output_rad - solved.q[:, None])).max(axis=0)
    clear = solved.sigma > CLEAR_SIGMA
    assert np.where(np.isnan(distance), np.inf, distance).min(axis=0)[clear].max() < SAME_RAD
    is_root = np.isfinite(found.error)
    assert (np.isfinite(found.output_rad) == is_root).all()


def test_known_roots_that_are_not_candidates_are_kept_as_they_are():
    """The angles are equal bit for bit, in any slot."""
    solved = near_double_roots("nominal", "mars", "drill", N)
    known = solved.result
    first = FoundRoots(known.output_rad[:, :8], known.torque_Nm[:, :8], known.error[:8])
    none = np.zeros((8, N), bool)
    candidates = replace(all_candidates(solved), is_candidate=none, is_searched=none, wrist_is_free=none)
    kept = find_near_singular_roots(
        solved.trial.arm, "drill", solved.p, solved.a, gravity_of(solved), candidates, first
    )
    for k in range(N):
        before, after = (set(v.output_rad[0, :, k][np.isfinite(v.error[:, k])]) for v in (first, kept))
        assert before == after
