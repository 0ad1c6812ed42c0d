"""A name needs odds: what imitates a cause that is in no catalogue seldom has them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from ground.diagnosis.case import reduced
from ground.diagnosis.diagnose import diagnose
from ground.diagnosis.drawn import SIZES
from ground.diagnosis.layout import Evidence
from ground.diagnosis.race import race
from ground.diagnosis.thresholds import WRONG, calibrate
from ground.diagnosis.trust import Signs, learnt, signs_of


def _signs(margin: float) -> Signs:
    return Signs(0.0, 3.0, margin, 1.0, 0.0, 1.0, 1.0)


def test_what_wins_by_much_is_trusted_more_than_what_wins_by_little(rng):
    right = rng.random(400) < 0.5
    signs = [_signs(rng.normal(3.0 if good else 1.0)) for good in right]
    trust = learnt(signs, right, ~right, wrong=20)
    assert trust.odds(_signs(4.0)) > trust.odds(_signs(0.0))
    assert trust.allows(_signs(4.0))
    assert not trust.allows(_signs(0.0))
    assert sum(trust.allows(one) for one, good in zip(signs, right, strict=True) if not good) <= 20


def test_with_nothing_to_learn_from_every_name_is_allowed():
    assert learnt([], np.zeros(0, bool), np.zeros(0, bool), wrong=0).allows(_signs(0.0))


def test_where_nothing_chosen_was_ever_right_no_name_is_allowed():
    assert not learnt([_signs(9.0)], np.zeros(1, bool), np.ones(1, bool), wrong=1).allows(_signs(9.0))


def test_a_cause_that_is_left_out_seldom_gets_a_name(made, campaign, rng):
    """On cases that nothing was learnt from, no more often than 97.5 % of samples of 15 % are."""
    named, cases = 0, 60
    for _ in range(cases):
        one = int(rng.integers(len(made.hypotheses)))
        t = np.where(made.owner == one, campaign.limits[one].limit * np.exp(rng.uniform(*np.log(SIZES))), 0.0)
        told = diagnose(_without(campaign, one), Evidence(made.layout, made.measured(rng, t)), seed=1)
        named += told.verdict in ("named", "set")
    assert named <= binom.ppf(0.975, cases, 0.15)


def test_where_every_effect_has_kin_these_teach_what_a_name_needs(campaign, monkeypatch):
    of = (campaign.prepared, campaign.label, campaign.cosine, campaign.limits, campaign.looked)
    for kin in (0.0, 1.1):
        monkeypatch.setattr("ground.diagnosis.thresholds.KIN", kin)
        told = calibrate(*of, seed=1, cases=20)
        assert told.strangers == 20
        assert told.wrong <= WRONG
        assert np.isfinite(told.trust.least)


def _without(campaign, one):
    """The campaign without an effect at all places, and what is of its class."""
    effect = campaign.found.hypotheses[one].effect
    same = np.array([h.effect == effect for h in campaign.found.hypotheses])
    out = np.isin(campaign.label, campaign.label[same])
    blind = replace(
        campaign.prepared, scale=np.where(out[campaign.prepared.owner], 0.0, campaign.prepared.scale)
    )
    return replace(campaign, prepared=blind)


def test_the_margin_is_what_the_best_of_another_class_leaves(made, campaign, rng):
    prepared, field = campaign.prepared, campaign.field
    one = next(h for h in range(20, 40) if len(campaign.confusable(h)) == 1)
    t = np.where(made.owner == one, 4.0 * campaign.limits[one].limit, 0.0)
    case = reduced(prepared, prepared.whiten(made.measured(rng, t)))
    won = race(field, case)
    signs = signs_of(field, campaign.cosine, case, won.chosen, won.shares, 1.0)
    assert won.chosen == (one,)
    assert signs.explained == pytest.approx(np.log(won.dropped))
    assert 0.0 < np.expm1(signs.margin) < won.surprise
    assert signs.more == signs.alike == 0.0
