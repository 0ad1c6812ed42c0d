"""Confidence classifier: an imitation of an out-of-catalogue cause seldom gets a name."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from ground.diagnosis.confidence import ConfidenceFeatures, compute_confidence_features, train_classifier
from ground.diagnosis.diagnose import diagnose
from ground.diagnosis.normal_equations import reduce_features
from ground.diagnosis.problem import Residuals
from ground.diagnosis.sampling import LIMIT_MULTIPLES
from ground.diagnosis.selection import select_effects
from ground.diagnosis.thresholds import MAX_WRONG_NAMES, calibrate_thresholds


def _features(margin: float) -> ConfidenceFeatures:
    return ConfidenceFeatures(0.0, 3.0, margin, 1.0, 0.0, 1.0, 1.0)


def test_what_wins_by_much_is_trusted_more_than_what_wins_by_little(rng):
    right = rng.random(400) < 0.5
    features = [_features(rng.normal(3.0 if good else 1.0)) for good in right]
    classifier = train_classifier(features, right, ~right, wrong=20)
    assert classifier.log_odds(_features(4.0)) > classifier.log_odds(_features(0.0))
    assert classifier.accepts(_features(4.0))
    assert not classifier.accepts(_features(0.0))
    assert sum(classifier.accepts(one) for one, good in zip(features, right, strict=True) if not good) <= 20


def test_with_nothing_to_learn_from_every_name_is_allowed():
    assert train_classifier([], np.zeros(0, bool), np.zeros(0, bool), wrong=0).accepts(_features(0.0))


def test_where_nothing_chosen_was_ever_right_no_name_is_allowed():
    assert not train_classifier([_features(9.0)], np.zeros(1, bool), np.ones(1, bool), wrong=1).accepts(
        _features(9.0)
    )


@pytest.mark.slow
def test_a_cause_that_is_left_out_seldom_gets_a_name(made, campaign, rng):
    """On cases outside the training, at most as often as 97.5 % of samples of a rate of 15 %."""
    named, cases = 0, 60
    for _ in range(cases):
        one = int(rng.integers(len(made.hypotheses)))
        t = np.where(
            made.owner == one, campaign.limits[one].limit * np.exp(rng.uniform(*np.log(LIMIT_MULTIPLES))), 0.0
        )
        diagnosis = diagnose(_without(campaign, one), Residuals(made.layout, made.measured(rng, t)), seed=1)
        named += diagnosis.verdict in ("named", "set")
    assert named <= binom.ppf(0.975, cases, 0.15)


@pytest.mark.slow
def test_if_every_left_out_effect_is_imitated_these_train_the_classifier(campaign, monkeypatch):
    of = (campaign.equations, campaign.label, campaign.cosine, campaign.limits, campaign.groups)
    for cosine in (0.0, 1.1):
        monkeypatch.setattr("ground.diagnosis.thresholds.IMITATION_COSINE", cosine)
        thresholds = calibrate_thresholds(*of, seed=1, cases=20)
        assert thresholds.left_out_cases == 20
        assert thresholds.wrong_names <= MAX_WRONG_NAMES
        assert np.isfinite(thresholds.confidence.least)


def _without(campaign, one):
    """Return the campaign without an effect at all places, and without its class."""
    effect = campaign.sensitivities.hypotheses[one].effect
    same = np.array([h.effect == effect for h in campaign.sensitivities.hypotheses])
    out = np.isin(campaign.label, campaign.label[same])
    blind = replace(
        campaign.equations, scale=np.where(out[campaign.equations.owner], 0.0, campaign.equations.scale)
    )
    return replace(campaign, equations=blind)


def test_the_margin_is_what_the_best_of_another_class_leaves(made, campaign, rng):
    equations, candidates = campaign.equations, campaign.candidates
    one = next(h for h in range(20, 40) if len(campaign.equivalence_class(h)) == 1)
    t = np.where(made.owner == one, 4.0 * campaign.limits[one].limit, 0.0)
    case = reduce_features(equations, equations.whiten(made.measured(rng, t)))
    selection = select_effects(candidates, case)
    features = compute_confidence_features(
        candidates, campaign.cosine, case, selection.chosen, selection.shares, 1.0
    )
    assert selection.chosen == (one,)
    assert features.log_deviance == pytest.approx(np.log(selection.likelihood_ratio))
    assert 0.0 < np.expm1(features.log_margin) < selection.neg_log10_p
    assert features.extra_effects == features.max_cosine == 0.0
