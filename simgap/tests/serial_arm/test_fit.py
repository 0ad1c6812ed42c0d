"""Least squares with priors on a planar arm with any number of joints."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import binom, kstest

from helpers.serial_planar import Planar, parameters
from simgap.serial_arm import fit


@pytest.mark.parametrize("joints", [1, 3, 6])
@pytest.mark.parametrize("prior", [np.inf, 2e-3])
def test_the_optimum_is_that_of_least_squares(joints, prior):
    rng = np.random.default_rng(joints)
    model = Planar(rng, joints, lengths=3e-3 * rng.standard_normal(2 * joints))
    unknowns = parameters(joints, prior)

    def residual(x):
        return np.concatenate([model(x).residual.ravel(), x / prior])

    found = fit.fit(unknowns, model)
    other = least_squares(residual, np.zeros(2 * joints), x_scale=1e-3, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert found.converged
    np.testing.assert_allclose(found.values, other.x, atol=1e-3 * found.sigma.min())


def test_far_from_the_optimum_damping_finds_the_way():
    rng = np.random.default_rng(3)
    model = Planar(rng, 3, lengths=np.array([0.1, -0.1, 0.2, 1.2, -0.9, 0.7]))
    found = fit.fit(parameters(3), model)
    assert found.converged
    assert 0.7 < found.sigma0 < 1.3


def test_intervals_cover_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(4)
    inside = []
    for _ in range(100):
        truth = 2e-3 * rng.standard_normal(6)
        found = fit.fit(parameters(3, 2e-3), Planar(rng, 3, 20, truth))
        inside.append(np.abs(found.values - truth) < 1.645 * found.sigma)
    low, high = binom.interval(0.999, 100, 0.9)
    assert np.all((np.sum(inside, axis=0) >= low) & (np.sum(inside, axis=0) <= high))


def test_the_p_value_is_uniform_where_the_noise_is_what_was_said():
    rng = np.random.default_rng(5)
    found = [fit.fit(parameters(3), Planar(rng)).p_value for _ in range(200)]
    assert kstest(found, "uniform").pvalue > 0.01


def test_noise_that_is_larger_than_said_is_told():
    model = Planar(np.random.default_rng(6))
    quiet = fit.fit(parameters(3), lambda x: fit.Linearisation(2 * model(x).residual, 2 * model(x).jacobian))
    assert quiet.sigma0 == pytest.approx(2, rel=0.2)
    assert quiet.p_value < 1e-6


def test_joints_that_never_move_are_one_with_what_they_cannot_be_told_from():
    """With the second joint locked, two links act as one: only combinations are identified."""
    rng = np.random.default_rng(7)
    angles = rng.uniform(-2, 2, (3, 60))
    angles[1] = 0.3
    model = Planar(rng, 3, angles=angles)
    found = fit.assess_identifiability(parameters(3), model(np.zeros(6)))
    assert found.rank == 4
    (confused,) = found.unidentifiable_groups()
    assert set(confused.names) == {"length0", "length1", "zero0", "zero1", "zero2"}
    assert confused.identified == 3


def test_what_neither_data_nor_prior_tell_stays_and_has_no_sigma():
    rng = np.random.default_rng(8)
    angles = rng.uniform(-2, 2, (2, 60))
    angles[1] = 0.0
    found = fit.fit(parameters(2), Planar(rng, 2, angles=angles, lengths=np.array([1e-3, 1e-3, 0, 0])))
    assert found.converged
    assert np.isinf(found.sigma[[0, 1, 3]]).all()
    assert np.isfinite(found.sigma[2]) or found.unconstrained[2] > 0
    assert found.values[0] + found.values[1] == pytest.approx(2e-3, abs=1e-4)


def test_the_distance_of_a_pose_is_that_from_a_fit_without_it():
    rng = np.random.default_rng(13)
    model = Planar(rng, poses=12)
    found = fit.fit(parameters(3), model)
    used = np.arange(12) != 5
    others = fit.fit(parameters(3), model, used=used)
    left, expected = (fit.leave_one_out_distance(one)[5] for one in (found, others))
    assert left == pytest.approx(expected, rel=1e-2)


def test_fresh_poses_are_off_by_what_noise_and_covariance_let_expect():
    rng = np.random.default_rng(14)
    ratios = []
    for _ in range(30):
        truth = 2e-3 * rng.standard_normal(6)
        model, fresh = (Planar(rng, 3, poses, truth) for poses in (10, 200))
        found = fit.fit(parameters(3), model)
        ratios.append(fit.validate_hold_out(found, fresh(found.values)).ratio)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.15)


def test_a_fit_is_the_same_to_the_last_bit_every_time():
    model = Planar(np.random.default_rng(15))
    one, other = fit.fit(parameters(3), model), fit.fit(parameters(3), model)
    assert np.array_equal(one.values, other.values)
    assert replace(one, values=other.values).sigma0 == other.sigma0
