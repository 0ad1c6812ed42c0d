"""What the findings are worth on motions that took no part, and which motion comes next."""

from dataclasses import replace

import numpy as np
import pytest

from ground.diagnosis.closure import (
    build_held_out_model,
    compute_held_out_residuals,
    effect_values,
    whitened_closure,
)
from ground.diagnosis.diagnose import diagnose
from ground.diagnosis.experiment_design import rank_motions
from ground.diagnosis.nonlinear_fit import QuadraticSurrogate
from ground.diagnosis.normal_equations import form_normal_equations
from ground.diagnosis.problem import Residuals
from tests.ground.diagnosis.worlds import found


def elsewhere(made):
    """Sensitivities of the same motions, made again."""
    others = tuple(f"other {name}" for name in made.layout.blocks)
    return replace(found(made), layout=replace(made.layout, blocks=others))


@pytest.fixture
def apart(made, campaign):
    """Held-out motion: the same motions, made again."""
    return build_held_out_model(campaign.equations, elsewhere(made))


def test_closure_agrees_with_the_truth(made, campaign, apart, rng):
    """Of a large effect: noise-free, 1 - |true - predicted|^2 / |true|^2."""
    t = np.where(made.owner == 4, 1.5, 0.0)
    diagnosis = diagnose(campaign, Residuals(made.layout, made.measured(rng, t, robot=1)), seed=1)
    change = QuadraticSurrogate(apart.sensitivities).change(effect_values(diagnosis))
    again = compute_held_out_residuals(diagnosis, apart, made.measured(rng, t, robot=1), change).closure(
        seed=1
    )
    assert diagnosis.verdict == "named"
    assert again.least <= 1.0 <= again.most + 0.05
    assert again.share == pytest.approx(1.0, abs=0.1)
    assert again.after < again.before


def explainable(made, apart, energy):
    """What an effect changes there beside what nuisances take, whitened, of so much energy."""
    S = apart.Q @ (apart.Q.T @ apart.whiten(made.effect[:, 4]))
    return S * np.sqrt(energy) / np.linalg.norm(S)


def chance(apart, rng, floor=1.0):
    """Noise of so many floors, and what is left of the nuisances."""
    return floor * rng.standard_normal(apart.layout.size) + apart.doubt @ rng.standard_normal(
        apart.doubt.shape[1]
    )


@pytest.mark.parametrize("floor", [1.0, 0.3])
def test_half_an_effect_closes_three_quarters_however_high_the_floor_is_assumed(made, apart, rng, floor):
    S, shares, covered = explainable(made, apart, 1000.0), [], 0
    for _ in range(20):
        r = S + chance(apart, rng, floor)
        closure = whitened_closure(apart, r, r - S / 2.0, 1)
        shares.append(closure.share)
        covered += closure.least <= 0.75 <= closure.most
    assert np.median(shares) == pytest.approx(0.75, abs=0.02)
    assert covered >= 15


def test_a_gap_of_a_tenth_of_the_noise_is_shared_out(made, apart, rng):
    """Noise of all features would hide it: of what can be explained there is less."""
    S, shares = explainable(made, apart, 0.1 * made.layout.size), []
    for _ in range(20):
        r = S + chance(apart, rng)
        shares.append(whitened_closure(apart, r, r - S, 1).share)
    assert np.all(np.isfinite(shares))
    assert np.median(shares) == pytest.approx(1.0, abs=0.1)


def test_an_effect_that_hardly_moves_what_is_held_out_is_shared_out_as_well(made, rng):
    """Most directions that effects have there are below the noise: what was found counts among them."""
    blocks = np.isin(made.layout.block, (0, 5))
    kept = found(made)
    equations = form_normal_equations(kept.select(np.flatnonzero(~blocks)))
    apart = build_held_out_model(equations, kept.select(np.flatnonzero(blocks)))
    shares, lost = [], 0
    for column in range(0, made.owner.size, 3):
        S = apart.whiten(apart.sensitivities.effect[:, column])
        if not np.any(S):
            continue
        S *= 12.0 / np.linalg.norm(S)
        r = S + chance(apart, rng)
        closure = whitened_closure(apart, r, r - S, 1)
        shares.append(closure.share)
        lost += not closure.least <= 1.0 <= closure.most or closure.after < 0.0
    assert len(shares) > 10
    assert np.median(shares) == pytest.approx(1.0, abs=0.1)
    assert lost <= 0.2 * len(shares)


def test_where_there_is_no_gap_no_share_is_claimed(apart, rng):
    noise = chance(apart, rng)
    closure = whitened_closure(apart, noise, noise, 1)
    assert np.isnan(closure.share)
    assert closure.least == -np.inf
    assert closure.before == pytest.approx(1.0, abs=0.5)


def test_motion_that_was_used_for_fitting_is_refused(made, campaign):
    with pytest.raises(ValueError, match=r"also used for fitting: motion 0, motion 1"):
        build_held_out_model(campaign.equations, found(made))


def test_held_out_motion_of_another_catalogue_is_refused(made, campaign):
    with pytest.raises(ValueError, match="the hypotheses of the campaign"):
        build_held_out_model(campaign.equations, elsewhere(made).only(["effect 1"]))


def test_the_next_motion_is_the_one_that_separates(made, campaign, rng):
    """Of two that are alike so far: one candidate repeats what was done, one shows them differently."""
    pair = next(
        (g, h) for g in range(40) for h in range(g + 1, 40)
        if campaign.label[g] == campaign.label[h] and np.bincount(made.owner)[g] == 1
    )  # fmt: skip
    kept = found(made)
    other = kept.effect.copy()
    other[:, made.owner == pair[0]] *= rng.normal(size=(made.layout.size, 1))
    candidates = {
        "the same": campaign.equations,
        "another": form_normal_equations(replace(kept, effect=other)),
    }
    motions = rank_motions(campaign.equations, {h: np.array([2.0]) for h in pair}, candidates)
    assert [motion.name for motion in motions] == ["another", "the same"]
    assert motions[0].separation > 3.0 * motions[0].now
    assert motions[1].separation >= motions[1].now
