"""Roots of the deflected arm, far from double roots and next to them, and relative to a reference pose."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import branch_index, closed_form, fold_distances
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.roots import (
    MOST_MISSING_M,
    TASK_TOLERANCE,
    FixedPointSearch,
    begin_fixed_point,
    refine_roots,
)
from fsw.kinematics.statics import relative_target, settle, settle_output, task_error
from fsw.kinematics.transforms import dot, select_targets, wrap_angle
from helpers.marks import slow_but
from tests.fsw.kinematics import lab
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits, pose_of
from tests.tools import TOOLS, tool_index
from validation import kinematics

ARMS = ["nominal", "as-built:3", "calibrated:3", "calibrated:11"]
TILTED_R_m_s2 = np.array([0.9, -1.2, 3.4])
RIGID = np.zeros(3)


def deflected_targets(config, tool, n, gravity):
    """Compute targets that the deflected arm reaches well inside its limits: outputs, positions, axes."""
    q = in_limits(config, np.random.default_rng(200 + tool_index(tool)), n, shrink=0.1)
    q[2, np.abs(q[2]) < 0.3] = 0.5
    here = settle(config.arm, q, np.zeros_like(q), gravity)
    X = tool_pose(config.arm, here.frames, tool)
    return here.output_rad, X.p, X.R[:, 0]


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("gravity", [RIGID, TILTED_R_m_s2], ids=["rigid", "tilted"])
def test_newton_solves_the_arm_at_rest_and_tells_the_error_that_is_left(name, gravity):
    config = config_of(name)
    q, p, a = deflected_targets(config, "mahli", 40, gravity)
    found = refine_roots(config.arm, "mahli", p, a, gravity, q + 0.02)
    assert found.converged.all()
    assert (found.error < TASK_TOLERANCE).all()
    at_rest = settle_output(config.arm, found.output_rad, gravity)
    X = tool_pose(config.arm, at_rest.frames, "mahli")
    assert np.abs(task_error(X, p, a)).max() < 1e-10
    np.testing.assert_allclose(found.torque_Nm, at_rest.torque_Nm, atol=1e-6)
    assert gravity.any() or not found.torque_Nm.any()


def test_a_tool_that_points_the_other_way_is_no_root():
    config = config_of()
    q, p, a = deflected_targets(config, "drill", 30, RIGID)
    found = refine_roots(config.arm, "drill", p, -a, RIGID, q)
    X = tool_pose(config.arm, forward(config.arm, found.output_rad), "drill")
    faces = dot(X.R[:, 0], -a) > 0.999
    assert not (found.converged & ~faces).any()
    assert (np.abs(task_error(X, p, X.R[:, 0])[3:]) < 1e-15).all()
    assert (np.abs(task_error(X, p, -X.R[:, 0])[3:]).max(axis=0) >= 1.0).all()


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("gravity", [RIGID, MARS_R_m_s2], ids=["rigid", "mars"])
def test_a_target_out_of_reach_or_a_start_that_is_not_finite_does_not_converge_and_raises_nothing(
    name, gravity
):
    config = config_of(name)
    q, p, a = deflected_targets(config, "apxs", 20, MARS_R_m_s2)
    for far in (p + 3.0, p + np.array([[0], [0], [50.0]]), 1e4 * p):
        found = refine_roots(config.arm, "apxs", far, a, gravity, q)
        assert not found.converged.any()
        assert (found.error[np.isfinite(found.error)] > 0.1).all()
    assert not refine_roots(config.arm, "apxs", p, a, gravity, np.full_like(q, np.nan)).converged.any()


def test_a_root_far_outside_the_limits_is_given_up_after_the_first_iteration():
    n, trial = 200, lab.trial_of("nominal", "mars", "apxs")
    q = in_limits(config_of(), np.random.default_rng(1), n, shrink=0.1)
    q[0] = trial.arm.soft_max_rad[0] + 0.3
    q[2] = np.where(np.abs(q[2]) < 0.6, 0.8, q[2])
    q[4] = np.random.default_rng(2).uniform(0.2, 1.0, n) - trial.arm.orthogonal["apxs"].clock_rad
    X = trial.tool_pose(q)
    far, every = np.ones(n), np.ones(n, bool)
    roots = begin_fixed_point(trial.arm, "apxs", X.p, X.R[:, 0], MARS_R_m_s2, q, far, every)
    while isinstance(roots, FixedPointSearch):
        roots = roots.advance()
    assert not roots.followed.any()
    # the first iteration gives a rough estimate
    assert np.quantile(np.abs(wrap_angle(roots.output_rad - q)).max(axis=0), 0.9) < 0.05


N_STRAIGHT = 300
CASES = pytest.mark.parametrize(
    ("name", "gravity"), [("nominal", "mars"), ("calibrated:3", "rigid"), ("calibrated:16", "tilted")]
)


@CASES
def test_poses_with_a_nearly_straight_elbow_are_found_even_where_the_orthogonal_arm_does_not_reach(
    name, gravity
):
    """The poses are clear of the folds of shoulder and wrist."""
    trial, rng = lab.trial_of(name, gravity, "drill"), np.random.default_rng(54)
    q = in_limits(config_of(), rng, 4 * N_STRAIGHT)
    q[Joint.ELBOW] = rng.uniform(-0.2, 0.2, 4 * N_STRAIGHT)
    shoulder, _, wrist = np.abs(fold_distances(trial.arm.orthogonal["drill"], q))
    solved = lab.solve_poses(
        trial, q[:, np.minimum(shoulder, wrist) > kinematics.CLEAR_OF_FOLDS][:, :N_STRAIGHT]
    )
    found = kinematics.root_distances(solved.result, solved.q).min(axis=0) < kinematics.SAME_RAD
    single = solved.sigma > kinematics.CLEAR_SIGMA
    assert single.sum() > 0.9 * N_STRAIGHT
    assert found[single].mean() > 0.99
    lab.assert_no_root_twice(solved.result)
    missing = closed_form(solved.trial.arm, "drill", solved.p, solved.a).missing_m
    beyond = (solved.result.verdict == BranchVerdict.VALID) & (missing > 0)
    assert beyond.sum() > 5
    assert missing[beyond].max() < MOST_MISSING_M


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
def test_every_root_meets_its_target_once_and_every_slot_has_its_sentence(name, gravity, tool):
    solved = lab.near_double_roots(name, gravity, tool, N)
    lab.assert_roots_meet(solved, solved.tolerance)
    lab.assert_no_root_twice(solved.result)
    lab.assert_consistent(solved.trial.arm, solved.result)
    for k in range(0, N, 5):
        lab.assert_sentences(solved.trial.arm, select_targets(solved.result, k))


@radial
def test_a_valid_root_clear_of_the_folds_is_in_a_slot_of_its_own_branch(name, gravity, tool):
    """A root outside the limits only explains why there is none, and may have the name of another branch."""
    solved = lab.near_double_roots(name, gravity, tool, N)
    shape, q = solved.trial.arm.orthogonal[tool], solved.result.output_rad
    upper = q[Joint.ELEVATION] + shape.theta_rad[Joint.ELEVATION]
    fore = upper + q[Joint.ELBOW] + shape.theta_rad[Joint.ELBOW]
    ahead_m = np.abs(shape.upper_m * np.cos(upper) + shape.fore_m * np.cos(fore))
    signs = fold_distances(shape, q)
    is_valid = solved.result.verdict == BranchVerdict.VALID
    clear = is_valid & (np.abs(signs).min(axis=0) > 0.1) & (ahead_m > OVERHEAD_M)
    assert clear.sum() > 50
    slot = np.broadcast_to(np.arange(q.shape[1])[:, None], clear.shape)
    np.testing.assert_array_equal(branch_index(signs)[clear], slot[clear])


REFERENCE = np.array([0.3, -1.0, 1.6, 2.1, 1.2])


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("tool", TOOLS)
def test_relative_to_the_reference_pose_the_target_there_is_the_reference_pose(name, tool):
    """With the rigid tool at the reference pose as target, the root is the reference pose itself."""
    config = config_of(name)
    drawn = tool_pose(config.arm, forward(config.arm, REFERENCE), tool)
    p, a = relative_target(config.arm, tool, REFERENCE, MARS_R_m_s2, drawn.p, drawn.R[:, 0])
    deflected = pose_of(config.arm, REFERENCE, tool, MARS_R_m_s2)
    np.testing.assert_allclose(p, deflected.p, atol=1e-14)
    np.testing.assert_allclose(a, deflected.R[:, 0], atol=1e-14)
    found = refine_roots(config.arm, tool, p, a, MARS_R_m_s2, REFERENCE + 0.01)
    assert found.converged
    np.testing.assert_allclose(found.output_rad, REFERENCE, atol=1e-8)


def test_over_one_spot_the_shifts_of_two_tools_relative_to_each_other_cancel():
    """The shift of one tool, relative to the other, is the opposite of the other's; stiff springs."""
    config = config_of()
    arm = replace(config.arm, compliance=1e-3 * config.arm.compliance)
    spot = tool_pose(arm, forward(arm, REFERENCE), "apxs")
    p, a = spot.p, spot.R[:, 0]
    result = inverse_kinematics(arm, "drt", p, a)
    there = result.output_rad[:, np.flatnonzero(result.verdict == BranchVerdict.VALID)[-1]]
    shifts = []
    for tool, pose, other, other_pose in (
        ("drt", there, "apxs", REFERENCE),
        ("apxs", REFERENCE, "drt", there),
    ):
        target = relative_target(arm, other, other_pose, MARS_R_m_s2, p, a)
        found = refine_roots(arm, tool, *target, MARS_R_m_s2, pose)
        assert found.converged
        shifts.append(tool_pose(arm, forward(arm, found.output_rad), tool).p - p)
    assert np.linalg.norm(shifts[0]) > 2e-7
    np.testing.assert_allclose(shifts[0], -shifts[1], atol=2e-3 * np.linalg.norm(shifts[0]))
