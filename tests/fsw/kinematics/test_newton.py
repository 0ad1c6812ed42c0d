"""Newton steps to roots of the deflected arm, checked by its static equilibrium."""

import numpy as np
import pytest

from fsw.kinematics.arm import limit_excess, wrap_into_limits
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import closed_form
from fsw.kinematics.roots import TASK_TOLERANCE, refine_roots
from fsw.kinematics.statics import ROOT_TOLERANCE, settle, settle_output, task_error
from fsw.kinematics.transforms import dot
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits
from tests.tools import TOOLS, tool_index

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


def deflected_tool(config, output_rad, gravity, tool):
    return tool_pose(config.arm, settle_output(config.arm, output_rad, gravity).frames, tool)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("tool", TOOLS)
def test_the_settled_arm_meets_the_target_that_newton_was_given(name, tool):
    config = config_of(name)
    _, p, a = deflected_targets(config, tool, 60, MARS_R_m_s2)
    p, a = (np.repeat(v[:, None], 8, axis=1) for v in (p, a))
    start = wrap_into_limits(config.arm, closed_form(config.arm, tool, p[:, 0], a[:, 0]).output_rad)
    found = refine_roots(config.arm, tool, p, a, MARS_R_m_s2, start)
    valid = limit_excess(config.arm, start).max(axis=0) <= 0
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
    p = [tool_pose(arm, forward(arm, q), "apxs").p for arm in (nominal, calibrated)]
    assert 0.002 < np.linalg.norm(p[0] - p[1]) < 0.05


@pytest.mark.parametrize("name", ARMS)
def test_without_gravity_newton_solves_the_rigid_arm(name):
    config = config_of(name)
    q, p, a = deflected_targets(config, "apxs", 40, RIGID)
    found = refine_roots(config.arm, "apxs", p, a, RIGID, q + 0.01)
    assert found.converged.all()
    assert not found.torque_Nm.any()
    X = tool_pose(config.arm, forward(config.arm, found.output_rad), "apxs")
    assert np.abs(X.p - p).max() < 1e-9
    np.testing.assert_allclose(X.R[:, 0], a, atol=1e-9)


def test_deflection_matters_by_millimetres():
    config = config_of()
    _, p, a = deflected_targets(config, "drill", 40, MARS_R_m_s2)
    start = closed_form(config.arm, "drill", p, a).output_rad
    p, a = (np.repeat(v[:, None], 8, axis=1) for v in (p, a))
    loaded = refine_roots(config.arm, "drill", p, a, MARS_R_m_s2, start)
    stiff = refine_roots(config.arm, "drill", p, a, RIGID, start)
    both = loaded.converged & stiff.converged
    shift = np.abs(loaded.output_rad - stiff.output_rad)[:, both].max(axis=0)
    assert 1e-3 < np.median(shift) < 0.05


def test_the_error_is_what_is_left_at_the_tool_and_the_torque_that_of_the_arm_at_rest():
    config = config_of("calibrated:3")
    q, p, a = deflected_targets(config, "mahli", 30, TILTED_R_m_s2)
    found = refine_roots(config.arm, "mahli", p, a, TILTED_R_m_s2, q + 0.02)
    assert found.converged.all()
    assert (found.error < TASK_TOLERANCE).all()
    X = deflected_tool(config, found.output_rad, TILTED_R_m_s2, "mahli")
    assert np.abs(task_error(X, p, a)).max() < 1e-10
    at_rest = settle_output(config.arm, found.output_rad, TILTED_R_m_s2)
    np.testing.assert_allclose(found.torque_Nm, at_rest.torque_Nm, atol=1e-6)


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("gravity", [RIGID, MARS_R_m_s2, TILTED_R_m_s2], ids=["rigid", "mars", "tilted"])
def test_next_to_a_double_root_what_converges_meets_its_target(name, gravity):
    """A converged root has a true error below the tolerance, and nearly every start converges."""
    config, rng = config_of(name), np.random.default_rng(15)
    q = in_limits(config_of(), rng, 200, shrink=0.1)
    q[2] = 10.0 ** rng.uniform(-6, -2, 200) * rng.choice([-1, 1], 200)
    X = deflected_tool(config, q, gravity, "apxs")
    found = refine_roots(config.arm, "apxs", X.p, X.R[:, 0], gravity, q + 0.03)
    assert found.converged.mean() > 0.9
    np.testing.assert_array_equal(found.converged, found.error < ROOT_TOLERANCE)
    ok = found.converged
    here = deflected_tool(config, found.output_rad[:, ok], gravity, "apxs")
    assert np.abs(task_error(here, X.p[:, ok], X.R[:, 0][:, ok])).max() < 2 * ROOT_TOLERANCE


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
def test_a_target_out_of_reach_does_not_converge_and_raises_nothing(name, gravity):
    config = config_of(name)
    q, p, a = deflected_targets(config, "apxs", 20, MARS_R_m_s2)
    for far in (p + 3.0, p + np.array([[0], [0], [50.0]]), 1e4 * p):
        found = refine_roots(config.arm, "apxs", far, a, gravity, q)
        assert not found.converged.any()
        assert (found.error[np.isfinite(found.error)] > 0.1).all()


def test_a_start_that_is_not_finite_does_not_converge_and_leaves_its_neighbours_alone():
    config = config_of()
    q, p, a = deflected_targets(config, "apxs", 10, MARS_R_m_s2)
    start = q.copy()
    start[:, 3] = np.nan
    start[2, 5] = np.inf
    found = refine_roots(config.arm, "apxs", p, a, MARS_R_m_s2, start)
    np.testing.assert_array_equal(np.flatnonzero(~found.converged), [3, 5])
    assert np.isinf(found.error[[3, 5]]).all()
    assert not found.torque_Nm[:, [3, 5]].any()


def test_unreachable_neighbours_do_not_change_what_converges():
    config = config_of()
    q, p, a = deflected_targets(config, "apxs", 12, MARS_R_m_s2)
    mixed = p.copy()
    mixed[:, ::3] += 2.0
    found = refine_roots(config.arm, "apxs", mixed, a, MARS_R_m_s2, q + 0.01)
    np.testing.assert_array_equal(found.converged, np.arange(12) % 3 != 0)
    alone = refine_roots(config.arm, "apxs", p, a, MARS_R_m_s2, q + 0.01)
    np.testing.assert_allclose(
        found.output_rad[:, found.converged], alone.output_rad[:, found.converged], atol=1e-9
    )


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
def test_a_batch_of_targets_is_its_single_targets(name):
    config = config_of(name)
    q, p, a = deflected_targets(config, "apxs", 12, MARS_R_m_s2)
    shape = (2, 6)
    many = refine_roots(
        config.arm, "apxs", p.reshape(3, *shape), a.reshape(3, *shape), MARS_R_m_s2,
        (q + 0.01).reshape(5, *shape),
    )  # fmt: skip
    assert many.converged.shape == many.error.shape == shape
    assert many.output_rad.shape == many.torque_Nm.shape == (5, *shape)
    for index in np.ndindex(shape):
        k = np.ravel_multi_index(index, shape)
        one = refine_roots(config.arm, "apxs", p[:, k], a[:, k], MARS_R_m_s2, q[:, k] + 0.01)
        assert one.converged.shape == ()
        assert one.converged
        np.testing.assert_allclose(many.output_rad[:, *index], one.output_rad, rtol=0, atol=1e-12)


def test_one_target_may_have_many_starts():
    config = config_of()
    q, p, a = deflected_targets(config, "apxs", 1, MARS_R_m_s2)
    starts = q + np.linspace(-0.02, 0.02, 7)
    found = refine_roots(config.arm, "apxs", p[:, 0], a[:, 0], MARS_R_m_s2, starts)
    assert found.converged.all()
    np.testing.assert_allclose(found.output_rad, np.repeat(q, 7, axis=1), atol=1e-8)
