"""Tests of scores against chance keep their level with few and uneven motions."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2, norm

from helpers.marks import slow_but
from simgap.arrays import orthonormal
from simgap.selection import chance

N, MEMORY = 60, 0.9
"""Samples of a motion, and share of the noise that a sample keeps of the one before."""


def draw(random, n_motions):
    """Return a base change, changes of smooth motions and noise with memory, (n_motions * N, ..)."""
    phase = random.uniform(0.0, 2.0 * np.pi, (n_motions, 1)) + np.linspace(0.0, 6.0, N)
    x = (np.sin(phase) * random.uniform(0.2, 1.0, (n_motions, 1))).ravel()
    fresh = random.standard_normal((n_motions, 3 * N)) * random.uniform(0.5, 2.0, (n_motions, 1))
    noise = lfilter([1.0], [1.0, -MEMORY], fresh, axis=1)[:, 2 * N :].ravel()
    return x[:, None], np.column_stack([x**2, np.sin(4.0 * x), x > 0.9 * x.max()]), noise


def probability(random, n_motions, columns):
    """Return the probability of an effect that is absent."""
    base, change, noise = draw(random, n_motions)
    basis, _ = np.linalg.qr(base)
    change, noise = (part - basis @ (basis.T @ part) for part in (change[:, columns], noise))
    best = change @ np.linalg.lstsq(change, noise, rcond=None)[0]
    return chance.wald_p(basis, best, noise, np.repeat(np.arange(n_motions), N), len(columns))


def most_of(n, level):
    """Return the count that chance exceeds in one of a thousand cases."""
    return n * level + 3.1 * np.sqrt(n * level * (1.0 - level))


@pytest.mark.parametrize("n_motions", slow_but([4, 6, 8], 4))
@pytest.mark.parametrize("columns", [[0], [0, 1], [2]], ids=["one size", "two sizes", "in few samples"])
def test_an_absent_effect_is_as_rare_as_its_probability_says(n_motions, columns):
    random = np.random.default_rng(n_motions)
    found = np.array([probability(random, n_motions, columns) for _ in range(200)])
    for level in (0.05, 0.01):
        assert np.sum(found <= level) <= most_of(200, level)


def test_an_effect_that_shows_in_one_motion_alone_is_no_proof():
    basis, change = np.zeros((4 * N, 0)), np.zeros(4 * N)
    change[:N] = 1.0
    residual = change + 1e-3 * np.random.default_rng(1).standard_normal(4 * N)
    assert chance.wald_p(basis, change, residual, np.repeat(np.arange(4), N), 1) == 1.0


def test_a_strong_effect_is_proven_by_four_motions():
    random = np.random.default_rng(3)
    base, change, noise = draw(random, 4)
    basis, _ = np.linalg.qr(base)
    part = change[:, 0] - basis @ (basis.T @ change[:, 0])
    noise = noise - basis @ (basis.T @ noise)
    assert chance.wald_p(basis, part, 3000.0 * part + noise, np.repeat(np.arange(4), N), 1) < 1e-3


def stationary(random, columns, strength=0.0):
    """Return the probability of an effect in noise that is the same in six motions, by both tests."""
    base, change, _ = draw(random, 6)
    fresh = random.standard_normal((6, 3 * N))
    noise = lfilter([1.0], [1.0, -MEMORY], fresh, axis=1)[:, 2 * N :].ravel()
    basis, _ = np.linalg.qr(base)
    change, noise = (part - basis @ (basis.T @ part) for part in (change[:, columns], noise))
    residual = noise + strength * change[:, 0]
    best = change @ np.linalg.lstsq(change, residual, rcond=None)[0]
    cluster = np.arange(6 * N) // 20
    beside = chance.stationary_p(1, best, residual, cluster, len(columns))
    return beside, chance.wald_p(basis, best, residual, cluster, len(columns))


@pytest.mark.parametrize("columns", slow_but([[0], [0, 1], [2]], [0]))
def test_in_stationary_noise_an_absent_effect_is_as_rare_as_its_probability_says(columns):
    random = np.random.default_rng(len(columns))
    found = np.array([stationary(random, columns)[0] for _ in range(200)])
    for level in (0.05, 0.01):
        assert np.sum(found <= level) <= most_of(200, level)


def test_in_stationary_noise_an_effect_in_few_samples_is_proven():
    random = np.random.default_rng(8)
    found = np.array([stationary(random, [2], 12.0) for _ in range(20)])
    assert np.median(found[:, 0]) < 1e-3
    assert np.median(found[:, 0]) < np.median(found[:, 1])


def test_the_best_of_directions_that_are_alike_raises_no_more_false_alarms_than_their_count_says():
    random = np.random.default_rng(6)
    common = random.standard_normal((400, 3))
    table = np.column_stack([common @ random.standard_normal(3) for _ in range(12)])
    table += 0.1 * random.standard_normal(table.shape)
    unit = table / np.linalg.norm(table, axis=0)
    level = 0.05 / chance.count_distinct(list(unit.T))
    z = random.standard_normal((4000, 400)) @ unit
    false_alarms = np.sum(np.max(np.abs(z), axis=1) > norm.isf(level / 2.0))
    assert false_alarms <= most_of(4000, 0.05)


def alternative(random, n_motions, strength, others):
    """Return the probability of the square, which is the cause, and that of the best of other changes."""
    base, change, noise = draw(random, n_motions)
    residual = noise + strength * change[:, 0]
    models = []
    for k in (0, *others):
        basis, _ = np.linalg.qr(np.column_stack([base, change[:, k]]))
        models.append((residual - basis @ (basis.T @ residual), basis))
    cluster = np.repeat(np.arange(n_motions), N)
    cause, *wrong = models
    wrong.sort(key=lambda model: model[0] @ model[0])
    fits_better = wrong[0][0] @ wrong[0][0] < cause[0] @ cause[0]
    is_cause = chance.alternative_p(cause, wrong, cluster, 1) if fits_better else 1.0
    return is_cause, chance.alternative_p(wrong[0], [cause], cluster, 1)


@pytest.mark.parametrize("others", slow_but([[1], [2], [1, 2]], [1, 2]))
def test_the_cause_is_excluded_as_rarely_as_its_probability_says(others):
    random = np.random.default_rng(others[-1])
    strengths = [strength for strength in (0.0, 2.0) for _ in range(200)]
    found = np.array([alternative(random, 8, strength, others)[0] for strength in strengths])
    assert np.sum(found <= 0.05) <= most_of(400, 0.05)


def test_what_is_not_the_cause_is_excluded_where_the_effect_is_strong():
    random = np.random.default_rng(7)
    found = np.array([alternative(random, 12, 20.0, (1,))[1] for _ in range(20)])
    assert np.all(found <= 0.05)


def test_a_basis_leaves_out_what_changes_nothing_and_what_others_can_do():
    changes = np.random.default_rng(8).standard_normal((40, 3)) * [1.0, 1e-9, 1e6]
    basis = orthonormal(np.column_stack([changes, np.zeros(40), changes @ [1.0, 2.0, 3.0]]))
    assert basis.shape == (40, 3)
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=1e-12)
    assert orthonormal(np.zeros((40, 2))).shape == (40, 0)


@pytest.mark.parametrize("freedom", [1, 2, 3.5])
def test_the_tail_of_a_chi_square_goes_on_where_it_underflows(freedom):
    for statistic in (0.0, 3.0, 500.0):
        assert chance.chi_square_log_p(statistic, freedom) == pytest.approx(chi2.logsf(statistic, freedom))
    near, far = (chance.chi_square_log_p(2.0 * chance.ASYMPTOTIC_FROM + by, freedom) for by in (0.0, 1e-9))
    assert far == pytest.approx(near, rel=1e-4)
    assert chance.chi_square_log_p(5000.0, freedom) < chance.chi_square_log_p(4900.0, freedom) - 49.0


def test_in_known_noise_an_absent_effect_is_as_rare_as_its_probability_says():
    rng, n_sizes, found = np.random.default_rng(8), 2, []
    basis = orthonormal(rng.normal(size=(40, n_sizes)))
    for _ in range(2000):
        before = rng.normal(size=40)
        found.append(np.exp(chance.known_noise_log_p(before, before - basis @ (basis.T @ before), n_sizes)))
    assert np.mean(np.array(found) <= 0.05) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize("apart", [1.0, 4.0])
def test_in_known_noise_the_cause_is_excluded_as_rarely_as_its_probability_says(apart):
    """Three models of one size each compete; the cause is the second."""
    rng, std, excluded, draws = np.random.default_rng(9), 0.3, 0, 600
    shapes = [orthonormal(one[:, None]) for one in rng.normal(size=(3, 30)) + 1.5 * rng.normal(size=30)]
    for k in range(draws):
        data = 10.0 * std * apart * shapes[1][:, 0] + std * rng.normal(size=30)
        fits = [(data - shape @ (shape.T @ data), shape) for shape in shapes]
        fits.sort(key=lambda one: one[0] @ one[0])
        cause = next(one for one in fits if one[1] is shapes[1])
        rivals = [one for one in fits if one is not cause]
        if rivals[0][0] @ rivals[0][0] < cause[0] @ cause[0]:
            excluded += chance.alternative_p(cause, rivals, np.arange(30), k, std) <= 0.05
    assert excluded <= 0.05 * draws
