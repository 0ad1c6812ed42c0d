"""What the findings are worth on motions that took no part, and which motion comes next."""

from dataclasses import replace

import numpy as np
import pytest

from ground.gap.closure import closure
from ground.gap.curved import Curved
from ground.gap.diagnose import diagnose
from ground.gap.held_out import closed, settings_of
from ground.gap.layout import Evidence
from ground.gap.next_motion import next_motion
from ground.gap.prepared import prepare
from tests.ground.gap.worlds import found


def test_closure_agrees_with_the_truth(made, campaign, rng):
    """Of a large effect: noise-free, 1 - |true - predicted|^2 / |true|^2 over the floor."""
    t = np.where(made.owner == 4, 1.5, 0.0)
    told = diagnose(campaign, Evidence(made.layout, made.measured(rng, t, robot=1)), seed=1)
    others = tuple(f"other {name}" for name in made.layout.blocks)
    apart = replace(found(made), layout=replace(made.layout, blocks=others))
    change = Curved(apart).change(settings_of(told))
    again = closed(told, Evidence(apart.layout, made.measured(rng, t, robot=1)), apart, change, seed=1)
    assert told.verdict == "named"
    assert again.least <= 1.0 <= again.most + 0.05
    assert again.share == pytest.approx(1.0, abs=0.1)
    assert again.after < again.before


def test_half_an_effect_closes_three_quarters(made, rng):
    layout, S = made.layout, made.effect[:, 4]
    y = 3.0 * S + layout.sigma * rng.standard_normal(layout.size)
    before, after = y / layout.sigma, (y - 1.5 * S) / layout.sigma
    told = closure(layout, (before, after), (y, y - 1.5 * S), 1, np.zeros(layout.size))
    assert told.share == pytest.approx(0.75, abs=0.03)
    assert told.least <= 0.75 <= told.most


def test_where_there_is_no_gap_no_share_is_claimed(made, rng):
    layout = made.layout
    noise = rng.standard_normal(layout.size)
    told = closure(layout, (noise, noise), (noise, noise), 1, np.zeros(layout.size))
    assert np.isnan(told.share)
    assert told.least == -np.inf


def test_motion_that_was_used_for_fitting_is_refused(made, campaign, rng):
    y = Evidence(made.layout, made.measured(rng))
    told = diagnose(campaign, y, seed=1)
    with pytest.raises(ValueError, match=r"also used for fitting: motion 0, motion 1"):
        closed(told, y, found(made), np.zeros(made.layout.size), seed=1)


def test_the_next_motion_is_the_one_that_separates(made, campaign, rng):
    """Of two that are alike so far: one candidate repeats what was done, one shows them differently."""
    pair = next(
        (g, h) for g in range(40) for h in range(g + 1, 40)
        if campaign.label[g] == campaign.label[h] and np.bincount(made.owner)[g] == 1
    )  # fmt: skip
    kept = found(made)
    other = kept.effect.copy()
    other[:, made.owner == pair[0]] *= rng.normal(size=(made.layout.size, 1))
    candidates = {"the same": campaign.prepared, "another": prepare(replace(kept, effect=other))}
    told = next_motion(campaign.prepared, {h: np.array([2.0]) for h in pair}, candidates)
    assert [motion.name for motion in told] == ["another", "the same"]
    assert told[0].separation > 3.0 * told[0].now
    assert told[1].separation >= told[1].now
