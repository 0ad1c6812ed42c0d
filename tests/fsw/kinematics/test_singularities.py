"""Targets next to double roots, where roots meet, part or multiply: all are found, and none twice."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.batch import select_targets
from fsw.kinematics.branches import BRANCHES, branch_index, fold_distances
from fsw.kinematics.ik import BranchVerdict, IkResult, inverse_kinematics
from fsw.kinematics.newton import refine_roots
from fsw.kinematics.soft_limits import limit_excess
from fsw.kinematics.statics import settle_output
from fsw.kinematics.task import ROOT_TOLERANCE, task_error
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.kinematics.lab import (
    GRAVITIES,
    assert_consistent,
    assert_no_root_twice,
    assert_poses_found,
    assert_sentences,
    near_double_roots,
    solve_poses,
    trial_of,
)
from tests.fsw.rig import config_of, in_limits
from tests.marks import slow_but
from tests.tools import TOOLS
from validation.kinematics_trials import CLEAR_SIGMA, claimed_roots, root_errors, smallest_singular_value

N = 110
OVERHEAD_M = 0.02
"""A wrist this close above the elevation joint may have the name of the other elbow."""
RADIAL = [
    ("nominal", "mars", "drill"),
    ("nominal", "mars", "apxs"),
    ("nominal", "tilted", "mahli"),
    ("nominal", "tilted", "portion"),
    ("calibrated:3", "rigid", "drt"),
    ("calibrated:3", "mars", "drill"),
    ("calibrated:3", "tilted", "apxs"),
    ("calibrated:11", "rigid", "apxs"),
    ("calibrated:11", "mars", "drt"),
    ("calibrated:11", "tilted", "mahli"),
]
SKEW = [("skew:1", "mars", "drill"), ("skew:5", "tilted", "drill"), ("skew:8", "mars", "drill")]
SHORT = RADIAL[1], RADIAL[4], SKEW[0]
radial = pytest.mark.parametrize(("name", "gravity", "tool"), slow_but(RADIAL, *SHORT[:2]))
every = pytest.mark.parametrize(("name", "gravity", "tool"), slow_but([*RADIAL, *SKEW], *SHORT))


@every
def test_every_pose_that_is_not_singular_itself_is_among_the_roots_of_its_target(name, gravity, tool):
    assert_poses_found(near_double_roots(name, gravity, tool, N))


@every
def test_every_root_meets_its_target_and_no_root_is_there_twice(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    there = claimed_roots(solved.result)
    error = root_errors(solved.trial, solved.result, solved.p, solved.a)[there]
    assert error.max() < solved.tolerance
    np.testing.assert_allclose(solved.result.error[there], error, rtol=0, atol=2e-8)
    assert_no_root_twice(solved.result)


@every
def test_a_target_that_a_pose_made_has_a_root_or_a_singular_branch(name, gravity, tool):
    """At the double root itself, two roots may be one within the tolerance."""
    solved = near_double_roots(name, gravity, tool, N)
    named = solved.result.verdict == BranchVerdict.SINGULAR
    assert (claimed_roots(solved.result) | named).any(axis=0).all()


@radial
def test_every_slot_is_consistent_and_none_is_without_a_verdict(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    assert_consistent(solved.trial.arm, solved.result)
    assert not (solved.result.verdict == BranchVerdict.NOT_CONVERGED).any()
    for k in range(0, N, 5):
        assert_sentences(solved.trial.arm, select_targets(solved.result, k))


@radial
def test_torques_are_those_of_the_arm_at_rest(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    there, pull = claimed_roots(solved.result), solved.trial.gravity_R_m_s2
    if pull is None:
        assert not solved.result.torque_Nm.any()
    else:
        at_rest = settle_output(solved.trial.arm, solved.result.output_rad[:, there], pull)
        np.testing.assert_allclose(solved.result.torque_Nm[:, there], at_rest.torque_Nm, rtol=0, atol=1e-4)


@radial
def test_a_root_clear_of_the_folds_is_in_a_slot_of_its_own_branch(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    shape, q = solved.trial.arm.orthogonal[tool], solved.result.output_rad
    upper = q[Joint.ELEVATION] + shape.theta_rad[Joint.ELEVATION]
    fore = upper + q[Joint.ELBOW] + shape.theta_rad[Joint.ELBOW]
    ahead_m = np.abs(shape.upper_m * np.cos(upper) + shape.fore_m * np.cos(fore))
    signs = fold_distances(shape, q)
    clear = claimed_roots(solved.result) & (np.abs(signs).min(axis=0) > 0.1) & (ahead_m > OVERHEAD_M)
    assert clear.sum() > 50
    slot = np.broadcast_to(np.arange(q.shape[1])[:, None], clear.shape)
    np.testing.assert_array_equal(branch_index(signs)[clear], slot[clear] % len(BRANCHES))


@pytest.mark.slow
def test_some_branches_next_to_double_roots_have_several_roots_and_some_roots_vanish():
    """The tests above need such targets."""
    batches = [near_double_roots(*case, N) for case in RADIAL]
    assert sum(claimed_roots(solved.result)[len(BRANCHES) :].sum() for solved in batches) > 30
    gone = [solved.result.joint[solved.result.verdict == BranchVerdict.SINGULAR] for solved in batches]
    assert set(np.concatenate(gone)) == {Joint.AZIMUTH, Joint.ELBOW, Joint.WRIST}


@pytest.mark.parametrize(("name", "gravity", "tool"), [RADIAL[0], RADIAL[4], RADIAL[5], RADIAL[9]])
def test_newton_from_a_few_hundred_random_starts_finds_no_root_that_the_result_lacks(name, gravity, tool):
    """Roots inside the limits that are not double: the grid search may have missed some."""
    solved = near_double_roots(name, gravity, tool, N)
    arm, pull = (
        solved.trial.arm,
        np.zeros(3) if solved.trial.gravity_R_m_s2 is None else solved.trial.gravity_R_m_s2,
    )
    some = np.arange(0, N, 15)
    start = in_limits(config_of(), np.random.default_rng(9), 300 * some.size)
    of = np.repeat(some, 300)
    found = refine_roots(arm, tool, solved.p[:, of], solved.a[:, of], pull, start)
    inside = found.converged & (limit_excess(arm, wrap_into(arm, found.output_rad)).max(axis=0) < -1e-4)
    q, of = found.output_rad[:, inside], of[inside]
    assert q.shape[1] > 100
    clear = smallest_singular_value(solved.trial, q) > CLEAR_SIGMA
    distance = np.abs(wrap_angle(solved.result.output_rad[:, :, of] - q[:, None])).max(axis=0)
    assert np.where(np.isnan(distance), np.inf, distance).min(axis=0)[clear].max() < 1e-6


def wrap_into(arm, q):
    middle = 0.5 * (arm.soft_min_rad + arm.soft_max_rad)[:, None]
    return middle + wrap_angle(q - middle)


ONCE_TWICE = [
    ("nominal", "mars", (2.3979, -0.0308, 0.5683), (0.5414, 0.0800, 0.8370)),
    ("calibrated:2", "rigid", (2.2891, 0.2840, 0.7820), (0.7657, 0.0523, 0.6410)),
]


@pytest.mark.parametrize(("name", "gravity", "p", "a"), ONCE_TWICE)
@pytest.mark.parametrize("tool", TOOLS)
def test_targets_that_once_had_the_same_root_in_two_slots_have_different_ones(name, gravity, p, a, tool):
    trial, approach = trial_of(name, gravity, tool), np.array(a) / np.linalg.norm(a)
    result = inverse_kinematics(
        trial.arm, tool, np.array(p)[:, None], approach[:, None], trial.gravity_R_m_s2
    )
    assert claimed_roots(result).sum() >= 2
    assert_no_root_twice(result)
    assert_consistent(trial.arm, result)


OVERHEAD = [
    # wrist right over the elevation joint and the approach nearly parallel to the pitch axes
    ("nominal", "mars", (0.64664995, -1.20267089, -0.75696808, -1.18014510, 2.15600928)),
    ("calibrated:3", "rigid", (-2.70602688, -2.23248749, 1.36372571, 1.36076790, 4.43515819)),
    ("calibrated:11", "mars", (-0.28355575, -1.00276974, -1.16686160, 1.48853998, 2.41723051)),
]


@pytest.mark.parametrize(("name", "gravity", "q"), OVERHEAD)
def test_with_the_wrist_right_over_the_elevation_joint_every_slot_has_a_root_or_a_reason(name, gravity, q):
    solved = solve_poses(trial_of(name, gravity, "drill"), np.array(q)[:, None])
    assert_poses_found(solved)
    assert not (solved.result.verdict == BranchVerdict.NOT_CONVERGED).any()
    assert_sentences(solved.trial.arm, select_targets(solved.result, 0))


@pytest.mark.parametrize(("name", "gravity", "tool"), SKEW)
def test_every_slot_of_a_deflected_skew_tool_has_a_root_or_a_reason(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    assert not (solved.result.verdict == BranchVerdict.NOT_CONVERGED).any()
    assert_consistent(solved.trial.arm, solved.result)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gravity", "tool"), [RADIAL[1], RADIAL[4], RADIAL[8], SKEW[0]])
def test_a_batch_of_hard_targets_is_its_single_targets(name, gravity, tool):
    """Verdicts and angles agree, except for roots that are double within the accuracy of Newton steps."""
    solved = near_double_roots(name, gravity, tool, N)
    for k in range(0, N, 4):
        one = inverse_kinematics(
            solved.trial.arm, tool, solved.p[:, k], solved.a[:, k], solved.trial.gravity_R_m_s2
        )
        many, own = select_targets(solved.result, k), one.verdict.shape[0]
        assert (many.verdict[own:] == BranchVerdict.ABSENT).all()
        same = many.verdict[:own] == one.verdict
        for slot in np.flatnonzero(~same):
            found = one if claimed_roots(one)[slot] else many
            assert smallest_singular_value(solved.trial, found.output_rad[:, [slot]])[0] <= CLEAR_SIGMA
        np.testing.assert_array_equal(many.joint[:own][same], one.joint[same])
        np.testing.assert_allclose(many.excess[:own][same], one.excess[same], rtol=0, atol=1e-6)
        np.testing.assert_allclose(many.error[:own][same], one.error[same], rtol=0, atol=1e-9)
        there = np.flatnonzero(claimed_roots(one) & same)
        there = there[smallest_singular_value(solved.trial, one.output_rad[:, there]) > CLEAR_SIGMA]
        for word, bound in (("output_rad", 1e-6), ("torque_Nm", 1e-3)):
            several, single = getattr(many, word)[:, there], getattr(one, word)[:, there]
            np.testing.assert_allclose(several, single, rtol=0, atol=bound)


def test_a_double_root_is_found_once():
    """Two poses are one root if the pose halfway between them meets the target as well as they do."""
    q = (
        -2.0829611948924667,
        -1.7368145427639048,
        -0.004355004684645752,
        -1.712865964694209,
        0.7505001702083764,
    )
    solved = solve_poses(trial_of("nominal", "mars", "apxs"), np.array(q)[:, None])
    roots = solved.result.output_rad[:, claimed_roots(solved.result)[:, 0], 0]
    first, second = np.triu_indices(roots.shape[1], 1)
    X = solved.trial.tool_pose(roots[:, first] + 0.5 * wrap_angle(roots[:, second] - roots[:, first]))
    error = np.abs(task_error(X, solved.p, solved.a)).max(axis=0)
    assert error.min() > ROOT_TOLERANCE


def test_two_roots_of_a_deflected_arm_a_hair_apart_are_both_found():
    """Newton steps with the strain of the previous step find neither from any start."""
    q = (
        0.8001754831805434,
        -1.6847864193559376,
        0.06949396747751735,
        2.1244899264271315,
        1.5740133885359566,
    )
    gravity = np.array([0.7960427713268317, -0.503919487662086, 3.5894152805398094])
    trial = replace(trial_of("nominal", "mars", "drill"), gravity_R_m_s2=gravity)
    solved = solve_poses(trial, np.array(q)[:, None])
    roots = solved.result.output_rad[:, claimed_roots(solved.result)[:, 0], 0]
    assert roots.shape[1] == 2
    assert np.abs(roots - np.array(q)[:, None]).max(axis=0).min() < 1e-7


def test_no_further_slots_are_made_where_no_branch_needs_them():
    for gravity in GRAVITIES:
        trial = trial_of("nominal", gravity, "apxs")
        q = np.array([[0.1, -1.0, 1.2, 1.0, 1.0]]).T
        result: IkResult = solve_poses(trial, q).result
        assert result.verdict.shape == (8, 1)
