"""Fits of all joints: coupled joints, sizes at bounds, joints without data, repeats."""

import numpy as np
import pytest

from helpers.toy import BASE, CATALOGUE, NAMES, Toy, ToyResiduals, draw_toy
from simgap.assemble import find_interval
from simgap.residuals.noise import WhitenedResiduals, whiten_noise
from simgap.selection.acceptance import step_without
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.fit import Hypothesis, Union
from simgap.selection.fitting import Fitting
from simgap.selection.joint_fits import fit_base
from simgap.selection.selection import select_effects
from simgap.selection.sharing import share_nothing


class Coupled(ToyResiduals):
    """Two joints, the first of which moves the second."""

    def residuals(self, effects, sizes):
        rows = super().residuals(effects, sizes).reshape(-1, *self.commands.shape)
        rows[:, 1] += 0.5 * (rows[:, 0] - self.measured[0])
        return rows.reshape(len(rows), -1)


def test_residuals_of_coupled_joints_are_those_of_their_sizes_together():
    toy = draw_toy(1, {})
    model = Coupled(toy.commands, toy.measured, NAMES)
    context, present = fit_base(start_context(model, BASE, CATALOGUE, 1, Meter()))
    columns = context.union.columns(context.base)
    (rows,) = context.model.residuals(context.base, present.sizes[None, columns])
    for fit in present.fits:
        np.testing.assert_array_equal(fit.residuals, rows[fit.rows])
        np.testing.assert_array_equal(fit.sizes, present.sizes)


def test_joints_without_base_parameters_share_no_simulation_if_they_are_coupled():
    toy = draw_toy(1, {})
    for kind, groups in ((ToyResiduals, ((0, 1),)), (Coupled, ((0,), (1,)))):
        model = kind(toy.commands, toy.measured, NAMES)
        context, _ = fit_base(start_context(model, (), CATALOGUE, 1, Meter()))
        assert context.sharing.groups == groups


def test_a_fit_that_starts_beyond_a_bound_ends_inside():
    model = draw_toy(1, {})
    union = Union(BASE)
    start = Hypothesis(np.arange(1), np.array([9.0, 0.0]), 0)
    fitting = Fitting(model, union, [start], np.full(2, 0.02), sharing=share_nothing(2, np.arange(2)))
    (fit,) = fitting.finish()
    np.testing.assert_allclose(fit.sizes[0], 0.3, atol=0.02)


def test_a_step_without_a_fold_goes_as_far_as_the_optimum_without_it():
    toy = draw_toy(1, {})
    context, present = fit_base(start_context(toy, BASE, (), 1, Meter()))
    (fold, *_), fit = context.folds, present.fits[0]
    z, slope = fit.residuals / context.scales[0], fit.jacobian[:, 0] / context.scales[0]
    is_other = ~np.isin(context.model.motion_of[fit.rows], sorted(fold))
    sizes = np.linspace(-0.002, 0.002, 4001)  # the model is linear, so that the loss is known without a fit
    losses = np.array([np.sqrt(1.0 + (z + slope * one) ** 2) for one in sizes])
    every, others = (sizes[int(np.argmin(part.sum(axis=1)))] for part in (losses, losses[:, is_other]))
    step = step_without(context, fit, fold)[0] - fit.sizes[0]
    assert step == pytest.approx(others - every, rel=0.05)


@pytest.mark.slow
def test_an_effect_at_a_body_has_an_interval_that_holds_its_size():
    body, held = Toy("base", "square of all", np.square), 0
    for seed in range(10):
        model = draw_toy(seed, {"near: square": 0.1, "far: square": 0.1})
        selection = select_effects(model, BASE, (body,), seed=1)
        (column,) = selection.context.union.columns([body])
        low, high = find_interval(selection.context, selection.chosen, [], int(column))
        held += low < 0.1 < high
        assert high - low < 0.01
    assert held >= 7  # 99 % of a binomial around 9


def test_a_joint_without_data_does_not_hide_an_effect_at_a_body():
    model = draw_toy(1, {"near: square": 0.1, "far: square": 0.1})
    model.joints = (*NAMES, "silent")
    body = Toy("base", "square of all", np.square)
    chosen = select_effects(model, BASE, (*CATALOGUE, body), seed=1).chosen
    assert [effect.key for effect in chosen.effects] == [body.key]


def test_the_noise_of_all_repeats_counts_in_any_order():
    model = draw_toy(1, {})
    rng = np.random.default_rng(2)
    rows = rng.normal(0.0, 1.0, model.commands.shape)
    rows[:, 0, 1:] += rows[:, 0, :-1]  # one of three repeats remembers
    found = []
    for order in ((0, 1, 2), (2, 1, 0)):
        model.repeat_of = ("a", "a", "a", *("",) * (len(model.motions) - 3))
        moved = rows.copy()
        moved[:, :3] = rows[:, list(order)]
        white = whiten_noise(model, moved.ravel())
        assert isinstance(white, WhitenedResiduals)
        found.append(white.correlation)
    np.testing.assert_allclose(found[0], found[1])
