"""Fixed-point iteration from the orthogonal arm's roots to those of the real arm, far from singularities."""

import numpy as np
import pytest

from fsw.kinematics.roots import DEFLECTED_TOLERANCE, RIGID_TOLERANCE, root_tolerance, solve_fixed_point
from fsw.kinematics.statics import task_error
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.kinematics.lab import trial_of
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits

CASES = [("nominal", "mars"), ("calibrated:3", "rigid"), ("calibrated:3", "tilted")]
N = 200


def clear_targets(name, gravity):
    trial = trial_of(name, gravity, "apxs")
    q = in_limits(config_of(), np.random.default_rng(1), N, shrink=0.1)
    q[2] = np.where(np.abs(q[2]) < 0.6, 0.8, q[2])
    boresight = trial.arm.orthogonal["apxs"].clock_rad
    q[4] = np.random.default_rng(2).uniform(0.2, 1.0, N) - boresight
    X = trial.tool_pose(q)
    pull = np.zeros(3) if trial.gravity_R_m_s2 is None else trial.gravity_R_m_s2
    return trial, pull, q, X.p, X.R[:, 0]


@pytest.mark.parametrize(("name", "gravity"), CASES)
def test_from_beside_a_clear_pose_iterations_lead_to_it(name, gravity):
    trial, pull, q, p, a = clear_targets(name, gravity)
    roots = solve_fixed_point(trial.arm, "apxs", p, a, pull, q + 0.005, np.ones(N), np.ones(N, bool))
    good = roots.followed & (roots.error < root_tolerance(pull))
    assert good.mean() > 0.9
    X = trial.tool_pose(roots.output_rad[:, good])
    assert np.abs(task_error(X, p[:, good], a[:, good])).max() < 5 * root_tolerance(pull)
    assert np.quantile(np.abs(wrap_angle(roots.output_rad - q)).max(axis=0)[good], 0.95) < 1e-5


def test_roots_that_are_not_selected_stay_as_they_were():
    trial, pull, q, p, a = clear_targets("nominal", "mars")
    selected = np.arange(N) % 2 == 0
    roots = solve_fixed_point(trial.arm, "apxs", p, a, pull, q + 0.005, np.ones(N), selected)
    np.testing.assert_array_equal(roots.output_rad[:, ~selected], q[:, ~selected] + 0.005)
    assert np.isinf(roots.error[~selected]).all()
    assert not roots.followed[~selected].any()
    assert not roots.torque_Nm[:, ~selected].any()


def test_a_root_far_outside_the_limits_is_given_up_after_the_first_iteration():
    trial, pull, q, *_ = clear_targets("nominal", "mars")
    q = q.copy()
    q[0] = trial.arm.soft_max_rad[0] + 0.3
    X = trial.tool_pose(q)
    roots = solve_fixed_point(trial.arm, "apxs", X.p, X.R[:, 0], pull, q, np.ones(N), np.ones(N, bool))
    assert not roots.followed.any()
    # the first iteration gives a rough estimate
    assert np.quantile(np.abs(wrap_angle(roots.output_rad - q)).max(axis=0), 0.9) < 0.05


def test_the_tolerance_is_tighter_for_the_rigid_arm():
    assert root_tolerance(np.zeros(3)) == RIGID_TOLERANCE < root_tolerance(MARS_R_m_s2) == DEFLECTED_TOLERANCE


def test_a_batch_of_roots_is_its_single_roots():
    trial, pull, q, p, a = clear_targets("calibrated:3", "tilted")
    many = solve_fixed_point(trial.arm, "apxs", p, a, pull, q + 0.005, np.ones(N), np.ones(N, bool))
    for k in range(0, N, 20):
        here = slice(k, k + 1)
        one = solve_fixed_point(
            trial.arm,
            "apxs",
            p[:, here],
            a[:, here],
            pull,
            q[:, here] + 0.005,
            np.ones(1),
            np.ones(1, bool),
        )
        np.testing.assert_allclose(many.output_rad[:, here], one.output_rad, rtol=0, atol=1e-12)
        assert many.followed[k] == one.followed[0]
