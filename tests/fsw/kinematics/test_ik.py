"""Answers: every branch with its angles or its reason, and each reason with its number and its sentence."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.dictionary.joints import Joint, Tool
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.compensation import task_error, task_jacobian
from fsw.kinematics.ik import Answers, Verdict, at_target, inverse_kinematics, why
from fsw.kinematics.limits import beyond_limits, into_limits, outside
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.kinematics.test_closed_form import from_the_azimuth_axis, skew_tool, wrist_sine
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits

N = 4000
N_LOADED = 300
ARM = config_of().arm
GRAVITIES = {"rigid": None, "mars": MARS_R_m_s2, "tilted": np.array([0.9, -1.2, 3.4])}
RIGID_M, LOADED_M = 1e-9, 1e-6
HAS_ANGLES = (Verdict.VALID, Verdict.OUTSIDE_LIMITS)


def pose_of(arm, q, tool, gravity=None):
    """The tool of the rigid or of the hanging arm."""
    frames = forward(arm, q) if gravity is None else rest(arm, q, gravity).frames
    return tool_pose(arm, frames, tool)


def targets_of(q, tool, arm=ARM, gravity=None):
    X = pose_of(arm, q, tool, gravity)
    return X.p, X.R[:, 0]


def random_case(tool, n=N, arm=ARM, gravity=None):
    q = in_limits(config_of(), np.random.default_rng(100 + tool), n)
    p, a = targets_of(q, tool, arm, gravity)
    return q, p, a, inverse_kinematics(arm, tool, p, a, gravity)


def conditioned(q, tool, arm=ARM):
    """Smallest singular value of the task Jacobian."""
    frames = forward(arm, q)
    X = tool_pose(arm, frames, tool)
    J = np.moveaxis(task_jacobian(frames, X, X.R[:, 0]), (0, 1), (-2, -1))
    return np.linalg.svd(J, compute_uv=False)[..., -1]


def found(answers):
    return answers.verdict <= Verdict.OUTSIDE_LIMITS


def from_answers(answers, q):
    """The distance of the nearest answer from each pose, turns apart; infinite where there is none."""
    apart = np.abs(wrap_angle(answers.output_rad - q[:, None])).max(axis=0)
    return np.where(found(answers), apart, np.inf)


def where_verdict(answers, verdict):
    return answers.verdict == verdict


def assert_consistent(arm, answers):
    """What the words of Answers promise, whatever the target."""
    angles, is_found = answers.output_rad, found(answers)
    assert answers.verdict.shape == answers.joint.shape == answers.excess.shape == answers.error.shape
    assert angles.shape == answers.torque_Nm.shape == (5, *answers.verdict.shape)
    assert answers.verdict.shape[0] == len(BRANCHES)
    assert np.isfinite(angles[:, is_found]).all()
    assert np.isnan(angles[:, ~is_found]).all()
    assert np.isfinite(answers.excess).all()
    assert not np.isnan(answers.torque_Nm).any()
    over = beyond_limits(arm, angles)
    valid, out = where_verdict(answers, Verdict.VALID), where_verdict(answers, Verdict.OUTSIDE_LIMITS)
    assert (over[:, valid] <= 0).all()
    np.testing.assert_array_equal(answers.excess[out], over[:, out].max(axis=0))
    np.testing.assert_array_equal(answers.joint[out], over[:, out].argmax(axis=0))
    assert (answers.excess[out] > 0).all()
    assert (answers.excess[where_verdict(answers, Verdict.OUT_OF_REACH)] > 0).all()
    for verdict in (Verdict.VALID, Verdict.SINGULAR, Verdict.NOT_CONVERGED):
        assert not answers.excess[where_verdict(answers, verdict)].any()
    assert np.isfinite(answers.error[valid]).all()


def assert_sentences(arm, answers):
    for branch in range(len(BRANCHES)):
        sentence = why(arm, answers, branch)
        assert sentence.startswith(f"{BRANCHES[branch]}: ")
        assert "nan" not in sentence
        assert "inf" not in sentence


@pytest.mark.parametrize("tool", Tool)
def test_every_answer_of_the_rigid_arm_meets_its_target(tool):
    _, p, a, answers = random_case(tool)
    X = pose_of(ARM, answers.output_rad, tool)
    error = np.abs(task_error(X, p[:, None], a[:, None])).max(axis=0)
    assert error[found(answers)].max() < RIGID_M
    np.testing.assert_allclose(answers.error[found(answers)], error[found(answers)], atol=1e-14)
    assert not answers.torque_Nm.any()
    assert_consistent(ARM, answers)


@pytest.mark.parametrize("tool", Tool)
def test_the_pose_that_made_a_target_is_among_its_answers_and_valid(tool):
    q, _, _, answers = random_case(tool)
    apart = from_answers(answers, q)
    clear = conditioned(q, tool) > 1e-4
    assert clear.mean() > 0.99
    assert apart.min(axis=0)[clear].max() < 1e-6
    same = apart.argmin(axis=0)
    assert (answers.verdict[same, np.arange(N)][clear] == Verdict.VALID).all()


@pytest.mark.parametrize("gravity", ["mars", "tilted"])
@pytest.mark.parametrize("name", ["nominal", "as-built:3", "calibrated:3", "calibrated:11"])
@pytest.mark.parametrize("tool", [Tool.DRILL, Tool.MAHLI])
def test_every_valid_answer_of_the_hanging_arm_meets_its_target(name, tool, gravity):
    arm, pull = config_of(name).arm, GRAVITIES[gravity]
    _, p, a, answers = random_case(tool, N_LOADED, arm, pull)
    valid = where_verdict(answers, Verdict.VALID)
    at_rest = rest(arm, answers.output_rad[:, valid], pull)
    p, a = (np.repeat(v[:, None], 8, axis=1)[:, valid] for v in (p, a))
    error = task_error(tool_pose(arm, at_rest.frames, tool), p, a)
    assert np.abs(error).max() < LOADED_M
    np.testing.assert_allclose(answers.torque_Nm[:, valid], at_rest.torque_Nm, atol=1e-3)
    assert (answers.error[valid] < LOADED_M).all()
    assert_consistent(arm, answers)


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("gravity", GRAVITIES)
@pytest.mark.parametrize("tool", Tool)
def test_clear_of_double_roots_the_pose_of_a_hanging_target_is_among_its_answers(name, tool, gravity):
    arm, pull = config_of(name).arm, GRAVITIES[gravity]
    q, p, a, answers = random_case(tool, N_LOADED, arm, pull)
    # near double roots some may be missed under load or after calibration, so far
    bend = np.abs(q[Joint.ELBOW])
    clear = (bend > 0.4) & (bend < np.pi - 0.4) & (conditioned(q, tool, arm) > 0.03)
    clear &= (wrist_sine(arm, q, a) > 0.3) & (from_the_azimuth_axis(arm, p, a, tool) > 0.35)
    apart = from_answers(answers, q)
    assert clear.sum() > 100
    assert apart.min(axis=0)[clear].max() < 1e-6
    same = apart.argmin(axis=0)
    is_valid = answers.verdict[same, np.arange(N_LOADED)] == Verdict.VALID
    assert is_valid[clear & (beyond_limits(arm, q).max(axis=0) < -1e-6)].all()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("gravity", GRAVITIES)
def test_every_valid_answer_for_a_skew_tool_meets_its_target(seed, gravity):
    arm, pull = skew_tool(seed), GRAVITIES[gravity]
    _, p, a, answers = random_case(Tool.DRILL, N_LOADED, arm, pull)
    valid = where_verdict(answers, Verdict.VALID)
    assert valid.any(axis=0).mean() > 0.8
    p, a = (np.repeat(v[:, None], 8, axis=1)[:, valid] for v in (p, a))
    error = np.abs(task_error(pose_of(arm, answers.output_rad[:, valid], Tool.DRILL, pull), p, a))
    assert error.max() < (RIGID_M if pull is None else LOADED_M)
    assert_consistent(arm, answers)


@pytest.mark.parametrize("tool", Tool)
def test_the_answers_to_a_target_are_eight_different_poses(tool):
    q, _, _, answers = random_case(tool, 1000)
    angles = answers.output_rad
    apart = np.abs(wrap_angle(angles[:, :, None] - angles[:, None])).max(axis=0)
    apart[np.arange(8), np.arange(8)] = np.inf
    assert np.nanmin(apart[..., conditioned(q, tool) > 1e-4]) > 1e-6
    assert found(answers).sum(axis=0).max() == 8


def test_every_verdict_but_singular_occurs_at_random_targets():
    _, p, a, answers = random_case(Tool.APXS)
    far = inverse_kinematics(ARM, Tool.APXS, p + np.array([[1.0], [0.0], [0.0]]), a)
    seen = set(answers.verdict.ravel()) | set(far.verdict.ravel())
    assert seen == {Verdict.VALID, Verdict.OUTSIDE_LIMITS, Verdict.OUT_OF_REACH}


@pytest.mark.parametrize("push_m", [0.001, 0.05, 0.5])
def test_a_target_beyond_the_straight_arm_is_out_of_reach_by_that_much(push_m):
    # elbow straight, pushed outward along the line from shoulder to wrist
    q = np.array([0.2, -0.4, 0.0, 0.9, 0.3])
    frames = forward(ARM, q)
    chord = frames.X_RF.p[:, 3] - frames.X_RF.p[:, 1]
    p, a = targets_of(q, Tool.DRILL)
    answers = inverse_kinematics(ARM, Tool.DRILL, p + push_m * chord / np.linalg.norm(chord), a)
    assert not where_verdict(answers, Verdict.VALID).any()
    missing = answers.excess[where_verdict(answers, Verdict.OUT_OF_REACH)]
    assert missing.min() == pytest.approx(push_m, rel=1e-9)
    branch = int(np.flatnonzero(answers.excess == missing.min())[0])
    assert why(ARM, answers, branch) == f"{BRANCHES[branch]}: out of reach by {push_m:.3f} m"


def test_a_target_inside_the_shoulder_cylinder_says_so():
    # the turret axis would pass 0.01 m from the azimuth axis; the wrist's offset keeps it 0.1664 m away
    p = np.array([1.11285 + 0.36, -0.4515 + 0.01, 1.0])
    answers = inverse_kinematics(ARM, Tool.DRILL, p, np.array([1.0, 0.0, 0.0]))
    assert where_verdict(answers, Verdict.OUT_OF_REACH).all()
    np.testing.assert_allclose(answers.excess, 0.1664 - 0.01, atol=1e-12)


def test_branch_names_say_where_the_elbow_is():
    _, _, _, answers = random_case(Tool.APXS)
    frames = forward(ARM, answers.output_rad)
    shoulder, elbow, wrist = (frames.X_RF.p[:, k] for k in (1, 2, 3))
    # height of the elbow over the line from shoulder to wrist, in the arm's plane; z is down
    chord = wrist - shoulder
    share = np.sum((elbow - shoulder) * chord, axis=0) / np.sum(chord * chord, axis=0)
    above = (shoulder + share * chord - elbow)[2]
    flat = np.linalg.norm(chord[:2], axis=0)
    clear = found(answers) & (np.abs(above) > 1e-3) & (flat > 1e-2)
    up = np.broadcast_to(np.array(["elbow-up" in name for name in BRANCHES])[:, None], above.shape)
    assert (above[clear] > 0).mean() == pytest.approx(0.5, abs=0.1)
    np.testing.assert_array_equal((above > 0)[clear], up[clear])


def test_branch_names_say_where_the_shoulder_and_the_wrist_are():
    _, _, _, answers = random_case(Tool.DRILL)
    ok = found(answers)
    frames = forward(ARM, answers.output_rad)
    X = tool_pose(ARM, frames, Tool.DRILL)
    # the azimuth looks toward the tool's foot on the turret axis, or away from it
    foot = X.p - 0.360 * X.R[:, 0]
    ahead = np.sum(frames.X_RF.R[:, 0, 1] * (foot - frames.X_RF.p[:, 0]), axis=0)
    out = np.broadcast_to(np.array(["shoulder-out" in name for name in BRANCHES])[:, None], ok.shape)
    np.testing.assert_array_equal((ahead > 0)[ok], out[ok])
    # the two wrists carry the turret axis on either side of the approach: their sines are opposite
    n, z5 = frames.X_RF.R[:, 2, 1], frames.X_RF.R[:, 2, 4]
    sine = np.sum(np.cross(n, X.R[:, 0], axis=0) * z5, axis=0)
    up = np.broadcast_to(np.array(["wrist-up" in name for name in BRANCHES])[:, None], ok.shape)
    np.testing.assert_array_equal((sine < 0)[ok], up[ok])


@pytest.mark.parametrize("tool", Tool)
@pytest.mark.parametrize("elbow_rad", [0.0, 1e-9, 1e-5, -1e-3])
def test_a_nearly_straight_elbow_is_answered_or_out_of_reach_by_nothing(tool, elbow_rad):
    """At the double root: what is returned is right, and what is out of reach is out by a rounding error."""
    q = in_limits(config_of(), np.random.default_rng(7), 1000)
    q[2] = elbow_rad
    p, a = targets_of(q, tool)
    answers = inverse_kinematics(ARM, tool, p, a)
    assert_consistent(ARM, answers)
    ok = found(answers)
    assert ok.any(axis=0).mean() > 0.99
    X = pose_of(ARM, answers.output_rad, tool)
    error = np.abs(task_error(X, p[:, None], a[:, None])).max(axis=0)
    assert error[ok].max() < RIGID_M


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("gravity", GRAVITIES)
def test_what_is_returned_near_double_roots_and_singular_directions_is_right(name, gravity):
    arm, pull = config_of(name).arm, GRAVITIES[gravity]
    rng = np.random.default_rng(8)
    q = in_limits(config_of(), rng, 400)
    q[2, :200] = 10.0 ** rng.uniform(-9, -1, 200) * rng.choice([-1, 1], 200)
    boresight = np.arctan2(*ARM.X_FT[Tool.APXS].R[[1, 0], 0])
    q[4, 200:] = np.pi / 2 - boresight + 10.0 ** rng.uniform(-9, -1, 200) * rng.choice([-1, 1], 200)
    p, a = targets_of(q, Tool.APXS, arm, pull)
    answers = inverse_kinematics(arm, Tool.APXS, p, a, pull)
    assert_consistent(arm, answers)
    valid = where_verdict(answers, Verdict.VALID)
    p, a = (np.repeat(v[:, None], 8, axis=1)[:, valid] for v in (p, a))
    error = np.abs(task_error(pose_of(arm, answers.output_rad[:, valid], Tool.APXS, pull), p, a))
    assert error.max() < (RIGID_M if pull is None else LOADED_M)
    for k in range(0, 400, 7):
        assert_sentences(arm, at_target(answers, k))


def along_the_pitch_axis(tool):
    """A target whose approach is parallel to the pitch axes of the arm that looks toward it."""
    q = np.array([0.3, -0.8, 1.5, 1.0, 0.0])
    boresight = ARM.X_FT[tool].R[:, 0]
    q[4] = np.pi / 2 - np.arctan2(boresight[1], boresight[0])
    p, a = targets_of(q, tool)
    np.testing.assert_allclose(np.abs(a @ forward(ARM, q).X_RF.R[:, 2, 1]), 1.0, atol=1e-12)
    return p, a


@pytest.mark.parametrize("tool", [Tool.DRILL, Tool.APXS])
@pytest.mark.parametrize("gravity", ["rigid", "mars", "tilted"])
def test_an_approach_along_the_pitch_axis_is_singular_for_that_shoulder(tool, gravity):
    answers = inverse_kinematics(ARM, tool, *along_the_pitch_axis(tool), GRAVITIES[gravity])
    out = np.array(["shoulder-out" in name for name in BRANCHES])
    assert where_verdict(answers, Verdict.SINGULAR)[out].all()
    assert not where_verdict(answers, Verdict.SINGULAR)[~out].any()
    assert np.isnan(answers.output_rad[:, out]).all()
    for branch in np.flatnonzero(out):
        assert why(ARM, answers, branch) == (
            f"{BRANCHES[branch]}: singular, the approach is parallel to the pitch axes "
            "and the wrist pitch is free"
        )


@pytest.mark.parametrize("tool", Tool)
@pytest.mark.parametrize("gravity", GRAVITIES)
def test_at_a_singular_target_what_is_returned_meets_it(tool, gravity):
    p, a = along_the_pitch_axis(tool)
    pull = GRAVITIES[gravity]
    answers = inverse_kinematics(ARM, tool, p, a, pull)
    assert_consistent(ARM, answers)
    assert_sentences(ARM, answers)
    valid = where_verdict(answers, Verdict.VALID)
    X = pose_of(ARM, answers.output_rad[:, valid], tool, pull)
    error = np.abs(task_error(X, p[:, None], a[:, None]))
    assert error.max(initial=0.0) < (RIGID_M if pull is None else LOADED_M)


UNREACHABLE = [
    ((9.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    ((1.47285, -0.4415, 1.0), (1.0, 0.0, 0.0)),
    ((1.11285, -0.4515, 0.266), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, -3.0), (0.0, 1.0, 0.0)),
    ((1e6, -1e6, 1e6), (0.0, 0.0, -1.0)),
]


@pytest.mark.parametrize(("p", "a"), UNREACHABLE)
@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("gravity", GRAVITIES)
def test_an_unreachable_target_is_eight_sentences_and_no_exception(name, gravity, p, a):
    arm = config_of(name).arm
    answers = inverse_kinematics(arm, Tool.DRILL, np.array(p), np.array(a), GRAVITIES[gravity])
    assert not where_verdict(answers, Verdict.VALID).any()
    assert_consistent(arm, answers)
    assert_sentences(arm, answers)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1), st.sampled_from(list(GRAVITIES)), st.sampled_from(["nominal", "calibrated:3"])
)
def test_no_sentence_and_no_number_of_any_target_is_nan(seed, gravity, name):
    rng = np.random.default_rng(seed)
    arm = config_of(name).arm
    p = np.array([1.1, -0.45, 0.27]) + rng.choice([0.01, 0.5, 1.2, 2.0]) * rng.normal(size=3)
    a = np.eye(3)[rng.integers(3)] if rng.random() < 0.3 else rng.normal(size=3)
    answers = inverse_kinematics(arm, Tool(rng.integers(5)), p, a / np.linalg.norm(a), GRAVITIES[gravity])
    assert_consistent(arm, answers)
    assert_sentences(arm, answers)


def test_the_sentence_about_a_limit_names_joint_angle_and_limits():
    """Of the shown angle and limits a reader can compute the excess himself."""
    _, _, _, answers = random_case(Tool.APXS, 200)
    pattern = re.compile(
        r"(?P<name>.+): joint (?P<joint>\w+): (?P<angle>-?[\d.]+) deg is outside "
        r"its soft limits (?P<low>-?[\d.]+) \.\. (?P<high>-?[\d.]+) deg"
    )
    read = 0
    for k in range(200):
        one = at_target(answers, k)
        for branch in np.flatnonzero(one.verdict == Verdict.OUTSIDE_LIMITS):
            told = pattern.fullmatch(why(ARM, one, int(branch)))
            assert Joint[told["joint"].upper()] == one.joint[branch]
            angle, low, high = (float(told[word]) for word in ("angle", "low", "high"))
            assert max(low - angle, angle - high) == pytest.approx(np.degrees(one.excess[branch]), abs=0.11)
            read += 1
    assert read > 100


def test_a_valid_branch_says_so():
    q, _, _, answers = random_case(Tool.APXS, 1)
    one = at_target(answers, 0)
    branch = int(from_answers(one, q[:, 0]).argmin())
    assert why(ARM, one, branch) == f"{BRANCHES[branch]}: valid"


def test_what_did_not_converge_says_how_much_is_left():
    blank = np.full((5, 8), np.nan)
    zeros = np.zeros(8)
    verdict = np.full(8, int(Verdict.NOT_CONVERGED))
    answers = Answers(blank, np.zeros((5, 8)), verdict, np.zeros(8, int), zeros, np.full(8, 3.2e-4))
    assert why(ARM, answers, 2) == f"{BRANCHES[2]}: no answer found, 0.00032 left"


def test_at_target_takes_one_of_a_batch():
    _, _, _, answers = random_case(Tool.MAHLI, 20)
    for k in range(20):
        one = at_target(answers, k)
        for name in Answers.__slots__:
            np.testing.assert_array_equal(getattr(one, name), getattr(answers, name)[..., k])


@pytest.mark.parametrize("tool", [Tool.APXS, Tool.MAHLI])
def test_a_batch_of_targets_is_its_single_targets(tool):
    """Over more than one chunk of targets, and in any shape."""
    n = 150
    _, p, a, answers = random_case(tool, n)
    shaped = inverse_kinematics(ARM, tool, p.reshape(3, 5, 30), a.reshape(3, 5, 30))
    for k in range(n):
        one = inverse_kinematics(ARM, tool, p[:, k], a[:, k])
        for name in Answers.__slots__:
            several, single = getattr(answers, name)[..., k], getattr(one, name)
            np.testing.assert_allclose(several, single, rtol=0, atol=2e-15)
            np.testing.assert_array_equal(several, getattr(shaped, name)[..., k // 30, k % 30])


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
def test_a_batch_of_hanging_targets_is_its_single_targets(name):
    """Newton counts steps for a whole batch; what has converged may be refined once more."""
    arm = config_of(name).arm
    _, p, a, answers = random_case(Tool.DRT, 100, arm, MARS_R_m_s2)
    for k in range(100):
        one = inverse_kinematics(arm, Tool.DRT, p[:, k], a[:, k], MARS_R_m_s2)
        valid = (one.verdict == Verdict.VALID) & (answers.verdict[:, k] == Verdict.VALID)
        clear = valid & (np.abs(one.output_rad[2]) > 0.2)
        np.testing.assert_allclose(answers.output_rad[:, clear, k], one.output_rad[:, clear], atol=1e-6)


def two_turns(joint):
    """An angle that the limits allow in two turns, and the two."""
    low, high = ARM.soft_min_rad[joint], ARM.soft_max_rad[joint]
    assert high - low > 2 * np.pi or joint is not Joint.WRIST
    angle = 0.5 * (low + 2 * np.pi + high)
    return angle, angle - 2 * np.pi


def test_of_joints_with_more_than_a_turn_of_travel_there_is_the_wrist():
    travel = ARM.soft_max_rad - ARM.soft_min_rad
    np.testing.assert_array_equal(np.flatnonzero(travel > 2 * np.pi), [Joint.WRIST])


def test_where_two_turns_fit_the_nearer_one_is_taken():
    high, low = two_turns(Joint.WRIST)
    q = np.array([0.0, -1.0, 1.0, high, 1.0])
    for near, expected in ((high - 0.5, high), (low + 0.5, low), (3.0, high), (-3.0, low)):
        start = np.array([0.0, -1.0, 1.0, near, 1.0])
        assert into_limits(ARM, q, start)[3] == pytest.approx(expected, abs=1e-12)
        assert into_limits(ARM, q[:, None, None], start)[3, 0, 0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("gravity", GRAVITIES)
def test_the_answer_in_the_turn_next_to_where_the_arm_is(gravity):
    high, low = two_turns(Joint.WRIST)
    for wrist in (high, low):
        q = np.array([0.1, -1.0, 1.2, wrist, 1.0])
        p, a = targets_of(q, Tool.APXS, gravity=GRAVITIES[gravity])
        answers = inverse_kinematics(ARM, Tool.APXS, p, a, GRAVITIES[gravity], near_rad=q)
        same = from_answers(answers, q).argmin()
        assert answers.verdict[same] == Verdict.VALID
        np.testing.assert_allclose(answers.output_rad[:, same], q, atol=1e-6)


def test_a_turret_near_either_end_of_its_travel_is_brought_inside():
    """Its travel is 350.2 deg: most angles fit in one turn, those in the gap in none."""
    low, high = ARM.soft_min_rad[4], ARM.soft_max_rad[4]
    for angle in (low + 0.01, high - 0.01, 0.0, np.pi):
        for turn in (-2, -1, 0, 1, 2):
            q = np.array([0.0, -1.0, 1.0, 1.0, angle + turn * 2 * np.pi])
            for near in (None, np.array([0.0, -1.0, 1.0, 1.0, high]), np.array([0.0, -1.0, 1.0, 1.0, low])):
                assert into_limits(ARM, q, near)[4] == pytest.approx(angle, abs=1e-12)
    for share in (0.2, 0.8):
        gap = high + share * (low + 2 * np.pi - high)
        over = beyond_limits(ARM, into_limits(ARM, np.array([0.0, -1.0, 1.0, 1.0, gap])))[4]
        # the turn that is least outside
        assert over == pytest.approx(min(share, 1 - share) * (low + 2 * np.pi - high), abs=1e-12)


@settings(max_examples=200)
@given(st.integers(0, 2**32 - 1))
def test_whatever_the_turn_what_comes_out_is_the_same_angle_and_inside_if_any_turn_is(seed):
    rng = np.random.default_rng(seed)
    q, near = rng.uniform(-20, 20, (5, 4)), rng.uniform(-7, 7, 5)
    for start in (None, near):
        out = into_limits(ARM, q, start)
        np.testing.assert_allclose(wrap_angle(out - q + 1.0), 1.0, atol=1e-11)
        turns = out[None] + 2 * np.pi * np.arange(-6, 7)[:, None, None]
        low, high = ARM.soft_min_rad[:, None], ARM.soft_max_rad[:, None]
        can = ((turns >= low) & (turns <= high)).any(axis=0)
        np.testing.assert_array_equal((out >= low - 1e-12) & (out <= high + 1e-12), can)
        if start is not None:
            inside = np.where((turns >= low) & (turns <= high), np.abs(turns - start[:, None]), np.inf)
            nearest = inside.min(axis=0)
            np.testing.assert_allclose(np.abs(out - start[:, None])[can], nearest[can], atol=1e-11)


def test_the_sentence_of_a_limit_is_in_degrees():
    assert outside(ARM, Joint.ELBOW, 3.0) == (
        "joint elbow: 171.9 deg is outside its soft limits -164.2 .. 164.2 deg"
    )


def test_only_a_limit_rejects_a_branch():
    """At stow, elbow-down and shoulder-in answers are as good as any (DESIGN, section 5)."""
    counts = np.zeros(8, int)
    for tool in Tool:
        _, _, _, answers = random_case(tool)
        counts += where_verdict(answers, Verdict.VALID).sum(axis=1)
    assert (counts > 0).all()
