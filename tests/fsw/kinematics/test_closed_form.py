"""The closed form: eight roots of the orthogonal arm, for any tool, and the names of their branches."""

from itertools import product

import numpy as np
import pytest

from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import BRANCHES, branch_index, closed_form, closed_form_branch, fold_distances
from fsw.kinematics.ik import FREE_SINE
from fsw.kinematics.statics import task_error, task_jacobian
from fsw.kinematics.transforms import Pose, rotation_y, wrap_angle
from helpers.marks import slow_but
from tests.fsw.rig import config_of, in_limits
from tests.tools import TOOLS
from validation.kinematics import Trial, draw_vectors, skew_tool, with_tool

N = 2000
ARM = config_of().arm
TOOL = "drill"
OFFSET_M = 0.06
TILT_RAD = 0.8
MEETS = 1e-9
SAME_RAD = 1e-6


def targets_of(arm, q, tool=TOOL):
    """Compute positions, approaches, and the distance of each pose from a singularity."""
    frames = forward(arm, q)
    X = tool_pose(arm, frames, tool)
    J = task_jacobian(frames, X, X.R[:, 0])
    return X.p, X.R[:, 0], np.linalg.svd(np.moveaxis(J, -1, 0), compute_uv=False)[:, -1]


def nearest(roots, q):
    """Compute the distance of the nearest root from each pose, modulo turns."""
    return np.abs(wrap_angle(roots.output_rad - q[:, None])).max(axis=0).min(axis=0)


def test_the_drawing_is_orthogonal_its_tools_radial_and_the_shape_of_other_tools_is_read():
    for s in ARM.orthogonal.values():
        assert s.is_exact
        # to the accuracy of the angles in the tool table
        assert max(abs(s.offset_m), abs(s.boresight_z)) < 1e-15
    assert not config_of("calibrated:3").arm.orthogonal[TOOL].is_exact
    assert skew_tool(1).orthogonal[TOOL].is_exact
    s = tool_of_the_drawing_but(0.03, 0.2).orthogonal[TOOL]
    assert abs(s.offset_m) == pytest.approx(0.03 / np.cos(0.2), rel=1e-12)
    assert abs(s.boresight_z) == pytest.approx(np.sin(0.2), rel=1e-12)


def tool_of_the_drawing_but(offset_m=0.0, lean_rad=0.0):
    """Return the drill frame moved sideways by a bracket, or tilted up."""
    X = ARM.X_FT["drill"]
    R = X.R @ rotation_y(np.array(lean_rad))
    return with_tool(ARM, Pose(R, X.p + np.array([0.0, offset_m, 0.0])))


SHAPES = {"lean": (0.0, 1.2), "aside": (OFFSET_M, 0.0), "skew": (OFFSET_M, TILT_RAD)}
OFFSET = [(tool_of_the_drawing_but(offset_m), 9, 5 * N) for offset_m in (1e-3, 0.03, 0.06, 0.15)]
SKEW = [(skew_tool(seed, *shape), seed, N) for seed in range(12) for shape in SHAPES.values()]
ANY_TOOL = slow_but(SKEW + OFFSET, *SKEW[:12], OFFSET[1])


@pytest.mark.parametrize(("arm", "seed", "n"), ANY_TOOL)
def test_every_root_of_any_tool_meets_its_target_and_the_pose_that_made_it_is_among_them(arm, seed, n):
    q = in_limits(config_of(), np.random.default_rng(seed), n)
    p, a, clear = targets_of(arm, q)
    roots = closed_form(arm, TOOL, p, a)
    there = (roots.missing_m == 0) & (roots.wrist_sine > FREE_SINE)
    assert there.mean() > 0.5
    X = tool_pose(arm, forward(arm, roots.output_rad), TOOL)
    assert np.abs(task_error(X, p[:, None], a[:, None])).max(axis=0)[there].max() < MEETS
    assert (clear > 1e-4).mean() > 0.99
    assert nearest(roots, q)[clear > 1e-4].max() < SAME_RAD


@pytest.mark.parametrize("seed", range(4))
def test_no_root_of_a_skew_tool_is_lost_next_to_double_roots(seed):
    """The targets have straight elbows, approaches along the pitch axes, or wrists on the azimuth axis."""
    trial = Trial(f"skew:{seed}", skew_tool(seed), TOOL, None)
    q, near = draw_vectors(trial, np.random.default_rng(seed), 5 * N)
    q = q[:, near > 0]
    p, a, clear = targets_of(trial.arm, q)
    roots = closed_form(trial.arm, TOOL, p, a)
    assert q.shape[1] > N
    assert nearest(roots, q)[clear > 1e-4].max() < SAME_RAD


def test_a_bend_kept_from_straight_is_kept():
    q = in_limits(config_of(), np.random.default_rng(4), 500)
    q[2] = np.random.default_rng(5).uniform(-0.1, 0.1, 500)
    p, a, _ = targets_of(ARM, q)
    bend = closed_form(ARM, TOOL, p, a, least_bend_rad=0.15).output_rad[2]
    assert (np.abs(bend) >= 0.15 - 1e-12).all()
    assert (np.abs(wrap_angle(bend)) <= np.pi - 0.15 + 1e-12).all()


@pytest.mark.parametrize("arm", [ARM, skew_tool(3)], ids=["drawing", "skew"])
def test_on_the_branch_of_a_pose_is_the_pose_that_made_the_target(arm):
    """The start may be beside the pose, on the same side of every fold."""
    s, rng = arm.orthogonal[TOOL], np.random.default_rng(8)
    q = in_limits(config_of(), rng, N)
    p, a, _ = targets_of(arm, q)
    near = q + rng.uniform(-0.01, 0.01, q.shape)
    clear = np.abs(fold_distances(s, q)).min(axis=0) > 0.15
    assert clear.sum() > N / 2
    at, missing = closed_form_branch(s, p[:, clear], a[:, clear], near[:, clear])
    assert np.abs(wrap_angle(at - q[:, clear])).max() < SAME_RAD
    assert missing.max() < MEETS


COUNT = 3000
# distance from the turret axis to each tool point, from the drawing
RADIUS_M = {"drill": 0.360, "drt": 0.299, "mahli": 0.2973, "apxs": 0.2983, "portion": 0.2761}


def poses(n=COUNT):
    return in_limits(config_of(), np.random.default_rng(11), n)


def named(words, index):
    """Find the branches with this word in their names."""
    return np.array([words in name for name in BRANCHES])[index]


def test_there_are_eight_branches_with_names_of_their_own():
    words = product(("shoulder-out", "shoulder-in"), ("elbow-up", "elbow-down"), ("wrist-up", "wrist-down"))
    assert sorted(BRANCHES) == sorted(" ".join(three) for three in words)


@pytest.mark.parametrize("tool", TOOLS)
def test_out_looks_toward_the_foot_of_the_turret_axis_and_wrists_carry_it_on_either_side(tool):
    q = poses()
    frames = forward(ARM, q)
    X = tool_pose(ARM, frames, tool)
    foot = X.p - RADIUS_M[tool] * X.R[:, 0]
    ahead_m = np.sum(frames.X_RF.R[:, 0, 1] * (foot - frames.X_RF.p[:, 0]), axis=0)
    n, z5 = frames.X_RF.R[:, 2, 1], frames.X_RF.R[:, 2, 4]
    sine = np.sum(np.cross(n, X.R[:, 0], axis=0) * z5, axis=0)
    signs = fold_distances(ARM.orthogonal[tool], q)
    np.testing.assert_allclose(signs[[0, 2]], [-ahead_m, sine], atol=1e-12)
    np.testing.assert_array_equal(named("shoulder-out", branch_index(signs)), ahead_m > 0)
    np.testing.assert_array_equal(named("wrist-up", branch_index(signs)), sine < 0)


def test_up_is_the_elbow_above_the_line_from_shoulder_to_wrist():
    q = poses()
    frames = forward(ARM, q)
    shoulder, elbow, wrist = (frames.X_RF.p[:, k] for k in (1, 2, 3))
    # z is down
    chord = wrist - shoulder
    share = np.sum((elbow - shoulder) * chord, axis=0) / np.sum(chord * chord, axis=0)
    above_m = (shoulder + share * chord - elbow)[2]
    signs = fold_distances(ARM.orthogonal["apxs"], q)
    clear = np.abs(above_m) > 1e-9
    up = named("elbow-up", branch_index(signs))
    np.testing.assert_array_equal(up[clear], (above_m > 0)[clear])
    np.testing.assert_allclose(np.abs(signs[1]), np.abs(np.sin(q[2])), atol=1e-12)
    assert 0.2 < up.mean() < 0.8
