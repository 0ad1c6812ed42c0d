"""Alternatives to the chosen effects: the runner-up of a model comparison, and likely other classes."""

import numpy as np
import pytest

from ground.diagnosis.bootstrap import MIN_PROBABILITY, SET_COVERAGE, Alternatives, replacement_deviances
from ground.diagnosis.diagnose import ModelComparison
from ground.diagnosis.normal_equations import reduce_features
from ground.diagnosis.selection import select_effects


def _comparison(runner_up: tuple[int, ...]) -> ModelComparison:
    return ModelComparison((1, 2), None, runner_up, 1.0)  # type: ignore[arg-type]  # the chosen sets suffice


def test_the_runner_up_replaces_the_effect_in_which_it_differs():
    assert _comparison((3, 2)).replacement_for(1, (1, 2)) == 3
    assert _comparison((2, 3)).replacement_for(1, (2, 1)) == 3
    assert _comparison((3, 2)).replacement_for(5, (5, 2)) is None
    assert _comparison((3, 2)).replacement_for(2, (1, 2)) is None
    assert _comparison((3, 4)).replacement_for(1, (1, 2)) is None
    assert _comparison((3,)).replacement_for(1, (1, 2)) is None


def test_the_set_has_what_is_likely_and_its_probabilities_are_a_share_of_one():
    alone = Alternatives((7,), (1.0,))
    assert alone.with_likelihoods(7, {8: 20.0}) == alone
    found = alone.with_likelihoods(7, {8: 0.0, 9: 3.0, 10: 20.0})
    assert found.hypotheses == (7, 8, 9)
    assert found.probability[0] == pytest.approx(found.probability[1])
    assert found.probability[2] / found.probability[0] == pytest.approx(np.exp(-1.5))
    assert SET_COVERAGE <= sum(found.probability) <= 1.0 + 1e-12


def test_what_was_drawn_more_often_than_its_likelihood_says_keeps_that():
    drawn = Alternatives((7, 8), (0.6, 0.4))
    assert drawn.with_likelihoods(7, {8: 30.0}) == drawn
    assert drawn.with_likelihoods(7, {8: 4.0}).hypotheses == (7, 8)


@pytest.mark.parametrize("drawn", [Alternatives((7,), (0.0,)), Alternatives((9,), (0.97,))])
def test_what_was_chosen_is_likelier_than_what_is_worse_whatever_was_drawn(drawn):
    found = drawn.with_likelihoods(7, {8: 2.0})
    known = dict(zip(found.hypotheses, found.probability, strict=True))
    assert known[7] > known[8] > 0.0


def test_in_place_of_an_effect_all_other_classes_are_worse(made, campaign, rng):
    t = np.where(made.owner == 30, 5.0 * campaign.limits[int(made.owner[30])].limit, 0.0)
    case = reduce_features(campaign.equations, campaign.equations.whiten(made.measured(rng, t)))
    selection = select_effects(campaign.candidates, case)
    (one,) = selection.chosen
    others = replacement_deviances(campaign.candidates, case, selection.chosen, one)
    assert min(others.values()) >= 0.0
    assert not set(others) & set(campaign.equivalence_class(one))
    assert np.exp(-max(others.values()) / 2.0) < MIN_PROBABILITY
