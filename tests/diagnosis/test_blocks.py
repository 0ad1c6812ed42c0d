"""Blocks of motions, and the correlation time that they must exceed."""

from functools import cache

import numpy as np
import pytest

from diagnosis.blocks import Blocks, correlation_time_s, cut_into_blocks
from diagnosis.effects.friction import CoulombFriction
from diagnosis.inverse_residuals import InverseResiduals
from tests.diagnosis.toy import draw_toy
from tests.diagnosis.two_joint_arm import arm, scales, simulated

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


def test_blocks_are_longer_than_the_correlation_time():
    residuals = nominal()
    blocks = cut_into_blocks(model(), residuals)
    assert len(blocks.motions) > len(model().motions)
    for m, motion in enumerate(model().motions):
        times = [
            correlation_time_s(model().time_s[rows], residuals[rows])
            for rows in ((model().motion_of == m) & (model().joint_of == j) for j in (0, 1))
        ]
        length_s = np.ptp(model().time_s[model().motion_of == m]) / blocks.parents.count(motion)
        assert length_s >= max(times)


def test_blocks_hold_each_residual_once_and_in_order():
    blocks = Blocks(model(), (3, 2))
    assert blocks.motions == ("m1:1", "m1:2", "m1:3", "m2:1", "m2:2")
    assert np.array_equal(blocks.residuals([], np.zeros((1, 0)))[0], nominal())
    for k in range(5):
        rows = blocks.motion_of == k
        own = blocks.time_s[rows]
        assert np.ptp(own) < 0.51 * np.ptp(blocks.time_s)
        assert {blocks.parents[k]} == {model().motions[m] for m in model().motion_of[rows]}


def test_a_motion_that_is_one_block_keeps_its_name():
    assert Blocks(model(), (1, 2)).motions == ("m1", "m2:1", "m2:2")


def test_a_residual_as_slow_as_the_motion_leaves_few_blocks():
    slow = np.sin(np.pi / 4 * model().time_s)
    assert len(cut_into_blocks(model(), slow).motions) <= 3 * len(model().motions)


@pytest.mark.parametrize("wanted", [("m1:2", "m2:1"), ("m2:2",), ("m1:1", "m1:3")])
def test_selected_blocks_keep_their_residuals(wanted):
    blocks = Blocks(model(), (3, 2))
    effects = [CoulombFriction.at(arm(), "elbow", scales(arm(), *logs()))]
    part = blocks.select(wanted)
    rows = np.isin(blocks.motion_of, [blocks.motions.index(name) for name in wanted])
    assert part.motions == wanted
    sizes = np.array([[0.0], [0.5]])
    assert np.array_equal(part.residuals(effects, sizes), blocks.residuals(effects, sizes)[:, rows])
    assert np.array_equal(part.time_s, blocks.time_s[rows])
    assert np.array_equal(part.joint_of, blocks.joint_of[rows])
    assert np.array_equal(part.explain("load"), blocks.explain("load")[rows])
    names = [part.motions[k] for k in part.motion_of]
    assert names == [blocks.motions[k] for k in blocks.motion_of[rows]]


def test_a_selection_of_a_selection_is_that_selection():
    blocks = Blocks(model(), (3, 2))
    twice = blocks.select(("m1:2", "m2:1", "m2:2")).select(("m2:2",))
    once = blocks.select(("m2:2",))
    size = np.zeros((1, 0))
    assert np.array_equal(twice.residuals([], size), once.residuals([], size))


def test_a_motion_of_which_nothing_is_left_is_no_block():
    toy = draw_toy(1, {}, n_motions=3)
    toy.motions = (*toy.motions, "refused")
    blocks = cut_into_blocks(toy, toy.measured.ravel())
    assert not any(name.startswith("refused") for name in blocks.motions)
    assert set(blocks.motion_of) == set(range(len(blocks.motions)))
