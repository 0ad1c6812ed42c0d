"""Poses with a nearly straight elbow: both roots are found, also beyond the reach of the orthogonal arm."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.closed_form import closed_form, fold_distances
from fsw.kinematics.ik import BranchVerdict
from fsw.kinematics.roots import BEND, MOST_MISSING_M, find_straight, solve_straight
from tests.fsw.kinematics.lab import GRAVITIES, assert_no_root_twice, solve_poses, trial_of
from tests.fsw.rig import config_of, in_limits
from validation.kinematics_trials import CLEAR_OF_FOLDS, CLEAR_SIGMA, SAME_RAD, root_distances

N = 300
CASES = pytest.mark.parametrize(
    ("name", "gravity"), [("nominal", "mars"), ("calibrated:3", "rigid"), ("calibrated:16", "tilted")]
)


def straight_poses(name, gravity):
    """Solve targets of poses with a nearly straight elbow, clear of the folds of shoulder and wrist."""
    trial, rng = trial_of(name, gravity, "drill"), np.random.default_rng(54)
    q = in_limits(config_of(), rng, 4 * N)
    q[Joint.ELBOW] = rng.uniform(-0.2, 0.2, 4 * N)
    shoulder, _, wrist = np.abs(fold_distances(trial.arm.orthogonal["drill"], q))
    return solve_poses(trial, q[:, np.minimum(shoulder, wrist) > CLEAR_OF_FOLDS][:, :N])


@CASES
def test_a_pose_with_a_nearly_straight_elbow_is_among_the_roots_of_its_target(name, gravity):
    solved = straight_poses(name, gravity)
    found = root_distances(solved.result, solved.q).min(axis=0) < SAME_RAD
    single = solved.sigma > CLEAR_SIGMA
    assert single.sum() > 0.9 * N
    assert found[single].mean() > 0.99
    assert_no_root_twice(solved.result)


@CASES
def test_poses_that_the_orthogonal_arm_does_not_reach_are_found(name, gravity):
    solved = straight_poses(name, gravity)
    missing = closed_form(solved.trial.arm, "drill", solved.p, solved.a).missing_m
    beyond = (solved.result.verdict == BranchVerdict.VALID) & (missing > 0)
    assert beyond.sum() > 5
    assert missing[beyond].max() < MOST_MISSING_M


@CASES
def test_a_root_keeps_the_shoulder_and_the_wrist_of_its_start(name, gravity):
    solved, pull = straight_poses(name, gravity), GRAVITIES[gravity]
    roots = closed_form(solved.trial.arm, "drill", solved.p, solved.a)
    straight = find_straight(roots)
    assert (np.abs(roots.from_fold[1][straight]) < BEND).all()
    gravity_R = np.zeros(3) if pull is None else pull
    found = solve_straight(solved.trial.arm, "drill", solved.p, solved.a, gravity_R, straight)
    assert found.converged.sum() > N
    shape = solved.trial.arm.orthogonal["drill"]
    before, after = (
        fold_distances(shape, q[:, found.converged])[[0, 2]] >= 0
        for q in (roots.output_rad[:, straight], found.output_rad)
    )
    np.testing.assert_array_equal(before, after)


def test_without_a_straight_elbow_nothing_is_solved():
    solved = straight_poses("nominal", "mars")
    none = np.zeros((8, solved.p.shape[1]), bool)
    found = solve_straight(solved.trial.arm, "drill", solved.p, solved.a, GRAVITIES["mars"], none)
    assert found.output_rad.shape == (5, 0)
