"""Parts of the selection: comparison of models, effects that hide each other, screening, sharing."""

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from helpers.pendulum import at_swing, pendulum
from helpers.toy import BASE, CATALOGUE, NAMES, Toy, ToyResiduals, draw_toy
from simgap import assemble
from simgap.effects.effect import Effect, Size
from simgap.effects.forces import CoulombFriction, StribeckFriction
from simgap.residuals.noise import repeat_pairs
from simgap.residuals.residuals import half_loss_derivatives
from simgap.selection import elimination, verdict
from simgap.selection.acceptance import (
    compare_motions,
    compare_with_noise,
    measure_distance,
    predict_each,
)
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.elimination import find_log_chance
from simgap.selection.fit import Union, gather_residuals
from simgap.selection.joint_fits import fit_base, fit_joints, leave_out
from simgap.selection.selection import select_effects
from simgap.selection.sharing import ALL_JOINTS, find_sharing

LIMIT = Toy("near", "limit", lambda x: np.maximum(x - 0.8, 0.0))


class Clamp(Toy):
    """Effect that limits the command to one over its size."""

    @property
    def sizes(self):
        return (Size(self.label, 0.0, 20.0, 2.9),)


class Clamped(ToyResiduals):
    """Residuals of joints whose command may be limited."""

    def residuals(self, effects, sizes):
        is_clamp = np.array([isinstance(effect, Clamp) for effect in effects], bool)
        others = [effect for effect, is_one in zip(effects, is_clamp, strict=True) if not is_one]
        rows = super().residuals(others, sizes[:, ~is_clamp])
        limit = 1.0 / np.maximum(sizes[:, is_clamp].sum(axis=1), 1e-9)[:, None]
        near = self.commands.ravel() * (self.joint_of == 0)
        return np.asarray(rows - 0.3 * (np.clip(near, -limit, limit) - near))


def test_a_limit_that_acts_only_just_is_found():
    toy = draw_toy(1, {})
    measured = toy.measured + 0.3 * (np.clip(toy.commands, -1 / 1.15, 1 / 1.15) - toy.commands)
    measured[1] = toy.measured[1]
    clamp = Clamp("near", "clamp", np.square)
    chosen = select_effects(Clamped(toy.commands, measured, NAMES), BASE, (clamp, *CATALOGUE), seed=1).chosen
    assert [effect.key for effect in chosen.effects] == [clamp.key]
    assert chosen.sizes[2] == pytest.approx(1.15, abs=0.02)


@pytest.mark.parametrize("touch", [0.0, 1e-6, 1e-3])
def test_an_effect_that_one_motion_reaches_is_found_although_others_touch_it(touch):
    toy = draw_toy(1, {})
    commands = np.clip(toy.commands, -0.8, 0.8 + touch)
    commands[:, 3] = toy.commands[:, 3]
    measured = toy.measured - 0.3 * toy.commands + 0.3 * commands
    measured[0] += LIMIT.shape(commands[0])
    effects: tuple[Effect, ...] = (LIMIT, *(Toy(name, "square", np.square) for name in NAMES))
    chosen = select_effects(ToyResiduals(commands, measured, NAMES), BASE, effects, seed=1).chosen
    assert [effect.key for effect in chosen.effects] == [LIMIT.key]


def test_an_improvement_that_repeats_is_sure_beside_motions_of_very_different_strength():
    before = np.geomspace(1.0, 1e4, 12)
    ratio = 0.9 + 0.02 * np.random.default_rng(1).standard_normal(12)
    assert compare_motions(np.arange(12), before, ratio * before) > 10.0
    assert compare_motions(np.arange(12), before, 0.5 * before) == np.inf
    assert abs(compare_motions(np.arange(12), before, before[::-1])) < 1e-12


@pytest.mark.slow
def test_a_change_without_use_seldom_exceeds_what_noise_can_do_and_no_change_is_none():
    toy = draw_toy(1, {})
    context = replace(start_context(toy, BASE, (), 1, Meter()), scales=np.ones(2))
    rows, rng = np.flatnonzero(toy.joint_of == 0), np.random.default_rng(2)
    found = []
    for _ in range(400):
        noise = rng.standard_normal(rows.size)
        found.append(compare_with_noise(context, rows, noise, noise - 0.1 * rng.standard_normal(rows.size)))
    assert np.mean(np.array(found) > 2.0) < 0.05
    assert compare_with_noise(context, rows, toy.commands[0].ravel(), toy.commands[0].ravel()) == 0.0


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("period", [2.5, 100.0])
def test_the_chance_that_a_wrong_model_predicts_better_is_right_for_noise_with_a_memory(correlation, period):
    toy = draw_toy(1, {}, n_motions=6, n_samples=400)
    context = replace(start_context(toy, BASE, (), 1, Meter()), scales=np.ones(2))
    rows, rng = np.flatnonzero(toy.joint_of == 0), np.random.default_rng(2)
    white = np.sqrt(1.0 - correlation**2) * rng.standard_normal((400, 6, 500))
    noise = lfilter([1.0], [1.0, -correlation], white, axis=2)[:, :, 100:].reshape(400, -1)
    apart = np.tile(np.sin(2.0 * np.pi * np.arange(400) / period), 6)
    apart *= 2.0 * norm.isf(0.2) * np.std(noise @ apart) / (apart @ apart)
    is_wrong = np.sum((noise + apart) ** 2, axis=1) < np.sum(noise**2, axis=1)
    assert np.mean(is_wrong) == pytest.approx(0.2, abs=0.04)
    both = np.tile(np.stack([noise, noise + apart], axis=1), (1, 1, 2))
    told = norm.sf([0.5 * measure_distance(context, toy, rows, *one) for one in both[:50]])
    assert np.mean(told) == pytest.approx(0.2, abs=0.07)


@pytest.mark.parametrize(("of_one", "of_other"), [([], [0, 7, 50]), ([0], [9]), ([-1], [0])])
def test_motions_repeat_one_another_also_where_samples_are_missing(of_one, of_other):
    model = draw_toy(1, {})
    kept = np.ones(model.time_s.size, dtype=bool)
    motions = (model.motion_of == len(model.motions) - k for k in (2, 1))
    first, last = (np.flatnonzero((model.joint_of == 0) & one) for one in motions)
    kept[first[of_one]] = kept[last[of_other]] = False
    for name in ("joint_of", "motion_of", "time_s"):
        setattr(model, name, getattr(model, name)[kept])
    ((one, other),) = repeat_pairs(model, 0)
    assert len(one) == last.size - len(of_one) - len(of_other)
    np.testing.assert_array_equal(model.time_s[one], model.time_s[other])


STEP = Toy("near", "step of all", np.sign)


class Hidden(ToyResiduals):
    """Toys of which the sine shows only as much as the step is present."""

    def residuals(self, effects, sizes):
        rows = super().residuals(effects, sizes).reshape(-1, *self.commands.shape)
        keys = [effect.key for effect in effects]
        sine = sizes[:, keys.index("near: sine")] if "near: sine" in keys else np.zeros(len(sizes))
        step = sizes[:, keys.index(STEP.key)] if STEP.key in keys else np.zeros(len(sizes))
        hidden = (sine * (10.0 * step - 1.0))[:, None, None] * np.sin(9.0 * self.commands[0])
        rows[:, 0] -= hidden
        return rows.reshape(len(rows), -1)


def test_an_effect_that_shows_only_beside_another_is_named_with_it():
    toy = draw_toy(1, {"near: sine": 0.1, "near: step": 0.1})
    model = Hidden(toy.commands, toy.measured, NAMES)
    chosen = select_effects(model, BASE, (STEP, CATALOGUE[2]), seed=1).chosen
    assert {effect.key for effect in chosen.effects} == {STEP.key, "near: sine"}


def test_an_effect_at_a_body_of_a_robot_with_one_joint_is_fitted_with_the_joint():
    toy = draw_toy(1, {})
    model = ToyResiduals(toy.commands[:1], toy.measured[:1], NAMES[:1])
    body = Toy("base", "square of all", np.square)
    assert start_context(model, BASE[:1], (body,), 1, Meter()).joint_of(body) == 0


@pytest.mark.parametrize(("truth", "low", "high"), [(0.1, 0.0, 1e-6), (0.0, 0.05, 1.0)])
def test_an_effect_is_due_to_chance_where_it_is_absent(truth, low, high):
    square = CATALOGUE[0]
    toy = draw_toy(1, {square.key: truth})
    context, base = fit_base(start_context(toy, BASE, CATALOGUE, 1, Meter()))
    fits = fit_joints(context, (square,), base.sizes)
    without = gather_residuals(base.fits, toy.joint_of.size)
    assert low <= np.exp(find_log_chance(context, fits[:1], [square], without)) <= high


@pytest.mark.parametrize("n_motions", [3, 10])
def test_effects_are_not_due_to_chance_together_if_one_of_them_is_not(n_motions):
    effects = CATALOGUE[:3]
    toy = draw_toy(1, {effects[0].key: 0.1}, n_motions)
    context, base = fit_base(start_context(toy, BASE, CATALOGUE, 1, Meter()))
    fits = fit_joints(context, effects, base.sizes)[:1]
    without = gather_residuals(base.fits, toy.joint_of.size)
    together, alone = (find_log_chance(context, fits, of, without) for of in (effects, effects[:1]))
    assert together <= alone + np.log(4.0) < np.log(0.05)


def test_of_effects_that_are_needed_together_alone_the_one_that_explains_most_stays(monkeypatch):
    found = select_effects(draw_toy(1, {"near: sine": 0.1, "near: step": 0.1}), BASE, CATALOGUE, seed=1)
    monkeypatch.setattr(elimination, "find_need", lambda *of: (len(of[-1]) > 1, 0.0))
    left, _, kept = elimination.drop_needless(found.context, found.chosen)
    assert len(found.chosen.effects) == 2
    assert ["near: sine"] == [one.key for one in left.effects] == [*kept]  # explains more than the step
    again, _, _ = elimination.drop_needless(found.context, left, kept)
    assert again.effects == left.effects


def test_an_effect_that_is_needed_beside_the_one_that_came_back_comes_back_too(monkeypatch):
    found = select_effects(draw_toy(1, {"near: sine": 0.1, "near: step": 0.1}), BASE, CATALOGUE, seed=1)

    def find_need(_, present, without, effects):
        return len(present.effects) == 2 and [one.key for one in effects] != ["near: sine"], 0.0

    monkeypatch.setattr(elimination, "find_need", find_need)
    left, _, kept = elimination.drop_needless(found.context, found.chosen)
    assert {one.key for one in left.effects} == kept == {"near: sine", "near: step"}


def test_an_effect_is_not_judged_again_while_those_of_another_joint_go(monkeypatch):
    truth = {"near: sine": 0.1, "near: step": 0.1, "far: square": 0.1}
    found = select_effects(draw_toy(1, truth), BASE, CATALOGUE, seed=1)
    judged = []

    def find_need(_, present, without, effects):
        judged.extend(one.key for one in effects)
        return effects[0].place == "far", 0.0

    monkeypatch.setattr(elimination, "find_need", find_need)
    left, left_out, _ = elimination.drop_needless(found.context, found.chosen)
    assert len(found.chosen.effects) == 3
    assert [one.key for one in left.effects] == ["far: square"] == [layer[0].key for layer, _ in left_out]
    assert judged.count("far: square") == 1


def test_after_a_finding_goes_all_others_are_judged_as_if_all_joints_were_fitted_again():
    truth = {"near: sine": 0.1, "near: step": 0.1, "far: square": 0.1}
    found = select_effects(draw_toy(1, truth), BASE, CATALOGUE, seed=1)
    context, (gone, *_) = found.context, found.chosen.effects
    models, left, _ = elimination.drop_needless(context, found.chosen, found.kept, found.left_out, gone)
    afresh, again, _ = elimination.drop_needless(context, leave_out(context, found.chosen, [gone]))
    assert len(models.effects) == 2
    pairs = [(models, afresh)]
    pairs += [(one, other) for (layer, one), (same, other) in zip(left, again, strict=True) if layer == same]
    assert len(pairs) == 1 + len(left)
    for one, other in pairs:
        assert one.effects == other.effects
        np.testing.assert_allclose(one.sizes, other.sizes, atol=1e-4)
        np.testing.assert_allclose(one.left_out, other.left_out, atol=1e-2)


@pytest.mark.parametrize(
    ("rivals", "counts"), [((), [2, 1, 1]), ((Toy("base", "square", np.square),), [2, 1, 2])]
)
def test_a_withdrawal_keeps_sets_that_it_does_not_touch_and_that_have_no_rival_at_all_joints(
    monkeypatch, rivals, counts
):
    truth = {"near: sine": 0.1, "near: step": 0.1, "far: square": 0.1}
    found = select_effects(draw_toy(1, truth), BASE, (*CATALOGUE, *rivals), seed=1)
    fitted, find_layer_sets = [], verdict.find_layer_sets

    def count(context, selection, without, layer, wanted):
        fitted.extend(one.key for one in wanted)
        return find_layer_sets(context, selection, without, layer, wanted)

    monkeypatch.setattr(verdict, "find_layer_sets", count)
    monkeypatch.setattr(assemble, "may_be_none", lambda _, effect, sets: effect.key == "near: step")
    sure, sets, _ = assemble.select_sure(found, None)
    assert {one.effect.key for one in sets} == {"near: sine", "far: square"}
    assert len(sure.chosen.effects) == 2
    assert [fitted.count(key) for key in truth] == counts


class Reaching(ToyResiduals):
    """Some sizes at the first of three joints move the second too, whose gain moves the first."""

    movers: ClassVar[tuple[str, ...]] = ()

    def residuals(self, effects, sizes):
        rows = super().residuals(effects, sizes).reshape(-1, *self.commands.shape)
        for k, effect in enumerate(effects):
            if effect.key in self.movers:
                rows[:, 1] -= 0.4 * sizes[:, k, None, None] * effect.shape(self.commands[0])
            if effect.place == "b":
                rows[:, 0] -= 0.4 * sizes[:, k, None, None] * effect.shape(self.commands[1])
        return rows.reshape(len(rows), -1)


@pytest.mark.parametrize("movers", [("a: gain",), ("a: sine",)])
def test_a_joint_that_a_finding_or_its_joint_moves_is_fitted_again_when_the_finding_goes(movers, monkeypatch):
    monkeypatch.setattr(Reaching, "movers", movers)
    rng, names = np.random.default_rng(1), ("a", "b", "c")
    commands = rng.uniform(0.0, 1.0, (3, 10, 200))
    commands[1] = 0.6 * commands[0] + 0.4 * commands[1]
    commands[:, -1] = commands[:, -2]
    base = tuple(Toy(name, "gain", lambda x: x, 3.0) for name in names)
    effects = Toy("a", "sine", lambda x: np.sin(9.0 * x)), Toy("c", "square", np.square)
    union = (*base, *effects)
    truth = np.array([[0.3, 0.3, 0.3, 0.2, 0.1]])
    noise = 0.02 * rng.standard_normal(commands.shape)
    moved = -Reaching(commands, noise, names).residuals(union, truth).reshape(commands.shape)
    found = select_effects(Reaching(commands, moved, names), base, effects, seed=1)
    context, chosen = found.context, found.chosen
    assert [one.key for one in chosen.effects] == ["a: sine", "c: square"]
    sizes = chosen.sizes * (np.arange(5) != 3)
    (_, afresh, _) = fit_joints(context, effects[1:], sizes, chosen.fits)
    left = assemble.drop_finding(found, effects[0]).chosen
    assert left.sizes[1] == afresh.sizes[1] != chosen.sizes[1]


def test_a_motion_is_predicted_as_by_fits_in_which_it_counts_less_and_less():
    found = select_effects(draw_toy(1, {"near: square": 0.1}), BASE, CATALOGUE, seed=1)
    fit, scale = found.chosen.fits[0], found.context.scales[0]
    z, a, motion = fit.residuals / scale, fit.jacobian / scale, found.context.model.motion_of[fit.rows]
    predicted = predict_each(found.context, [fit])[fit.rows]

    def fit_with(weight):
        step = np.zeros(a.shape[1])
        for _ in range(20):
            slope, curvature = half_loss_derivatives(z + a @ step)
            step -= np.linalg.solve(a.T @ (a * (weight * curvature)[:, None]), a.T @ (weight * slope))
        return step

    for k in np.unique(motion):
        own = motion == k
        step = (fit_with(1.0 - 1e-4 * own) - fit_with(np.ones(own.size))) / 1e-4
        np.testing.assert_allclose(predicted[own], (z + a @ step)[own], atol=2e-3)


def test_a_motion_that_alone_shows_a_size_is_predicted_nearly_as_it_was_fitted():
    context = select_effects(draw_toy(1, {}), BASE, CATALOGUE, seed=1).context
    fit = fit_joints(context, (), np.zeros(len(context.union.sizes)))[0]
    slopes = fit.jacobian * np.where(context.model.motion_of[fit.rows] == 0, 1.0, 1e-3)[:, None]
    alone = predict_each(context, [replace(fit, jacobian=slopes)])[fit.rows]
    assert np.linalg.norm(alone) < 1.1 * np.linalg.norm(fit.residuals / context.scales[0])


def test_what_left_out_motions_do_not_tell_apart_stays_in_the_set(monkeypatch):
    twin = Toy("near", "twin", lambda x: x**2 + 0.001 * x**3)
    found = select_effects(draw_toy(1, {"near: square": 0.1}), BASE, (*CATALOGUE, twin), seed=1)
    monkeypatch.setattr(verdict, "_cause_p", lambda *of: [0.0] * (len(of[-1]) - 1))
    (one,) = verdict.find_confidence_sets(found)
    assert {member.effect.key for member in one.alternatives} == {"near: square", "near: twin"}


class Leaking(ToyResiduals):
    """The squares at the first joint move the second three times as much."""

    def residuals(self, effects, sizes):
        rows = super().residuals(effects, sizes).reshape(-1, *self.commands.shape)
        for k, effect in enumerate(effects):
            if effect.key == "near: square":
                rows[:, 1] -= 3.0 * sizes[:, k, None, None] * np.square(self.commands[0])
        return rows.reshape(len(rows), -1)


@pytest.mark.parametrize(("other", "groups"), [(0.05, ((0, 1),)), (0.2, ((0,), (1,)))])
def test_joints_share_if_their_base_parameters_scarcely_move_one_another(other, groups):
    reach = np.array([[2.0, 2.0 * other], [0.0, 1.0]])
    columns = [np.array([0]), np.array([1])]
    assert find_sharing([0, 1], columns, np.array([True, True]), reach, np.arange(2)).groups == groups


def test_an_effect_at_a_joint_that_moves_another_is_found_by_what_it_does_there():
    quiet = draw_toy(3, {"near: square": 0.02})
    quiet.measured[1] += 3.0 * 0.02 * np.square(quiet.commands[0])
    model = Leaking(quiet.commands, quiet.measured, NAMES)
    found = select_effects(model, BASE, CATALOGUE, seed=1)
    assert [found.context.joint_of(one) for one in found.chosen.effects] == [ALL_JOINTS]
    assert [one.key for one in found.chosen.effects] == ["near: square"]
    (column,) = found.context.union.columns(found.chosen.effects)
    assert found.chosen.sizes[column] == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize(
    ("kind", "ends", "expected"),
    [
        (StribeckFriction, [(-0.02, 0.05), (0.1, 0.4)], True),
        (StribeckFriction, [(0.02, 0.05), (0.1, 0.4)], False),
        (CoulombFriction, [(-0.02, 0.05)], True),
    ],
)
def test_a_finding_may_be_none_whatever_its_form_if_the_interval_of_its_amount_holds_none(
    kind, ends, expected, monkeypatch
):
    effect = at_swing(kind, pendulum())
    context = SimpleNamespace(union=Union((effect,)))
    monkeypatch.setattr(assemble, "find_interval", lambda context, chosen, sets, column: ends[column])
    selection = SimpleNamespace(context=context, chosen=None)
    assert assemble.may_be_none(selection, effect, []) == expected
