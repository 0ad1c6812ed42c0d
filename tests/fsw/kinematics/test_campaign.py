"""No root of random targets and of targets of joint vectors is missed or wrong, on every kind of arm."""

import numpy as np
import pytest

from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from helpers.marks import slow_but
from tests.fsw.kinematics.lab import assert_consistent, assert_poses_found, assert_roots_meet, solve_poses
from validation import kinematics

EACH = 500
"""Targets, and vectors, for each tool of an arm that is drawn."""
SEED = 2024
by_case = pytest.mark.parametrize("case", kinematics.CASES, ids=lambda case: case.name.replace(" ", "-"))


def drawn_trials(case, rng):
    return (trial for _ in range(case.arms) for trial in kinematics.trials(case, rng))


@pytest.mark.slow
@by_case
def test_no_vector_is_missed_or_called_by_another_name_and_every_root_meets_its_target(case):
    rng, indistinct = np.random.default_rng(SEED), 0
    for trial in drawn_trials(case, rng):
        q, _ = kinematics.draw_vectors(trial, rng, EACH)
        solved = solve_poses(trial, q)
        assert_poses_found(solved)
        assert_roots_meet(solved, case.tolerance_m)
        lost = kinematics.root_distances(solved.result, q).min(axis=0) >= kinematics.SAME_RAD
        lost[lost] = ~kinematics.find_regular(trial, q[:, lost])
        indistinct += lost.sum()
        if trial.is_exact:
            named = (solved.result.verdict == BranchVerdict.SINGULAR).any(axis=0)
            assert (named | kinematics.claimed_roots(solved.result).any(axis=0))[lost].all()
    assert indistinct > 0 or case.arm == "skew"  # it has none or two in 2,500, as the processor rounds


@pytest.mark.slow
@by_case
def test_every_root_of_a_target_meets_it_and_at_most_four_of_the_workspace_are_valid(case):
    rng, few = np.random.default_rng(SEED), []
    for trial in drawn_trials(case, rng):
        p_m, approach, in_workspace = kinematics.draw_targets(trial, rng, EACH)
        result = inverse_kinematics(trial.arm, trial.tool, p_m, approach, trial.gravity_R_m_s2)
        assert_consistent(trial.arm, result)
        assert np.nanmax(kinematics.root_errors(trial, result, p_m, approach)) <= case.tolerance_m
        few += ((result.verdict == BranchVerdict.VALID).sum(axis=0)[in_workspace] <= 4).tolist()
    assert np.mean(few) > 0.98


@pytest.mark.parametrize(
    "case",
    slow_but(kinematics.CASES, kinematics.CASES[0], kinematics.CASES[-1]),
    ids=[case.name for case in kinematics.CASES],
)
def test_some_vectors_are_measured_from_the_double_roots_of_the_arm_as_it_is(case):
    trial = next(kinematics.trials(case, np.random.default_rng(2)))
    q, near = kinematics.draw_vectors(trial, np.random.default_rng(3), 3000)
    assert (kinematics.smallest_singular_value(trial, q[:, near > 0]) < 1e-4).sum() > 10
