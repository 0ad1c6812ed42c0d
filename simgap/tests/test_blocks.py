"""Blocks of motions, and the correlation time that they must exceed."""

from functools import cache

import numpy as np
import pytest

from helpers.toy import draw_toy
from helpers.two_joint_arm import arm, simulated
from simgap.effects.effect import joint_scales
from simgap.effects.forces import CoulombFriction
from simgap.residuals.inverse_residuals import InverseResiduals
from simgap.residuals.noise import Blocks, correlation_time_s, cut_into_blocks, cut_rows

PERIOD_s = 0.01


def remembering(n, memory, seed):
    """Return noise in which each value keeps a share of the one before."""
    fresh = np.random.default_rng(seed).standard_normal(n)
    found = np.empty(n)
    found[0] = fresh[0]
    for k in range(1, n):
        found[k] = memory * found[k - 1] + fresh[k]
    return found


@cache
def logs():
    return tuple(simulated(arm(), seed, duration_s=3.0, name=f"m{seed}") for seed in (1, 2))


@cache
def model():
    return InverseResiduals(arm(), logs())


def nominal():
    return model().residuals([], np.zeros((1, 0)))[0]


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.95])
def test_the_correlation_time_is_that_of_the_noise(memory):
    n = 40_000
    found = correlation_time_s(PERIOD_s * np.arange(n), remembering(n, memory, seed=4))
    assert found == pytest.approx(PERIOD_s * (1 + memory) / (1 - memory), rel=0.15)


def test_means_of_blocks_scatter_as_those_of_independent_values():
    noise = remembering(40_000, 0.9, seed=8)
    tau_s = correlation_time_s(PERIOD_s * np.arange(noise.size), noise)
    samples = round(5 * tau_s / PERIOD_s)
    means = noise[: noise.size // samples * samples].reshape(-1, samples).mean(axis=1)
    assert np.std(means) == pytest.approx(np.std(noise) / np.sqrt(5), rel=0.15)


def test_a_residual_that_does_not_vary_has_no_correlation_time():
    assert correlation_time_s(np.arange(9.0), np.ones(9)) == 0.0


@cache
def blocks():
    """Return the first motion in three and two blocks, the second in two and one."""
    return Blocks(model(), np.array([[3, 2], [2, 1]]))


@pytest.mark.slow
def test_blocks_are_longer_than_the_correlation_time_of_their_joint():
    residuals = nominal()
    cut = cut_into_blocks(model(), residuals)
    assert len(cut.motions) > 2 * len(model().motions)
    for m, j in np.ndindex(2, 2):
        rows = (model().motion_of == m) & (model().joint_of == j)
        length_s = np.ptp(model().time_s[rows]) / np.unique(cut.motion_of[rows]).size
        assert length_s >= correlation_time_s(model().time_s[rows], residuals[rows])


def test_a_joint_with_a_slow_misfit_leaves_the_others_their_blocks():
    residuals, far = nominal(), model().joint_of == 1
    slow = np.where(far, residuals, np.sin(np.pi / 4 * model().time_s))
    count = [np.bincount(cut_into_blocks(model(), one).joint_of_block) for one in (residuals, slow)]
    assert count[1][0] < count[0][0]
    assert count[1][1] == count[0][1]


def test_blocks_hold_each_residual_once_and_in_order():
    near, far = model().joints
    assert blocks().motions == (
        *(f"m1:{near}:{k}" for k in (1, 2, 3)),
        *(f"m1:{far}:{k}" for k in (1, 2)),
        *(f"m2:{near}:{k}" for k in (1, 2)),
        f"m2:{far}:1",
    )
    assert blocks().joint_of_block.tolist() == [0, 0, 0, 1, 1, 0, 0, 1]
    assert np.array_equal(blocks().residuals([], np.zeros((1, 0)))[0], nominal())
    assert np.array_equal(blocks().parent_of, model().motion_of)
    for k in range(7):
        own = blocks().time_s[blocks().motion_of == k]
        assert np.ptp(own) < 0.51 * np.ptp(blocks().time_s)


def test_rows_of_several_joints_are_cut_by_the_longest_memory():
    toy = draw_toy(1, {}, n_motions=2, n_samples=100)
    white = np.random.default_rng(1).standard_normal(100)
    slow = np.sin(np.arange(100.0) / 8)
    residuals = np.where(toy.joint_of == 0, np.tile(white, 4), np.tile(slow, 4))
    found = cut_rows(toy, np.arange(400), residuals).reshape(2, 200)
    assert np.array_equal(*found)
    assert found.max() + 1 == 2 * int(99 / correlation_time_s(np.arange(100.0), slow))


@pytest.mark.parametrize("wanted", [(1, 5), (6,), (0, 2, 3)])
def test_selected_blocks_keep_their_residuals(wanted):
    wanted = tuple(blocks().motions[k] for k in wanted)
    effects = [CoulombFriction.at(arm(), "elbow", joint_scales(arm(), logs()))]
    part = blocks().select(wanted)
    rows = np.isin(blocks().motion_of, [blocks().motions.index(name) for name in wanted])
    assert part.motions == wanted
    sizes = np.array([[0.0], [0.5]])
    assert np.array_equal(part.residuals(effects, sizes), blocks().residuals(effects, sizes)[:, rows])
    assert np.array_equal(part.time_s, blocks().time_s[rows])
    assert np.array_equal(part.joint_of, blocks().joint_of[rows])
    assert np.array_equal(part.explain("load"), blocks().explain("load")[rows])
    names = [part.motions[k] for k in part.motion_of]
    assert names == [blocks().motions[k] for k in blocks().motion_of[rows]]


def test_a_motion_of_which_nothing_is_left_is_no_block():
    toy = draw_toy(1, {}, n_motions=3)
    toy.motions = (*toy.motions, "refused")
    blocks = cut_into_blocks(toy, toy.measured.ravel())
    assert not any(name.startswith("refused") for name in blocks.motions)
    assert set(blocks.motion_of) == set(range(len(blocks.motions)))
