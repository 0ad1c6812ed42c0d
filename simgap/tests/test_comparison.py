"""Two models are compared by how sure an improvement is: it repeats, or it is more than noise can do."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.toy import BASE, NAMES, Toy, ToyResiduals, draw_toy
from simgap.effects.effect import Effect
from simgap.residuals.noise import repeat_pairs
from simgap.selection.acceptance import compare_motions, compare_with_noise
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.selection import select_effects

LIMIT = Toy("near", "limit", lambda x: np.maximum(x - 0.8, 0.0))


def test_an_effect_that_one_motion_reaches_is_found() -> None:
    toy = draw_toy(1, {})
    commands = np.clip(toy.commands, -0.8, 0.8)
    commands[:, 3] = toy.commands[:, 3]
    measured = toy.measured - 0.3 * toy.commands + 0.3 * commands
    measured[0] += LIMIT.shape(commands[0])
    effects: tuple[Effect, ...] = (LIMIT, *(Toy(name, "square", np.square) for name in NAMES))
    chosen = select_effects(ToyResiduals(commands, measured, NAMES), BASE, effects, seed=1).chosen
    assert [effect.key for effect in chosen.effects] == [LIMIT.key]


def test_an_improvement_that_repeats_is_sure_beside_motions_of_very_different_strength() -> None:
    before = np.geomspace(1.0, 1e4, 12)
    ratio = 0.9 + 0.02 * np.random.default_rng(1).standard_normal(12)
    assert compare_motions(np.arange(12), before, ratio * before) > 10.0
    assert abs(compare_motions(np.arange(12), before, before[::-1])) < 1e-12


def test_a_change_without_use_seldom_exceeds_what_noise_can_do() -> None:
    toy = draw_toy(1, {})
    context = replace(start_context(toy, BASE, (), 1, Meter()), scales=np.ones(2))
    rows, rng = np.flatnonzero(toy.joint_of == 0), np.random.default_rng(2)
    found = []
    for _ in range(400):
        noise = rng.standard_normal(rows.size)
        found.append(compare_with_noise(context, rows, noise, noise - 0.1 * rng.standard_normal(rows.size)))
    assert np.mean(np.array(found) > 2.0) < 0.05


def test_models_that_do_not_differ_are_equal() -> None:
    toy = draw_toy(1, {})
    context = replace(start_context(toy, BASE, (), 1, Meter()), scales=np.ones(2))
    rows = np.flatnonzero(toy.joint_of == 0)
    assert compare_with_noise(context, rows, toy.commands[0].ravel(), toy.commands[0].ravel()) == 0.0


@pytest.mark.parametrize(("of_one", "of_other"), [([], [0, 7, 50]), ([0], [9]), ([-1], [0])])
def test_motions_repeat_one_another_also_where_samples_are_missing(
    of_one: list[int], of_other: list[int]
) -> None:
    model = draw_toy(1, {})
    kept = np.ones(model.time_s.size, dtype=bool)
    first, last = (
        np.flatnonzero((model.joint_of == 0) & (model.motion_of == len(model.motions) - k)) for k in (2, 1)
    )
    kept[first[of_one]] = kept[last[of_other]] = False
    for name in ("joint_of", "motion_of", "time_s"):
        setattr(model, name, getattr(model, name)[kept])
    ((one, other),) = repeat_pairs(model, 0)
    assert len(one) == last.size - len(of_one) - len(of_other)
    np.testing.assert_array_equal(model.time_s[one], model.time_s[other])
