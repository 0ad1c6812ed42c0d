"""Angles for the arm as it hangs: what refine promises is checked by letting the arm settle."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.joints import Tool
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import closed_form
from fsw.kinematics.compensation import refine, relative_target, task_error, task_jacobian
from fsw.kinematics.ik import Verdict, inverse_kinematics
from fsw.kinematics.limits import beyond_limits, into_limits
from fsw.kinematics.statics import rest, settle
from fsw.kinematics.transforms import dot
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits

ARMS = ["nominal", "as-built:3", "calibrated:3", "calibrated:11"]
TILTED_R_m_s2 = np.array([0.9, -1.2, 3.4])
RIGID = np.zeros(3)


def hanging_targets(config, tool, n, gravity):
    """Targets that the hanging arm is known to reach, well inside its limits: outputs, positions, axes."""
    q = in_limits(config, np.random.default_rng(200 + tool), n, shrink=0.1)
    q[2, np.abs(q[2]) < 0.3] = 0.5
    here = settle(config.arm, q, np.zeros_like(q), gravity)
    X = tool_pose(config.arm, here.frames, tool)
    return here.output_rad, X.p, X.R[:, 0]


def hanging(config, output_rad, gravity, tool):
    return tool_pose(config.arm, rest(config.arm, output_rad, gravity).frames, tool)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("tool", Tool)
def test_the_settled_arm_meets_the_target_that_refine_was_given(name, tool):
    config = config_of(name)
    _, p, a = hanging_targets(config, tool, 60, MARS_R_m_s2)
    p, a = (np.repeat(v[:, None], 8, axis=1) for v in (p, a))
    start = into_limits(config.arm, closed_form(config.arm, tool, p[:, 0], a[:, 0]).output_rad)
    found = refine(config.arm, tool, p, a, MARS_R_m_s2, start)
    valid = beyond_limits(config.arm, start).max(axis=0) <= 0
    assert (found.converged & valid).any(axis=0).mean() > 0.9
    ok = found.converged
    motor = found.output_rad - found.torque_Nm / config.arm.gear_stiffness_Nm_rad[:, None, None]
    motor = motor[:, ok]
    here = settle(config.arm, motor, np.zeros_like(motor), MARS_R_m_s2)
    X = tool_pose(config.arm, here.frames, tool)
    assert here.converged.all()
    assert np.abs(X.p - p[:, ok]).max() < 1e-8
    assert np.abs(X.R[:, 0] - a[:, ok]).max() < 1e-8
    np.testing.assert_allclose(here.output_rad, found.output_rad[:, ok], atol=1e-9)


def test_flight_parameters_of_the_calibrated_arm_are_not_the_drawing():
    nominal, calibrated = config_of().arm, config_of("calibrated:3").arm
    q = np.array([0.1, -1.0, 1.5, 2.0, 1.0])
    p = [tool_pose(arm, forward(arm, q), Tool.APXS).p for arm in (nominal, calibrated)]
    assert 0.002 < np.linalg.norm(p[0] - p[1]) < 0.05


@pytest.mark.parametrize("name", ARMS)
def test_without_gravity_refine_answers_for_the_rigid_arm(name):
    config = config_of(name)
    q, p, a = hanging_targets(config, Tool.APXS, 40, RIGID)
    found = refine(config.arm, Tool.APXS, p, a, RIGID, q + 0.01)
    assert found.converged.all()
    assert not found.torque_Nm.any()
    X = tool_pose(config.arm, forward(config.arm, found.output_rad), Tool.APXS)
    assert np.abs(X.p - p).max() < 1e-9
    np.testing.assert_allclose(X.R[:, 0], a, atol=1e-9)


def test_deflection_matters_by_millimetres():
    config = config_of()
    _, p, a = hanging_targets(config, Tool.DRILL, 40, MARS_R_m_s2)
    start = closed_form(config.arm, Tool.DRILL, p, a).output_rad
    p, a = (np.repeat(v[:, None], 8, axis=1) for v in (p, a))
    loaded = refine(config.arm, Tool.DRILL, p, a, MARS_R_m_s2, start)
    stiff = refine(config.arm, Tool.DRILL, p, a, RIGID, start)
    both = loaded.converged & stiff.converged
    shift = np.abs(loaded.output_rad - stiff.output_rad)[:, both].max(axis=0)
    assert 1e-3 < np.median(shift) < 0.05


def test_the_error_is_what_is_left_at_the_tool_and_the_torque_that_of_the_arm_at_rest():
    config = config_of("calibrated:3")
    q, p, a = hanging_targets(config, Tool.MAHLI, 30, TILTED_R_m_s2)
    found = refine(config.arm, Tool.MAHLI, p, a, TILTED_R_m_s2, q + 0.02, tolerance=1e-6)
    assert found.converged.all()
    assert (found.error < 1e-6).all()
    X = hanging(config, found.output_rad, TILTED_R_m_s2, Tool.MAHLI)
    assert np.abs(task_error(X, p, a)).max() < 2e-6
    at_rest = rest(config.arm, found.output_rad, TILTED_R_m_s2)
    np.testing.assert_allclose(found.torque_Nm, at_rest.torque_Nm, atol=1e-3)


def test_the_task_jacobian_agrees_with_finite_differences():
    config, h = config_of("calibrated:3"), 1e-6
    q, _, _ = hanging_targets(config, Tool.MAHLI, 20, MARS_R_m_s2)
    rng = np.random.default_rng(3)
    for angles in q.T:
        X = tool_pose(config.arm, forward(config.arm, angles), Tool.MAHLI)
        p = X.p + rng.normal(0, 0.01, 3)
        a = X.R[:, 0] + rng.normal(0, 0.05, 3)
        a /= np.linalg.norm(a)

        def error(angles, p=p, a=a):
            return task_error(tool_pose(config.arm, forward(config.arm, angles), Tool.MAHLI), p, a)

        J = task_jacobian(forward(config.arm, angles), X, a)
        for joint in range(5):
            e = h * np.eye(5)[joint]
            np.testing.assert_allclose(
                (error(angles + e) - error(angles - e)) / (2 * h), J[:, joint], atol=1e-8
            )


def test_a_tool_that_points_the_other_way_is_no_answer():
    config = config_of()
    q, p, a = hanging_targets(config, Tool.DRILL, 30, RIGID)
    found = refine(config.arm, Tool.DRILL, p, -a, RIGID, q)
    X = tool_pose(config.arm, forward(config.arm, found.output_rad), Tool.DRILL)
    faces = dot(X.R[:, 0], -a) > 0.999
    assert not (found.converged & ~faces).any()
    assert (np.abs(task_error(X, p, X.R[:, 0])[3:]) < 1e-15).all()
    assert (np.abs(task_error(X, p, -X.R[:, 0])[3:]).max(axis=0) >= 1.0).all()


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("gravity", [RIGID, MARS_R_m_s2], ids=["rigid", "mars"])
def test_a_target_out_of_reach_does_not_converge_and_raises_nothing(name, gravity):
    config = config_of(name)
    q, p, a = hanging_targets(config, Tool.APXS, 20, MARS_R_m_s2)
    for far in (p + 3.0, p + np.array([[0], [0], [50.0]]), 1e4 * p):
        found = refine(config.arm, Tool.APXS, far, a, gravity, q)
        assert not found.converged.any()
        assert (found.error[np.isfinite(found.error)] > 0.1).all()


def test_a_start_that_is_not_finite_does_not_converge_and_leaves_its_neighbours_alone():
    config = config_of()
    q, p, a = hanging_targets(config, Tool.APXS, 10, MARS_R_m_s2)
    start = q.copy()
    start[:, 3] = np.nan
    start[2, 5] = np.inf
    found = refine(config.arm, Tool.APXS, p, a, MARS_R_m_s2, start)
    np.testing.assert_array_equal(np.flatnonzero(~found.converged), [3, 5])
    assert np.isinf(found.error[[3, 5]]).all()
    assert not found.torque_Nm[:, [3, 5]].any()


def test_unreachable_neighbours_do_not_change_what_converges():
    config = config_of()
    q, p, a = hanging_targets(config, Tool.APXS, 12, MARS_R_m_s2)
    mixed = p.copy()
    mixed[:, ::3] += 2.0
    found = refine(config.arm, Tool.APXS, mixed, a, MARS_R_m_s2, q + 0.01)
    np.testing.assert_array_equal(found.converged, np.arange(12) % 3 != 0)
    alone = refine(config.arm, Tool.APXS, p, a, MARS_R_m_s2, q + 0.01)
    np.testing.assert_allclose(
        found.output_rad[:, found.converged], alone.output_rad[:, found.converged], atol=1e-9
    )


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
def test_a_batch_of_targets_is_its_single_targets(name):
    """The steps are counted for the whole batch: what has converged may be refined once more."""
    config = config_of(name)
    q, p, a = hanging_targets(config, Tool.APXS, 12, MARS_R_m_s2)
    shape = (2, 6)
    many = refine(
        config.arm, Tool.APXS, p.reshape(3, *shape), a.reshape(3, *shape), MARS_R_m_s2,
        (q + 0.01).reshape(5, *shape),
    )  # fmt: skip
    assert many.converged.shape == many.error.shape == shape
    assert many.output_rad.shape == many.torque_Nm.shape == (5, *shape)
    for index in np.ndindex(shape):
        k = np.ravel_multi_index(index, shape)
        one = refine(config.arm, Tool.APXS, p[:, k], a[:, k], MARS_R_m_s2, q[:, k] + 0.01)
        assert one.converged.shape == ()
        assert one.converged
        np.testing.assert_allclose(many.output_rad[:, *index], one.output_rad, atol=2e-9)


def test_one_target_may_have_many_starts():
    config = config_of()
    q, p, a = hanging_targets(config, Tool.APXS, 1, MARS_R_m_s2)
    starts = q + np.linspace(-0.02, 0.02, 7)
    found = refine(config.arm, Tool.APXS, p[:, 0], a[:, 0], MARS_R_m_s2, starts)
    assert found.converged.all()
    np.testing.assert_allclose(found.output_rad, np.repeat(q, 7, axis=1), atol=1e-8)


REFERENCE = np.array([0.3, -1.0, 1.6, 2.1, 1.2])


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("tool", Tool)
def test_relative_to_the_reference_pose_the_target_there_is_the_reference_pose(name, tool):
    """The rigid tool at the reference pose as target: the answer is the reference pose itself."""
    config = config_of(name)
    drawn = tool_pose(config.arm, forward(config.arm, REFERENCE), tool)
    p, a = relative_target(config.arm, tool, REFERENCE, MARS_R_m_s2, drawn.p, drawn.R[:, 0])
    hung = hanging(config, REFERENCE, MARS_R_m_s2, tool)
    np.testing.assert_allclose(p, hung.p, atol=1e-14)
    np.testing.assert_allclose(a, hung.R[:, 0], atol=1e-14)
    found = refine(config.arm, tool, p, a, MARS_R_m_s2, REFERENCE + 0.01)
    assert found.converged
    np.testing.assert_allclose(found.output_rad, REFERENCE, atol=1e-8)


def test_without_deflection_relative_is_absolute():
    config = config_of()
    _, p, a = hanging_targets(config, Tool.DRT, 8, RIGID)
    moved_p, moved_a = relative_target(config.arm, Tool.DRILL, REFERENCE, RIGID, p, a)
    np.testing.assert_allclose(moved_p, p, atol=1e-14)
    np.testing.assert_allclose(moved_a, a, atol=1e-14)


def test_only_the_difference_of_deflection_counts():
    """Near the reference, commanded angles follow the rigid arm: what both poses share cancels."""
    config = config_of()
    rng = np.random.default_rng(12)
    q = REFERENCE[:, None] + rng.uniform(-0.01, 0.01, (5, 20))
    drawn = tool_pose(config.arm, forward(config.arm, q), Tool.APXS)
    p, a = drawn.p, drawn.R[:, 0]
    absolute = refine(config.arm, Tool.APXS, p, a, MARS_R_m_s2, q)
    target = relative_target(config.arm, Tool.APXS, REFERENCE, MARS_R_m_s2, p, a)
    relative = refine(config.arm, Tool.APXS, *target, MARS_R_m_s2, q)
    assert absolute.converged.all()
    assert relative.converged.all()
    whole, rest_of_it = (np.abs(found.output_rad - q).max(axis=0) for found in (absolute, relative))
    assert (rest_of_it < 0.1 * whole).all()


def test_over_one_spot_the_shifts_of_two_tools_relative_to_each_other_cancel():
    """What one tool is shifted for, seen from the other, is what the other is shifted back; stiff springs."""
    config = config_of()
    arm = replace(config.arm, compliance=1e-3 * config.arm.compliance)
    spot = tool_pose(arm, forward(arm, REFERENCE), Tool.APXS)
    p, a = spot.p, spot.R[:, 0]
    answers = inverse_kinematics(arm, Tool.DRT, p, a)
    there = answers.output_rad[:, np.flatnonzero(answers.verdict == Verdict.VALID)[-1]]
    shifts = []
    for tool, pose, other, other_pose in (
        (Tool.DRT, there, Tool.APXS, REFERENCE),
        (Tool.APXS, REFERENCE, Tool.DRT, there),
    ):
        target = relative_target(arm, other, other_pose, MARS_R_m_s2, p, a)
        found = refine(arm, tool, *target, MARS_R_m_s2, pose)
        assert found.converged
        shifts.append(tool_pose(arm, forward(arm, found.output_rad), tool).p - p)
    assert np.linalg.norm(shifts[0]) > 2e-7
    np.testing.assert_allclose(shifts[0], -shifts[1], atol=2e-3 * np.linalg.norm(shifts[0]))


def test_relative_targets_come_in_batches():
    config = config_of()
    _, p, a = hanging_targets(config, Tool.APXS, 6, MARS_R_m_s2)
    batch = (v.reshape(3, 2, 3) for v in (p, a))
    many = relative_target(config.arm, Tool.DRILL, REFERENCE, MARS_R_m_s2, *batch)
    for k in range(6):
        one = relative_target(config.arm, Tool.DRILL, REFERENCE, MARS_R_m_s2, p[:, k], a[:, k])
        for several, single in zip(many, one, strict=True):
            np.testing.assert_allclose(several.reshape(3, 6)[:, k], single, rtol=0, atol=2e-15)


def test_with_springs_half_as_stiff_the_relative_shift_doubles():
    config = config_of()
    _, p, a = hanging_targets(config, Tool.APXS, 1, MARS_R_m_s2)
    shifts = []
    for softer in (1e-4, 2e-4):
        arm = replace(config.arm, compliance=softer * config.arm.compliance)
        moved, _ = relative_target(arm, Tool.APXS, REFERENCE, MARS_R_m_s2, p[:, 0], a[:, 0])
        shifts.append(moved - p[:, 0])
    np.testing.assert_allclose(shifts[1], 2 * shifts[0], atol=1e-4 * np.linalg.norm(shifts[0]))
