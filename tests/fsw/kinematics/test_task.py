"""The task error and its derivative, and one evaluation of the deflected arm."""

from itertools import pairwise

import numpy as np
import pytest

from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import evaluate_pose, settle_output, task_error, task_jacobian
from tests.fsw.kinematics.test_newton import RIGID, TILTED_R_m_s2, deflected_targets
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits


def test_the_task_jacobian_agrees_with_finite_differences():
    config, h = config_of("calibrated:3"), 1e-6
    q, _, _ = deflected_targets(config, "mahli", 20, MARS_R_m_s2)
    rng = np.random.default_rng(3)
    for angles in q.T:
        X = tool_pose(config.arm, forward(config.arm, angles), "mahli")
        p = X.p + rng.normal(0, 0.01, 3)
        a = X.R[:, 0] + rng.normal(0, 0.05, 3)
        a /= np.linalg.norm(a)

        def error(angles, p=p, a=a):
            return task_error(tool_pose(config.arm, forward(config.arm, angles), "mahli"), p, a)

        J = task_jacobian(forward(config.arm, angles), X, a)
        for joint in range(5):
            e = h * np.eye(5)[joint]
            np.testing.assert_allclose(
                (error(angles + e) - error(angles - e)) / (2 * h), J[:, joint], atol=1e-8
            )


def test_on_its_target_the_error_is_nothing_and_a_tool_that_looks_the_other_way_is_far_off():
    q = in_limits(config_of(), np.random.default_rng(5), 50)
    X = tool_pose(config_of().arm, forward(config_of().arm, q), "drill")
    assert np.abs(task_error(X, X.p, X.R[:, 0])).max() < 1e-15
    assert (np.abs(task_error(X, X.p, -X.R[:, 0])[3:]).max(axis=0) >= 1.0).all()


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("gravity", [MARS_R_m_s2, TILTED_R_m_s2], ids=["mars", "tilted"])
def test_repeated_evaluation_with_the_strain_that_was_found_leads_to_the_arm_at_rest(name, gravity):
    """Every pass leaves a small share of the strain change; the pose is first order in it."""
    arm = config_of(name).arm
    q = in_limits(config_of(), np.random.default_rng(6), 50)
    at_rest = settle_output(arm, q, gravity)
    there = tool_pose(arm, at_rest.frames, "apxs").p
    tried, strain, off = None, None, []
    for _ in range(8):
        tried = evaluate_pose(arm, "apxs", q, strain, gravity)
        strain = tried.strain
        off.append((tried.strain_change.max(), np.abs(tried.X_RT.p - there).max()))
    for before, after in pairwise(off[:5]):
        assert after[0] < 0.15 * before[0]
    assert off[0][1] < 2e-3
    assert off[-1][0] < 1e-9
    assert off[-1][1] < 1e-9
    np.testing.assert_allclose(tried.torque_Nm, at_rest.torque_Nm, atol=1e-6)


def test_without_gravity_the_evaluation_is_of_the_rigid_arm():
    arm = config_of("calibrated:3").arm
    q = in_limits(config_of(), np.random.default_rng(7), 20)
    tried = evaluate_pose(arm, "mahli", q, None, RIGID)
    rigid = tool_pose(arm, forward(arm, q), "mahli")
    np.testing.assert_array_equal(tried.X_RT.p, rigid.p)
    np.testing.assert_array_equal(tried.X_RT.R, rigid.R)
    assert not tried.strain.any()
    assert not tried.torque_Nm.any()
    assert not tried.strain_change.any()
