"""The closed form: eight roots of the orthogonal arm, for any tool, checked by forward kinematics."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.kinematics.arm import build_orthogonal_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import closed_form, closed_form_branch, fold_distances
from fsw.kinematics.ik import FREE_SINE
from fsw.kinematics.statics import task_error, task_jacobian
from fsw.kinematics.transforms import Pose, rotation_y, wrap_angle
from helpers.marks import slow_but
from tests.fsw.rig import config_of, in_limits
from tests.tools import TOOLS
from validation.kinematics import Trial, draw_vectors, skew_tool

N = 2000
ARM = config_of().arm
TOOL = "drill"
OFFSET_M = 0.06
TILT_RAD = 0.8
MEETS = 1e-9
SAME_RAD = 1e-6


def with_tool(R, p_m):
    """Build the arm of the drawing with this tool frame instead of its tools."""
    X_FT, X_LF = Pose(np.array(R), np.array(p_m)), Pose(ARM.X_CF.R, ARM.X_CF.p + ARM.p_LC_m)
    shape = build_orthogonal_arm(ARM.theta_rad, X_LF, X_FT)
    return replace(ARM, X_FT=dict.fromkeys(TOOLS, X_FT), orthogonal=dict.fromkeys(TOOLS, shape))


def targets_of(arm, q, tool=TOOL):
    """Compute positions, approaches, and the distance of each pose from a singularity."""
    frames = forward(arm, q)
    X = tool_pose(arm, frames, tool)
    J = task_jacobian(frames, X, X.R[:, 0])
    return X.p, X.R[:, 0], np.linalg.svd(np.moveaxis(J, -1, 0), compute_uv=False)[:, -1]


def nearest(roots, q):
    """Compute the distance of the nearest root from each pose, modulo turns."""
    return np.abs(wrap_angle(roots.output_rad - q[:, None])).max(axis=0).min(axis=0)


def worst_error(arm, roots, p, a, tool=TOOL):
    X = tool_pose(arm, forward(arm, roots.output_rad), tool)
    return np.abs(task_error(X, p[:, None], a[:, None])).max(axis=0)


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
    return with_tool(R, X.p + np.array([0.0, offset_m, 0.0]))


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
    assert worst_error(arm, roots, p, a)[there].max() < MEETS
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
