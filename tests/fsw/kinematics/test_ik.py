"""Inverse kinematics: every branch has its angles or a reason, and each reason a number and a sentence."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.dictionary.enums import Joint
from fsw.kinematics import ik
from fsw.kinematics.arm import heat_arm, limit_excess, wrap_into_limits
from fsw.kinematics.chain import forward
from fsw.kinematics.closed_form import BRANCHES, FREE_SINE, closed_form, fold_distances
from fsw.kinematics.roots import refine_roots
from fsw.kinematics.statics import settle_output, task_error
from fsw.kinematics.transforms import select_targets, wrap_angle
from helpers.marks import slow_but
from tests.fsw.kinematics.lab import (
    GRAVITIES,
    assert_consistent,
    assert_no_root_twice,
    assert_poses_found,
    assert_roots_meet,
    assert_sentences,
    near_double_roots,
    random_poses,
    solve_poses,
)
from tests.fsw.kinematics.test_closed_form import tool_of_the_drawing_but
from tests.fsw.rig import MARS_R_m_s2, config_of, facing, in_limits, pose_of
from tests.tools import TOOLS, tool_index
from validation import kinematics

N = 4000
N_LOADED = 260
ARM = config_of().arm
RIGID_M, LOADED_M = 1e-9, 1e-6


def targets_of(q, tool, arm=ARM, gravity=None):
    X = pose_of(arm, q, tool, gravity)
    return X.p, X.R[:, 0]


@pytest.mark.parametrize("gravity", slow_but(GRAVITIES, "rigid", "tilted"))
@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("tool", slow_but(TOOLS, "apxs", "drill", "drt"))
def test_every_root_meets_its_target_and_the_pose_that_made_it_is_among_them_once(name, tool, gravity):
    solved = random_poses(name, gravity, tool, N_LOADED)
    arm, result, pull = solved.trial.arm, solved.result, GRAVITIES[gravity]
    assert_poses_found(solved)
    assert_no_root_twice(result)
    assert_consistent(arm, result)
    if pull is None:
        assert_roots_meet(solved, *((1e-12, 1e-14) if name == "nominal" else (RIGID_M, 2e-8)))
        assert not result.torque_Nm.any()
    else:
        assert_roots_meet(solved, 1e-7)
        there = kinematics.claimed_roots(result)
        at_rest = settle_output(arm, result.output_rad[:, there], pull)
        np.testing.assert_allclose(result.torque_Nm[:, there], at_rest.torque_Nm, atol=1e-4)


@pytest.mark.parametrize("gravity", slow_but(GRAVITIES, "rigid", "tilted"))
@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("tool", slow_but(TOOLS, "apxs", "drill", "drt"))
def test_roots_for_the_warm_arm_put_the_warm_tool_on_its_target(name, tool, gravity):
    """The arm is 100 K above calibration; with the same angles the cold arm misses by millimetres."""
    cold, pull = config_of(name).arm, GRAVITIES[gravity]
    warm = heat_arm(cold, 100.0)
    trial = kinematics.Trial(f"{name}, warm", warm, tool, pull)
    solved = solve_poses(trial, in_limits(config_of(), np.random.default_rng(100 + tool_index(tool)), 100))
    assert_poses_found(solved)
    result = solved.result
    valid = result.verdict == ik.BranchVerdict.VALID
    p, a = (v[:, np.nonzero(valid)[1]] for v in (solved.p, solved.a))  # of each chosen slot
    missed, cold_missed = (
        task_error(pose_of(arm, result.output_rad[:, valid], tool, pull), p, a) for arm in (warm, cold)
    )
    assert np.abs(missed).max() < (RIGID_M if pull is None else LOADED_M)
    assert 1e-3 < np.linalg.norm(cold_missed[:3], axis=0).mean() < 6e-3


@pytest.mark.parametrize("gravity", ["mars", "tilted"])
@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
def test_roots_that_were_not_followed_are_outside_the_limits_by_about_as_much_as_estimated(name, gravity):
    """Newton from the orthogonal arm's root finds the root outside the limits, near the estimate."""
    solved = random_poses(name, gravity, "drill", N_LOADED)
    arm, pull = solved.trial.arm, GRAVITIES[gravity]
    roots = closed_form(arm, "drill", solved.p, solved.a)
    guessed = (solved.result.verdict == ik.BranchVerdict.OUTSIDE_LIMITS) & ~kinematics.claimed_roots(
        solved.result
    )
    guessed &= roots.from_fold.min(axis=0) > kinematics.CLEAR_OF_FOLDS
    slot, target = np.nonzero(guessed)
    assert slot.size > 100
    p, a = solved.p[:, target], solved.a[:, target]
    start = roots.output_rad[:, slot, target]
    found = refine_roots(arm, "drill", p, a, pull, start)
    near = found.converged & (np.abs(wrap_angle(found.output_rad - start)).max(axis=0) < 0.2)
    assert near.mean() > 0.9
    over = limit_excess(arm, wrap_into_limits(arm, found.output_rad[:, near])).max(axis=0)
    assert (over > 0).all()
    np.testing.assert_allclose(solved.result.excess[guessed][near], over, rtol=0, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("offset_m", [1e-15, 1e-12, 1e-9, 1e-6, 1e-5, 1e-4])
def test_a_boresight_that_passes_the_turret_axis_at_next_to_nothing_loses_no_root(offset_m):
    arm = tool_of_the_drawing_but(offset_m)
    q = in_limits(config_of(), np.random.default_rng(9), N)
    p, a = targets_of(q, "drill", arm)
    result = ik.inverse_kinematics(arm, "drill", p, a)
    lost = kinematics.root_distances(result, q).min(axis=0) > kinematics.SAME_RAD
    if lost.any():
        assert not kinematics.find_regular(kinematics.Trial("offset", arm, "drill", None), q[:, lost]).any()


@pytest.mark.parametrize("push_m", [0.001, 0.05, 0.5])
def test_a_target_beyond_the_straight_arm_is_out_of_reach_by_that_much(push_m):
    # elbow straight, pushed outward along the line from shoulder to wrist
    q = np.array([0.2, -0.4, 0.0, 0.9, 0.3])
    frames = forward(ARM, q)
    chord = frames.X_RF.p[:, 3] - frames.X_RF.p[:, 1]
    p, a = targets_of(q, "drill")
    result = ik.inverse_kinematics(ARM, "drill", p + push_m * chord / np.linalg.norm(chord), a)
    assert not (result.verdict == ik.BranchVerdict.VALID).any()
    missing = result.excess[result.verdict == ik.BranchVerdict.OUT_OF_REACH]
    assert missing.min() == pytest.approx(push_m, rel=1e-9)
    branch = int(np.flatnonzero(result.excess == missing.min())[0])
    assert ik.describe_slot(ARM, result, branch) == f"{BRANCHES[branch]}: out of reach by {push_m:.3f} m"


def test_a_target_inside_the_shoulder_cylinder_says_so():
    # the turret axis would pass 0.01 m from the azimuth axis; the wrist's offset keeps it 0.1664 m away
    p = np.array([1.11285 + 0.36, -0.4515 + 0.01, 1.0])
    result = ik.inverse_kinematics(ARM, "drill", p, np.array([1.0, 0.0, 0.0]))
    assert (result.verdict == ik.BranchVerdict.OUT_OF_REACH).all()
    np.testing.assert_allclose(result.excess, 0.1664 - 0.01, atol=1e-12)


def along_the_pitch_axis(tool):
    """Compute a target whose approach is parallel to the pitch axes of the arm that points to it."""
    q = facing(config_of(), tool, np.pi / 2, [0.3, -0.8, 1.5, 1.0, 0.0])
    p, a = targets_of(q, tool)
    np.testing.assert_allclose(np.abs(a @ forward(ARM, q).X_RF.R[:, 2, 1]), 1.0, atol=1e-12)
    return p, a


@pytest.mark.parametrize("tool", TOOLS)
def test_an_approach_along_the_pitch_axis_is_singular_for_that_shoulder_of_the_rigid_arm(tool):
    result = ik.inverse_kinematics(ARM, tool, *along_the_pitch_axis(tool))
    out = np.array(["shoulder-out" in name for name in BRANCHES])
    assert (result.verdict == ik.BranchVerdict.SINGULAR)[out].all()
    assert not (result.verdict == ik.BranchVerdict.SINGULAR)[~out].any()
    assert np.isnan(result.output_rad[:, out]).all()
    assert (result.joint[out] == Joint.WRIST).all()
    assert (result.excess[out] < FREE_SINE).all()
    for branch in np.flatnonzero(out):
        assert ik.describe_slot(ARM, result, branch) == (
            f"{BRANCHES[branch]}: singular, the approach is parallel to the pitch axes "
            "and the wrist pitch is free"
        )


@pytest.mark.parametrize("tool", TOOLS)
def test_the_nearest_regular_approach_is_off_the_pitch_axes_by_its_sine_and_has_a_pose(tool):
    p, a = along_the_pitch_axis(tool)
    regular = ik.find_regular_approach(ARM, tool, p, a, 0)
    assert np.linalg.norm(regular) == pytest.approx(1.0, abs=1e-12)
    assert a @ regular > np.cos(2 * ik.REGULAR_SINE)
    assert closed_form(ARM, tool, p, regular).wrist_sine[0] == pytest.approx(ik.REGULAR_SINE, abs=1e-4)
    result = ik.inverse_kinematics(ARM, tool, p, regular, MARS_R_m_s2)
    assert not (result.verdict == ik.BranchVerdict.SINGULAR).any()
    assert kinematics.claimed_roots(result).any()


@pytest.mark.parametrize("off_rad", [0.0, 1e-15, 1e-12, 1e-9])
@pytest.mark.parametrize("tool", TOOLS)
def test_a_pose_with_its_approach_along_the_pitch_axes_is_answered_or_its_family_is_named(tool, off_rad):
    """This holds for both elbows: at a free wrist, the reach of one pitch does not determine the others."""
    q = in_limits(config_of(), np.random.default_rng(31), 2000)
    boresight = ARM.X_FT[tool].R[:, 0]
    q[Joint.TURRET] = (0.5 * np.pi + off_rad - np.arctan2(boresight[1], boresight[0])) % (2 * np.pi)
    p, a = targets_of(q, tool)
    result = ik.inverse_kinematics(ARM, tool, p, a)
    shoulder = np.where(fold_distances(ARM.orthogonal[tool], q)[0] < 0, 0, 4)
    of_shoulder = result.verdict[shoulder + np.arange(4)[:, None], np.arange(q.shape[1])]
    met = kinematics.root_distances(result, q).min(axis=0) < kinematics.SAME_RAD
    assert (met | (of_shoulder == ik.BranchVerdict.SINGULAR).any(axis=0)).all()


UNREACHABLE = [
    ((9.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    ((1.47285, -0.4415, 1.0), (1.0, 0.0, 0.0)),
    ((1.11285, -0.4515, 0.266), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, -3.0), (0.0, 1.0, 0.0)),
    ((1e6, -1e6, 1e6), (0.0, 0.0, -1.0)),
    ((-1e20, 1e12, 3.0), (0.6, 0.0, 0.8)),
    ((1e100, 1e100, 1e100), (0.0, 1.0, 0.0)),
    ((0.0, -1e150, 1e150), (1.0, 0.0, 0.0)),  # the squares of more are not finite any more
]


@pytest.mark.parametrize(("p", "a"), UNREACHABLE)
@pytest.mark.parametrize("name", ["nominal", "calibrated:3", "skew:1"])
@pytest.mark.parametrize("gravity", GRAVITIES)
def test_an_unreachable_target_is_eight_sentences_and_no_exception(name, gravity, p, a):
    arm = kinematics.arm_of(name)
    result = ik.inverse_kinematics(arm, "drill", np.array(p), np.array(a), GRAVITIES[gravity])
    assert (result.verdict == ik.BranchVerdict.OUT_OF_REACH).all()
    assert_consistent(arm, result)
    assert_sentences(arm, result)


@given(
    st.integers(0, 2**32 - 1), st.sampled_from(list(GRAVITIES)), st.sampled_from(["nominal", "calibrated:3"])
)
def test_no_sentence_and_no_number_of_any_target_is_nan(seed, gravity, name):
    rng = np.random.default_rng(seed)
    arm = config_of(name).arm
    p = np.array([1.1, -0.45, 0.27]) + rng.choice([0.01, 0.5, 1.2, 2.0]) * rng.normal(size=3)
    a = np.eye(3)[rng.integers(3)] if rng.random() < 0.3 else rng.normal(size=3)
    result = ik.inverse_kinematics(arm, TOOLS[rng.integers(5)], p, a / np.linalg.norm(a), GRAVITIES[gravity])
    assert_consistent(arm, result)
    assert_sentences(arm, result)


@pytest.mark.parametrize("tool", ["apxs", "mahli"])
def test_a_batch_of_rigid_targets_is_its_single_targets_bit_for_bit_in_any_shape(tool):
    n = 150
    p, a = targets_of(in_limits(config_of(), np.random.default_rng(100 + tool_index(tool)), n), tool)
    result = ik.inverse_kinematics(ARM, tool, p, a)
    shaped = ik.inverse_kinematics(ARM, tool, p.reshape(3, 5, 30), a.reshape(3, 5, 30))
    for k in range(n):
        one = ik.inverse_kinematics(ARM, tool, p[:, k], a[:, k])
        for name in ik.IkResult.__slots__:
            several = getattr(result, name)[..., k]
            np.testing.assert_array_equal(several, getattr(one, name))
            np.testing.assert_array_equal(several, getattr(shaped, name)[..., k // 30, k % 30])


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
def test_a_batch_of_deflected_targets_is_its_single_targets(name):
    solved = random_poses(name, "mars", "drt", N_LOADED)
    for k in range(0, N_LOADED, 4):
        one = ik.inverse_kinematics(solved.trial.arm, "drt", solved.p[:, k], solved.a[:, k], MARS_R_m_s2)
        many = select_targets(solved.result, k)
        for word in ("verdict", "joint"):
            np.testing.assert_array_equal(getattr(many, word), getattr(one, word))
        for word, bound in (("output_rad", 1e-6), ("excess", 1e-6), ("error", 1e-9)):
            np.testing.assert_allclose(getattr(many, word), getattr(one, word), rtol=0, atol=bound)


@pytest.mark.parametrize("name", ["nominal", "calibrated:3", "skew:1"])
def test_gravity_that_is_all_zeros_is_no_gravity(name):
    solved = near_double_roots(name, "rigid", "apxs", 60)
    result = ik.inverse_kinematics(solved.trial.arm, "apxs", solved.p, solved.a, np.zeros(3))
    for word in ik.IkResult.__slots__:
        np.testing.assert_array_equal(getattr(result, word), getattr(solved.result, word))


@pytest.mark.parametrize("name", ["nominal", "calibrated:3", "skew:1"])
@pytest.mark.parametrize("gravity", GRAVITIES)
@pytest.mark.parametrize("shape", [(0,), (2, 0), (0, 3)])
def test_of_no_targets_there_are_no_roots(name, gravity, shape):
    nothing = np.zeros((3, *shape))
    result = ik.inverse_kinematics(kinematics.arm_of(name), "drill", nothing, nothing, GRAVITIES[gravity])
    assert result.verdict.shape == result.excess.shape == (8, *shape)
    assert result.output_rad.shape == result.torque_Nm.shape == (5, 8, *shape)


@pytest.mark.parametrize("gravity", GRAVITIES)
def test_the_answer_in_the_turn_next_to_where_the_arm_is(gravity):
    low, high = ARM.soft_min_rad[Joint.WRIST], ARM.soft_max_rad[Joint.WRIST]
    assert high - low > 2 * np.pi
    middle = 0.5 * (low + high)
    for wrist in (middle + np.pi, middle - np.pi):
        q = np.array([0.1, -1.0, 1.2, wrist, 1.0])
        p, a = targets_of(q, "apxs", gravity=GRAVITIES[gravity])
        result = ik.inverse_kinematics(ARM, "apxs", p, a, GRAVITIES[gravity], near_rad=q)
        same = np.where(
            kinematics.claimed_roots(result), np.abs(wrap_angle(result.output_rad.T - q)).max(axis=1), 9.0
        ).argmin()
        assert result.verdict[same] == ik.BranchVerdict.VALID
        np.testing.assert_allclose(result.output_rad[:, same], q, atol=1e-6)


@pytest.mark.parametrize("share", [0.2, 0.8])
def test_a_turret_between_its_limits_gets_the_turn_that_is_least_outside(share):
    """The travel is 350.2 deg: angles between the limits fit in no turn."""
    low, high = ARM.soft_min_rad[4], ARM.soft_max_rad[4]
    gap_rad = low + 2 * np.pi - high
    q = np.array([0.0, -1.0, 1.0, 1.0, high + share * gap_rad])
    over = limit_excess(ARM, wrap_into_limits(ARM, q))[4]
    assert over == pytest.approx(min(share, 1 - share) * gap_rad, abs=1e-12)


@settings(max_examples=200)
@given(st.integers(0, 2**32 - 1))
def test_whatever_the_turn_what_comes_out_is_the_same_angle_and_inside_if_any_turn_is(seed):
    rng = np.random.default_rng(seed)
    q, near = rng.uniform(-20, 20, (5, 4)), rng.uniform(-7, 7, 5)
    for start in (None, near):
        out = wrap_into_limits(ARM, q, start)
        np.testing.assert_allclose(wrap_angle(out - q + 1.0), 1.0, atol=1e-11)
        turns = out[None] + 2 * np.pi * np.arange(-6, 7)[:, None, None]
        low, high = ARM.soft_min_rad[:, None], ARM.soft_max_rad[:, None]
        can = ((turns >= low) & (turns <= high)).any(axis=0)
        np.testing.assert_array_equal((out >= low - 1e-12) & (out <= high + 1e-12), can)
        if start is not None:
            inside = np.where((turns >= low) & (turns <= high), np.abs(turns - start[:, None]), np.inf)
            nearest = inside.min(axis=0)
            np.testing.assert_allclose(np.abs(out - start[:, None])[can], nearest[can], atol=1e-11)
