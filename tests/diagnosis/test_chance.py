"""Tests of scores against chance keep their level with few and uneven motions."""

import numpy as np
import pytest
from scipy.signal import lfilter

from diagnosis.chance import can_flip, flip_basis, flips_p, wald_by_place, wald_p
from diagnosis.screening import is_new

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
    cleared = [part - basis @ (basis.T @ part) for part in (change[:, columns], noise)]
    return wald_p(basis, *cleared, np.repeat(np.arange(n_motions), N))


def most_of(n, level):
    """Return the count that chance exceeds in one of a thousand cases."""
    return n * level + 3.1 * np.sqrt(n * level * (1.0 - level))


@pytest.mark.parametrize("n_motions", [4, 6, 8])
@pytest.mark.parametrize("columns", [[0], [0, 1], [2]], ids=["one size", "two sizes", "in few samples"])
def test_an_absent_effect_is_as_rare_as_its_probability_says(n_motions, columns):
    random = np.random.default_rng(n_motions)
    found = np.array([probability(random, n_motions, columns) for _ in range(200)])
    for level in (0.05, 0.01):
        assert np.sum(found <= level) <= most_of(200, level)


def test_an_effect_that_shows_in_one_motion_alone_is_no_proof():
    basis, change = np.zeros((4 * N, 0)), np.zeros((4 * N, 1))
    change[:N] = 1.0
    residual = change[:, 0] + 1e-3 * np.random.default_rng(1).standard_normal(4 * N)
    assert wald_p(basis, change, residual, np.repeat(np.arange(4), N)) == 1.0


def test_a_strong_effect_is_proven_by_four_motions():
    random = np.random.default_rng(3)
    base, change, noise = draw(random, 4)
    basis, _ = np.linalg.qr(base)
    part = change[:, :1] - basis @ (basis.T @ change[:, :1])
    noise = noise - basis @ (basis.T @ noise)
    assert wald_p(basis, part, 3000.0 * part[:, 0] + noise, np.repeat(np.arange(4), N)) < 1e-3


def test_the_best_of_many_trials_is_found_by_sign_flips_as_rarely_as_they_say():
    random = np.random.default_rng(5)
    found = []
    for seed in range(40):
        products = random.standard_normal((12, 30)) * random.uniform(0.5, 2.0, (12, 1))
        effects = [
            *([flip_basis(products[:, [k]]) for k in (j, j + 1, j + 2)] for j in range(0, 24, 3)),
            [flip_basis(products[:, 24:26])],
            [flip_basis(random.standard_normal((12, 40)))],  # more sizes than motions
        ]
        found.append(flips_p(effects, seed).min())
    assert np.sum(np.array(found) <= 0.05) <= most_of(40, 0.05)


def test_sign_flips_find_what_all_motions_show():
    products = 1.0 + 0.2 * np.random.default_rng(1).standard_normal((12, 1))
    others = [[flip_basis(np.random.default_rng(k).standard_normal((12, 1)))] for k in range(2, 8)]
    assert flips_p([[flip_basis(products)], *others], seed=1)[0] < 0.02


def test_as_many_sizes_as_motions_prove_nothing():
    basis = flip_basis(np.random.default_rng(1).standard_normal((8, 8)))
    assert flips_p([[basis]], seed=1)[0] == 1.0


def test_signs_of_six_motions_cannot_reject_and_those_of_seven_can():
    assert [can_flip(n) for n in (0, 4, 6, 7, 40)] == [False, False, False, True, True]


def test_the_second_place_is_held_against_the_places_that_are_left():
    p = np.array([1e-5, 1.0, 0.01, 0.5, 0.3])
    found = wald_by_place(p, ["near", "near", "far", "far", "base"])
    assert found == pytest.approx([3e-5, 1.0, 0.04, 1.0, 0.3])


def test_changes_that_are_alike_count_once():
    x = np.linspace(-1.0, 1.0, 50)
    one = x**2 / np.linalg.norm(x**2)
    assert is_new(x**2, [])
    assert not is_new(-3.0 * x**2, [one])
    assert is_new(x**4, [one])
    assert not is_new(0.0 * x, [])
