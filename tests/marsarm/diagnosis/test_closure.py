"""Closure on held-out motion, and the choice of the next motion."""

from dataclasses import replace

import numpy as np
import pytest

from marsarm.diagnosis.closure import (
    build_held_out_model,
    compute_closure,
    compute_held_out_residuals,
    whitened_closure,
)
from marsarm.diagnosis.diagnose import effect_values
from marsarm.diagnosis.normal_equations import form_normal_equations
from marsarm.diagnosis.problem import Residuals
from tests.marsarm.diagnosis.worlds import found, modelled, select_and_diagnose, world

pytestmark = pytest.mark.slow


def elsewhere(made):
    """Return sensitivities of the same motions under other names."""
    others = tuple(f"other {name}" for name in made.layout.blocks)
    return replace(found(made), layout=replace(made.layout, blocks=others))


@pytest.fixture
def held_out(made, campaign):
    """Return held-out motion: the same motions, recorded again."""
    return build_held_out_model(campaign.equations, elsewhere(made), campaign.equations.C)


def close(diagnosis, held_out, measured, change):
    """Return the closure of one case on held-out motion."""
    return compute_closure(
        held_out, *compute_held_out_residuals(diagnosis, held_out, measured, change), seed=1
    )


def test_closure_agrees_with_the_truth(made, campaign, held_out, rng):
    """Without noise, the closure is 1 - |true - predicted|^2 / |true|^2."""
    t = np.where(made.owner == 4, 1.5, 0.0)
    diagnosis = select_and_diagnose(campaign, Residuals(made.layout, made.measured(rng, t, robot=1)), seed=1)
    change = held_out.sensitivities.change(effect_values(diagnosis))
    again = close(diagnosis, held_out, made.measured(rng, t, robot=1), change)
    assert diagnosis.verdict == "found"
    assert again.least <= 1.0 <= again.most + 0.05
    assert again.share == pytest.approx(1.0, abs=0.1)
    assert again.after < again.before


def test_a_gap_that_a_nuisance_could_imitate_is_not_hidden_by_it(rng):
    """Twenty sigmas of a nuisance imitate the effect: fitted alone, it would leave no gap to close."""
    made = world(effects=5, alike=0, two=0, nuisances=4, scatter=1)
    own, sigma = made.nuisance.copy(), made.nuisances[2].sigma
    own[:, 2] = made.effect[:, 7] / sigma / 20.0
    made = replace(made, nuisance=own)
    campaign, t = modelled(found(made)), np.where(made.owner == 7, 1.0, 0.0)
    diagnosis = select_and_diagnose(campaign, Residuals(made.layout, made.measured(rng, t, robot=1)), seed=1)
    assert [one.hypothesis for one in diagnosis.findings] == [7]
    again = build_held_out_model(campaign.equations, elsewhere(made), campaign.equations.C)
    change = again.sensitivities.change(effect_values(diagnosis))
    held = close(diagnosis, again, made.measured(rng, t, robot=1), change)
    assert held.share == pytest.approx(1.0, abs=0.1)
    assert held.before > 3.0 * held.after


def explainable(made, held_out, energy):
    """Return the explainable whitened change by an effect, scaled to an energy."""
    S = held_out.Q @ (held_out.Q.T @ held_out.whiten(made.effect[:, 4]))
    return S * np.sqrt(energy) / np.linalg.norm(S)


def chance(held_out, rng, floor=1.0):
    """Return noise of `floor` times the noise floor, and of the uncertain nuisances."""
    return floor * rng.standard_normal(held_out.layout.size) + held_out.doubt @ rng.standard_normal(
        held_out.doubt.shape[1]
    )


@pytest.mark.parametrize("floor", [1.0, 0.3])
def test_half_an_effect_closes_three_quarters_however_high_the_floor_is_assumed(made, held_out, rng, floor):
    S, shares, covered = explainable(made, held_out, 1000.0), [], 0
    for _ in range(20):
        r = S + chance(held_out, rng, floor)
        closure = whitened_closure(held_out, r, r - S / 2.0, 1)
        shares.append(closure.share)
        covered += closure.least <= 0.75 <= closure.most
    assert np.median(shares) == pytest.approx(0.75, abs=0.02)
    assert covered >= 15


def test_a_gap_of_a_tenth_of_the_noise_is_shared_out(made, held_out, rng):
    """The noise of all features would hide it, but the explainable directions have less noise."""
    S, shares = explainable(made, held_out, 0.1 * made.layout.size), []
    for _ in range(20):
        r = S + chance(held_out, rng)
        shares.append(whitened_closure(held_out, r, r - S, 1).share)
    assert np.all(np.isfinite(shares))
    assert np.median(shares) == pytest.approx(1.0, abs=0.1)


def test_an_effect_that_hardly_moves_what_is_held_out_is_shared_out_as_well(made, rng):
    """Most directions of effects are below the noise; the direction of the finding is added."""
    blocks = np.isin(made.layout.block, (0, 5))
    kept = found(made)
    equations = form_normal_equations(kept.select(np.flatnonzero(~blocks)))
    held_out = build_held_out_model(equations, kept.select(np.flatnonzero(blocks)), equations.C)
    shares, lost = [], 0
    for column in range(0, made.owner.size, 3):
        S = held_out.whiten(held_out.sensitivities.effect[:, column])
        if not np.any(S):
            continue
        S *= 12.0 / np.linalg.norm(S)
        r = S + chance(held_out, rng)
        closure = whitened_closure(held_out, r, r - S, 1)
        shares.append(closure.share)
        lost += not closure.least <= 1.0 <= closure.most or closure.after < 0.0
    assert len(shares) > 10
    assert np.median(shares) == pytest.approx(1.0, abs=0.1)
    assert lost <= 0.2 * len(shares)


def test_where_there_is_no_gap_no_share_is_claimed(held_out, rng):
    noise = chance(held_out, rng)
    closure = whitened_closure(held_out, noise, noise, 1)
    assert np.isnan(closure.share)
    assert closure.least == -np.inf
    assert closure.before == pytest.approx(1.0, abs=0.5)


def test_motion_that_was_used_for_fitting_is_refused(made, campaign):
    with pytest.raises(ValueError, match=r"also used for fitting: motion 0, motion 1"):
        build_held_out_model(campaign.equations, found(made), campaign.equations.C)


def test_held_out_motion_of_another_catalogue_is_refused(made, campaign):
    with pytest.raises(ValueError, match="the hypotheses of the campaign"):
        build_held_out_model(campaign.equations, elsewhere(made).only(["effect 1"]), campaign.equations.C)
