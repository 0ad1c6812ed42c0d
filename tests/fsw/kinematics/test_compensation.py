"""Angles for the arm as it hangs: what refine promises is checked by letting the arm settle."""

import numpy as np
import pytest

from fsw.dictionary.joints import Tool
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.compensation import refine, task_error, task_jacobian
from fsw.kinematics.ik import Verdict, closed_form
from fsw.kinematics.statics import settle
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits

ARMS = ["nominal", "as-built:3", "calibrated:3", "calibrated:11"]


def hanging_targets(config, tool, n, gravity):
    """Targets that the hanging arm is known to reach, well inside its limits."""
    q = in_limits(config, np.random.default_rng(200 + tool), n, shrink=0.1)
    q[np.abs(q[:, 2]) < 0.3, 2] = 0.5
    here = settle(config.arm, q, np.zeros_like(q), gravity)
    X = tool_pose(config.arm, here.frames, tool)
    return here.output_rad, X[:, :3, 3], X[:, :3, 0]


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("tool", Tool)
def test_the_settled_arm_meets_the_target_that_refine_was_given(name, tool):
    config = config_of(name)
    _, p, a = hanging_targets(config, tool, 60, MARS_R_m_s2)
    rigid = closed_form(config.arm, tool, p, a)
    found = refine(config.arm, tool, p[:, None], a[:, None], MARS_R_m_s2, rigid.output_rad)
    assert (found.converged & (rigid.verdict == Verdict.VALID)).any(axis=1).mean() > 0.9
    motor = found.output_rad - found.torque_Nm / config.arm.gear_stiffness_Nm_rad
    ok = found.converged
    here = settle(config.arm, motor[ok], np.zeros_like(motor[ok]), MARS_R_m_s2)
    X = tool_pose(config.arm, here.frames, tool)
    wanted_p, wanted_a = (np.broadcast_to(v[:, None], (60, 8, 3))[ok] for v in (p, a))
    assert here.converged.all()
    assert np.abs(X[:, :3, 3] - wanted_p).max() < 1e-8
    assert np.abs(X[:, :3, 0] - wanted_a).max() < 1e-8


def test_flight_parameters_of_the_calibrated_arm_are_not_the_drawing():
    nominal, calibrated = config_of().arm, config_of("calibrated:3").arm
    q = np.array([0.1, -1.0, 1.5, 2.0, 1.0])
    p = [tool_pose(arm, forward(arm, q), Tool.APXS)[:3, 3] for arm in (nominal, calibrated)]
    assert 0.002 < np.linalg.norm(p[0] - p[1]) < 0.05


@pytest.mark.parametrize("name", ARMS)
def test_without_gravity_refine_answers_for_the_rigid_arm(name):
    config = config_of(name)
    q, p, a = hanging_targets(config, Tool.APXS, 40, np.zeros(3))
    found = refine(config.arm, Tool.APXS, p, a, np.zeros(3), q + 0.01)
    assert found.converged.all()
    assert not found.torque_Nm.any()
    X = tool_pose(config.arm, forward(config.arm, found.output_rad), Tool.APXS)
    assert np.abs(X[:, :3, 3] - p).max() < 1e-9


def test_deflection_matters_by_millimetres():
    config = config_of()
    _, p, a = hanging_targets(config, Tool.DRILL, 40, MARS_R_m_s2)
    start = closed_form(config.arm, Tool.DRILL, p, a).output_rad
    hanging = refine(config.arm, Tool.DRILL, p[:, None], a[:, None], MARS_R_m_s2, start)
    stiff = refine(config.arm, Tool.DRILL, p[:, None], a[:, None], np.zeros(3), start)
    both = hanging.converged & stiff.converged
    shift = np.abs(hanging.output_rad - stiff.output_rad)[both].max(axis=-1)
    assert 1e-3 < np.median(shift) < 0.05


def test_the_task_jacobian_agrees_with_finite_differences():
    config, h = config_of("calibrated:3"), 1e-6
    q, _, _ = hanging_targets(config, Tool.MAHLI, 20, MARS_R_m_s2)
    rng = np.random.default_rng(3)
    for angles in q:
        X = tool_pose(config.arm, forward(config.arm, angles), Tool.MAHLI)
        p = X[:3, 3] + rng.normal(0, 0.01, 3)
        a = X[:3, 0] + rng.normal(0, 0.05, 3)
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
    q, p, a = hanging_targets(config, Tool.DRILL, 30, np.zeros(3))
    found = refine(config.arm, Tool.DRILL, p, -a, np.zeros(3), q)
    X = tool_pose(config.arm, forward(config.arm, found.output_rad), Tool.DRILL)
    faces = np.sum(X[:, :3, 0] * -a, axis=-1) > 0.999
    assert not (found.converged & ~faces).any()


@pytest.mark.parametrize("name", ARMS)
def test_a_target_out_of_reach_does_not_converge_and_raises_nothing(name):
    config = config_of(name)
    q, p, a = hanging_targets(config, Tool.APXS, 20, MARS_R_m_s2)
    for far in (p + 3.0, p + np.array([0, 0, 50.0]), 1e4 * p):
        found = refine(config.arm, Tool.APXS, far, a, MARS_R_m_s2, q)
        assert not found.converged.any()
        assert (found.error[np.isfinite(found.error)] > 0.1).all()


def test_a_start_that_is_not_finite_does_not_converge_and_leaves_its_neighbours_alone():
    config = config_of()
    q, p, a = hanging_targets(config, Tool.APXS, 10, MARS_R_m_s2)
    start = q.copy()
    start[3] = np.nan
    found = refine(config.arm, Tool.APXS, p, a, MARS_R_m_s2, start)
    assert not found.converged[3]
    assert np.delete(found.converged, 3).all()
