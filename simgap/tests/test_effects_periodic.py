"""Periodic errors of shown angles: their inverse, their orders, and no bit at size 0."""

import numpy as np
import pytest

from simgap.effects.transmission import PeriodicError, SmoothPeriodicError

ANGLES_RAD = np.linspace(-4, 4, 401)[None, :]


def smooth_size(seed):
    effect = SmoothPeriodicError("a", 2e-3)
    widths = np.array([size.prior_std for size in effect.sizes])
    return effect, np.random.default_rng(seed).normal(0, widths)[None, :]


def test_an_error_of_one_order_repeats_that_often_in_a_turn():
    effect = PeriodicError("a", 5, 1e-3)
    size = np.array([[3e-3, -4e-3]])
    error_rad = effect.encode(size, ANGLES_RAD) - ANGLES_RAD
    later_rad = effect.encode(size, ANGLES_RAD + 2 * np.pi / 5) - ANGLES_RAD - 2 * np.pi / 5
    np.testing.assert_allclose(error_rad, later_rad, atol=1e-12)
    assert np.abs(error_rad).max() == pytest.approx(5e-3, rel=1e-3)
    assert effect.describe(size[0]) == "5 mrad with 5 periods a turn, phase -0.93 rad"


@pytest.mark.parametrize("order", [1, 2, 48, 256])
def test_decode_inverts_encode_at_the_bound(order):
    effect = PeriodicError("a", order, 1e-3)
    size = np.array([[one.high for one in effect.sizes]])
    shown_rad = effect.encode(size, ANGLES_RAD)
    np.testing.assert_allclose(effect.decode(size, shown_rad), ANGLES_RAD, atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_decode_inverts_encode_of_many_orders(seed):
    effect, size = smooth_size(seed)
    shown_rad = effect.encode(size, ANGLES_RAD)
    np.testing.assert_allclose(effect.decode(size, shown_rad), ANGLES_RAD, atol=1e-12)


def test_many_orders_are_the_sum_of_single_ones():
    effect, size = smooth_size(4)
    single = sum(
        PeriodicError("a", k + 1, 1e-3).encode(size[:, 2 * k : 2 * k + 2], ANGLES_RAD) - ANGLES_RAD
        for k in range(48)
    )
    np.testing.assert_allclose(effect.encode(size, ANGLES_RAD) - ANGLES_RAD, single, atol=1e-14)


def test_the_strongest_order_of_many_is_told():
    effect = SmoothPeriodicError("a", 1e-3)
    size = np.zeros(96)
    size[2 * 6 + 1] = 2e-3
    assert effect.describe(size) == "1.41 mrad RMS, most of it 2 mrad with 7 periods a turn"


@pytest.mark.parametrize("effect", [PeriodicError("a", 3, 1e-3), SmoothPeriodicError("a", 1e-3)])
def test_a_size_of_zero_changes_no_bit(effect):
    size = np.zeros((1, len(effect.sizes)))
    for job in (effect.encode, effect.decode):
        np.testing.assert_array_equal(job(size, ANGLES_RAD), ANGLES_RAD)
