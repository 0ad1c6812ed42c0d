"""Effects that hide each other: one alone is not accepted, both together are."""

from collections.abc import Sequence

import numpy as np
import pytest

from helpers.toy import BASE, CATALOGUE, NAMES, Toy, ToyResiduals, draw_toy
from simgap.arrays import Array
from simgap.effects.effect import Effect
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.fit import gather_residuals
from simgap.selection.joint_fits import fit_base, fit_joints
from simgap.selection.selection import find_log_chance, select_effects

STEP = Toy("near", "step of all", np.sign)


class Hidden(ToyResiduals):
    """Toys of which the sine shows only as much as the step is present."""

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        rows = super().residuals(effects, sizes).reshape(-1, *self.commands.shape)
        keys = [effect.key for effect in effects]
        sine = sizes[:, keys.index("near: sine")] if "near: sine" in keys else np.zeros(len(sizes))
        step = sizes[:, keys.index(STEP.key)] if STEP.key in keys else np.zeros(len(sizes))
        hidden = (sine * (10.0 * step - 1.0))[:, None, None] * np.sin(9.0 * self.commands[0])
        rows[:, 0] -= hidden
        return rows.reshape(len(rows), -1)


def test_an_effect_that_shows_only_beside_another_is_named_with_it() -> None:
    toy = draw_toy(1, {"near: sine": 0.1, "near: step": 0.1})
    model = Hidden(toy.commands, toy.measured, NAMES)
    chosen = select_effects(model, BASE, (STEP, CATALOGUE[2]), seed=1).chosen
    assert {effect.key for effect in chosen.effects} == {STEP.key, "near: sine"}


def test_an_effect_at_a_body_of_a_robot_with_one_joint_is_fitted_with_the_joint() -> None:
    toy = draw_toy(1, {})
    model = ToyResiduals(toy.commands[:1], toy.measured[:1], NAMES[:1])
    body = Toy("base", "square of all", np.square)
    assert start_context(model, BASE[:1], (body,), 1, Meter()).joint_of(body) == 0


@pytest.mark.parametrize(("truth", "low", "high"), [(0.1, 0.0, 1e-6), (0.0, 0.05, 1.0)])
def test_an_effect_is_due_to_chance_where_it_is_absent(truth: float, low: float, high: float) -> None:
    square = CATALOGUE[0]
    toy = draw_toy(1, {square.key: truth})
    context, base = fit_base(start_context(toy, BASE, CATALOGUE, 1, Meter()))
    fits = fit_joints(context, (square,), base.sizes)
    without = gather_residuals(base.fits, toy.joint_of.size)
    assert low <= np.exp(find_log_chance(context, fits[:1], square, without)) <= high
