"""Verdicts on synthetic cases at the required rates, and what remains."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from helpers.marks import slow_but
from marsarm.common.rates import estimate_rate
from simgap.report.sentences import level, verdict_word
from tests.marsarm.diagnosis.results import sized
from tests.marsarm.diagnosis.worlds import found, indices, modelled, select_and_diagnose, world


def _diagnose(made, campaign, rng, t=None, extra=None):
    return select_and_diagnose(campaign, made.measured(rng, t, extra), seed=1)


@pytest.mark.slow
def test_no_effect_is_not_called_one(made, campaign, rng):
    """At most as many alarms as 97.5 % of samples of a rate of 5 %."""
    cases = 100
    alarms = sum(verdict_word(_diagnose(made, campaign, rng)) != "none" for _ in range(cases))
    assert alarms <= binom.ppf(0.975, cases, 0.05)


@pytest.mark.slow
def test_from_the_limit_of_the_selection_on_nine_of_ten_are_reported_and_sets_hold_the_truth(
    made, campaign, rng
):
    reported, held, covered, cases = 0, 0, [], 60
    for _ in range(cases):
        one = int(rng.integers(len(made.hypotheses)))
        t = np.where(made.owner == one, campaign.family_wise_limits[one], 0.0)
        diagnosis = _diagnose(made, campaign, rng, t)
        reported += bool(diagnosis.findings)
        for finding in diagnosis.findings[:1]:
            named = [campaign.label[campaign.sensitivities.index(key)] for key in finding.effects]
            is_located = made.hypotheses[one].place in finding.places
            held += campaign.label[one] in named if level(finding) == "effect" else is_located
            if indices(campaign, diagnosis)[0] == one:
                true = made.hypotheses[one].values(t[made.owner == one])
                covered += [
                    low <= size <= high for (low, high), size in zip(finding.interval, true, strict=True)
                ]
    assert reported >= binom.ppf(0.025, cases, 0.9)
    assert held >= binom.ppf(0.025, reported, 0.95)
    share = estimate_rate(sum(covered), len(covered))
    assert share.least <= 0.9 <= share.most


def test_effects_at_one_place_may_be_a_single_unknown_one(made, campaign, rng):
    """They have the place, and no name."""
    first, second = (h for h in (10, 15) if made.hypotheses[h].place == made.hypotheses[10].place)
    t = sized(made, campaign, first, 6.0) + sized(made, campaign, second, 6.0)
    diagnosis = _diagnose(made, campaign, rng, t)
    assert {*indices(campaign, diagnosis)} == {first, second}
    assert all(level(one) == "place" and not one.effects for one in diagnosis.findings)


def test_what_remains_beside_effects_at_several_places_may_be_at_another(made, campaign, rng):
    first, second = 10, 16
    assert made.hypotheses[first].place != made.hypotheses[second].place
    layout = made.layout
    strange = 3.0 * layout.sigma * layout.condition[:, 1] * layout.condition[:, 3] * (layout.channel == 12)
    t = sized(made, campaign, first, 8.0) + sized(made, campaign, second, 8.0)
    diagnosis = _diagnose(made, campaign, rng, t, strange)
    assert diagnosis.remaining
    assert len({one.place for one in diagnosis.findings}) > 1
    assert all(level(one) == "none" and len(one.places) == 5 for one in diagnosis.findings)


def test_an_effect_that_is_left_out_and_what_is_the_same_as_it_are_not_named(made, campaign, rng):
    left = replace(campaign, left_out_effect=made.hypotheses[4].effect)
    assert {4, *campaign.equivalence_class(4)} <= left.left_out
    y = made.measured(rng, sized(made, campaign, 4, 6.0))
    diagnosis = select_and_diagnose(left, y, seed=1)
    assert verdict_word(diagnosis) != "none"
    gone = {made.hypotheses[h].key for h in left.left_out}
    assert not {key for one in diagnosis.findings for key in one.effects} & gone


@pytest.mark.parametrize("times", slow_but([1.0, 2.5], 2.5))
def test_a_nonlinear_effect_is_fitted(rng, times):
    """Within the simulated steps the parabola suffices; beyond them the simulator is needed."""
    bent = world(bent=0.8)
    campaign = modelled(found(bent))
    t = np.where(bent.owner == 4, times, 0.0)
    y = bent.measured(rng, t)
    stepped, curved = (
        select_and_diagnose(campaign, y, seed=1, simulate=one) for one in (bent.simulate, None)
    )
    truth = times * bent.hypotheses[4].parameters[0].typical
    assert indices(campaign, stepped)[0] == indices(campaign, curved)[0] == 4
    assert stepped.findings[0].size[0] == pytest.approx(truth, rel=0.1)
    assert (curved.findings[0].size[0] == pytest.approx(truth, rel=0.1)) == (times == 1.0)
