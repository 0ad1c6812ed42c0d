"""The closed-form inverse: every root is checked by forward kinematics, and every label is earned."""

import numpy as np
import pytest

from fsw.dictionary.joints import Tool
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.ik import BRANCHES, Branches, Verdict, closed_form, into_limits
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.rig import config_of, in_limits

N = 4000


def targets_of(q, tool):
    arm = config_of().arm
    X = tool_pose(arm, forward(arm, q), tool)
    return X[..., :3, 3], X[..., :3, 0]


def random_case(tool, n=N, shrink=0.0):
    q = in_limits(config_of(), np.random.default_rng(100 + tool), n, shrink)
    p, a = targets_of(q, tool)
    return q, p, a, closed_form(config_of().arm, tool, p, a)


def lost(found: Branches):
    return found.verdict >= Verdict.OUT_OF_REACH


@pytest.mark.parametrize("tool", Tool)
def test_every_root_meets_its_target(tool):
    _, p, a, found = random_case(tool)
    X = tool_pose(config_of().arm, forward(config_of().arm, found.output_rad), tool)
    usable = ~lost(found)
    assert np.isfinite(found.output_rad[usable]).all()
    assert np.abs(X[..., :3, 3] - p[:, None])[usable].max() < 1e-9
    assert np.abs(X[..., :3, 0] - a[:, None])[usable].max() < 1e-9
    assert np.isnan(found.output_rad[~usable]).all()


@pytest.mark.parametrize("tool", Tool)
def test_the_pose_that_made_a_target_is_among_its_answers(tool):
    q, _, _, found = random_case(tool)
    difference = np.abs(wrap_angle(found.output_rad - q[:, None, :])).max(axis=-1)
    nearest = np.nanmin(np.where(lost(found), np.inf, difference), axis=-1)
    assert nearest.max() < 1e-6
    same = np.argmin(np.where(lost(found), np.inf, difference), axis=-1)
    assert (found.verdict[np.arange(N), same] == Verdict.VALID).all()


@pytest.mark.parametrize("tool", Tool)
def test_the_branches_of_a_target_are_eight_different_poses(tool):
    _, _, _, found = random_case(tool, 1000)
    q = found.output_rad
    apart = np.abs(wrap_angle(q[:, :, None, :] - q[:, None, :, :])).max(axis=-1)
    apart[:, np.arange(8), np.arange(8)] = np.inf
    assert np.nanmin(apart) > 1e-6
    assert len(set(BRANCHES)) == 8
    assert (~lost(found)).sum(axis=1).max() == 8


@pytest.mark.parametrize("tool", Tool)
def test_verdict_and_excess_tell_the_same(tool):
    _, _, _, found = random_case(tool)
    arm = config_of().arm
    over = np.max(
        np.maximum(arm.soft_min_rad - found.output_rad, found.output_rad - arm.soft_max_rad), axis=-1
    )
    valid, outside = found.verdict == Verdict.VALID, found.verdict == Verdict.OUTSIDE_LIMITS
    assert (over[valid] <= 0).all()
    assert (found.excess[valid] == 0).all()
    np.testing.assert_array_equal(found.excess[outside], over[outside])
    assert (found.excess[outside] > 0).all()
    assert (found.excess[found.verdict == Verdict.OUT_OF_REACH] > 0).all()
    assert {Verdict.VALID, Verdict.OUTSIDE_LIMITS, Verdict.OUT_OF_REACH} <= set(found.verdict.ravel())


def test_a_target_beyond_the_straight_arm_is_out_of_reach_by_that_much():
    arm = config_of().arm
    # elbow straight, pushed outward along the line from shoulder to wrist
    q = np.array([0.2, -0.4, 0.0, 0.9, 0.3])
    frames = forward(arm, q)
    shoulder, wrist = frames.X_RF[1, :3, 3], frames.X_RF[3, :3, 3]
    outward = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    p, a = targets_of(q, Tool.DRILL)
    for push_m in (0.001, 0.05, 0.5):
        found = closed_form(arm, Tool.DRILL, p + push_m * outward, a)
        assert (found.verdict != Verdict.VALID).all()
        assert found.excess[found.verdict == Verdict.OUT_OF_REACH].min() == pytest.approx(push_m, rel=1e-9)


def test_a_target_inside_the_shoulder_cylinder_says_so():
    arm = config_of().arm
    # the turret axis would pass 0.01 m from the azimuth axis; the wrist's offset keeps it 0.1664 m away
    p = np.array([1.11285 + 0.36, -0.4515 + 0.01, 1.0])
    found = closed_form(arm, Tool.DRILL, p, np.array([1.0, 0.0, 0.0]))
    assert (found.verdict == Verdict.OUT_OF_REACH).all()
    np.testing.assert_allclose(found.excess, 0.1664 - 0.01, atol=1e-12)


def test_branch_labels_say_where_the_elbow_is():
    arm = config_of().arm
    _, _, _, found = random_case(Tool.APXS)
    frames = forward(arm, found.output_rad)
    shoulder, elbow, wrist = (frames.X_RF[..., k, :3, 3] for k in (1, 2, 3))
    down = np.array([0.0, 0.0, 1.0])
    flat = np.linalg.norm((wrist - shoulder)[..., :2], axis=-1)
    # height of the elbow over the line from shoulder to wrist, in the arm's plane
    chord = wrist - shoulder
    share = np.sum((elbow - shoulder) * chord, axis=-1) / np.sum(chord * chord, axis=-1)
    foot = shoulder + share[..., None] * chord
    above = -np.sum((elbow - foot) * down, axis=-1)
    clear = ~lost(found) & (np.abs(above) > 1e-3) & (flat > 1e-2)
    up = np.array(["elbow-up" in name for name in BRANCHES])
    assert (above[clear] > 0).mean() == pytest.approx(0.5, abs=0.1)
    np.testing.assert_array_equal((above > 0)[clear], np.broadcast_to(up, above.shape)[clear])


@pytest.mark.parametrize("tool", Tool)
def test_a_straight_elbow_is_an_answer_or_out_of_reach_but_never_a_valid_nothing(tool):
    q = in_limits(config_of(), np.random.default_rng(7), 2000)
    q[:, 2] = 0.0
    p, a = targets_of(q, tool)
    found = closed_form(config_of().arm, tool, p, a)
    assert np.isfinite(found.output_rad[~lost(found)]).all()


def test_an_approach_along_the_pitch_axis_is_singular_for_that_shoulder():
    arm = config_of().arm
    q = np.array([0.3, -0.8, 1.5, 1.0, 0.0])
    boresight = np.arctan2(arm.X_FT[Tool.DRILL][1, 0], arm.X_FT[Tool.DRILL][0, 0])
    q[4] = np.pi / 2 - boresight
    p, a = targets_of(q, Tool.DRILL)
    np.testing.assert_allclose(np.abs(a @ forward(arm, q).X_RF[1, :3, 2]), 1.0, atol=1e-12)
    found = closed_form(arm, Tool.DRILL, p, a)
    assert (found.verdict[:4] == Verdict.SINGULAR).all()
    assert np.isnan(found.output_rad[:4]).all()


def test_a_batch_of_targets_is_its_single_targets():
    _, p, a, found = random_case(Tool.MAHLI, 20)
    for k in range(20):
        one = closed_form(config_of().arm, Tool.MAHLI, p[k], a[k])
        np.testing.assert_allclose(found.output_rad[k], one.output_rad, atol=1e-12)
        np.testing.assert_array_equal(found.verdict[k], one.verdict)


def test_where_two_turns_fit_the_nearer_one_is_taken():
    arm = config_of().arm
    wrist = np.radians(200.0)
    q = np.array([0.0, -1.0, 1.0, wrist, 1.0])
    for near in (np.radians(150.0), np.radians(-150.0)):
        start = np.array([0.0, -1.0, 1.0, near, 1.0])
        chosen = into_limits(arm, q, start)[3]
        assert chosen == pytest.approx(wrist if near > 0 else wrist - 2 * np.pi)


def test_only_a_limit_rejects_a_branch():
    """At stow, elbow-down and shoulder-in answers are as good as any (DESIGN, section 5)."""
    counts = np.zeros(8, int)
    for tool in Tool:
        _, _, _, found = random_case(tool)
        counts += (found.verdict == Verdict.VALID).sum(axis=0)
    assert (counts > 0).all()
