"""Verdicts on synthetic cases at the required rates, and the map of the residual."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from helpers.marks import slow_but
from marsarm.common.rates import estimate_rate
from marsarm.diagnosis.diagnose import MAX_MEMBERS, map_residual
from marsarm.diagnosis.normal_equations import build_full_whitener
from marsarm.diagnosis.problem import Residuals
from marsarm.diagnosis.selection import select
from tests.marsarm.diagnosis.worlds import found, modelled, select_and_diagnose, world


def _sized(made, campaign, one, times):
    return np.where(made.owner == one, times * campaign.limits[one].limit, 0.0)


def _diagnose(made, campaign, rng, t=None, extra=None):
    return select_and_diagnose(campaign, Residuals(made.layout, made.measured(rng, t, extra)), seed=1)


@pytest.mark.slow
def test_no_effect_is_not_called_one(made, campaign, rng):
    """At most as many alarms as 97.5 % of samples of a rate of 5 %."""
    cases = 100
    alarms = sum(_diagnose(made, campaign, rng).verdict != "none" for _ in range(cases))
    assert alarms <= binom.ppf(0.975, cases, 0.05)


@pytest.mark.slow
def test_from_the_limit_of_the_selection_on_nine_of_ten_are_reported_and_sets_hold_the_truth(
    made, campaign, rng
):
    reported, held, covered, cases = 0, 0, [], 60
    for _ in range(cases):
        one = int(rng.integers(len(made.hypotheses)))
        t = np.where(made.owner == one, campaign.limits[one].family_wise_limit, 0.0)
        findings = _diagnose(made, campaign, rng, t).findings
        reported += bool(findings)
        sets = [of for one in findings for of in (one.places, one.families, one.effects)]
        assert all(len(members) <= MAX_MEMBERS for members in sets)
        for finding in findings[:1]:
            is_named = campaign.label[one] in campaign.label[list(finding.effects)]
            is_located = made.hypotheses[one].place in finding.places
            held += is_named if finding.effects else is_located or not finding.places
            if finding.hypothesis == one:
                typical = [p.typical for p in made.hypotheses[one].parameters]
                true = t[made.owner == one] * typical
                covered += list((finding.least <= true) & (true <= finding.most))
    assert reported >= binom.ppf(0.025, cases, 0.9)
    assert held >= binom.ppf(0.025, reported, 0.95)
    share = estimate_rate(sum(covered), len(covered))
    assert share.least <= 0.9 <= share.most


@pytest.mark.slow
def test_a_pair_is_found_with_its_shares(made, campaign, rng):
    hits, cases = 0, 12
    for _ in range(cases):
        pair = rng.choice(len(made.hypotheses), 2, replace=False)
        t = sum(_sized(made, campaign, one, 4.0) for one in pair)
        findings = _diagnose(made, campaign, rng, t).findings
        hits += {int(campaign.label[h]) for h in pair} == {
            int(campaign.label[one.hypothesis]) for one in findings
        }
        assert all(0.0 <= one.share <= 1.0 + 1e-9 for one in findings)
    assert hits >= 9


def test_effects_at_one_place_may_be_a_single_unknown_one(made, campaign, rng):
    """They have the place, and no name."""
    first, second = (h for h in (10, 15) if made.hypotheses[h].place == made.hypotheses[10].place)
    t = _sized(made, campaign, first, 6.0) + _sized(made, campaign, second, 6.0)
    findings = _diagnose(made, campaign, rng, t).findings
    assert {one.hypothesis for one in findings} == {first, second}
    assert all(one.level == "place" and not one.effects and not one.families for one in findings)


def test_what_remains_beside_effects_at_several_places_may_be_at_another(made, campaign, rng):
    first, second = 10, 16
    assert made.hypotheses[first].place != made.hypotheses[second].place
    layout = made.layout
    strange = 3.0 * layout.sigma * layout.condition[:, 1] * layout.condition[:, 3] * (layout.channel == 12)
    t = _sized(made, campaign, first, 8.0) + _sized(made, campaign, second, 8.0)
    diagnosis = _diagnose(made, campaign, rng, t, strange)
    assert diagnosis.has_remainder
    assert len({made.hypotheses[one.hypothesis].place for one in diagnosis.findings}) > 1
    assert all(one.level == "unlocated" and not one.places for one in diagnosis.findings)


@pytest.mark.slow
def test_what_is_in_no_catalogue_gets_no_name(made, campaign, rng):
    """The structure in one channel is several times the detectable size, and no hypothesis imitates it."""
    named, where, cases = 0, 0, 10
    layout = made.layout
    for _ in range(cases):
        place = int(rng.integers(len(layout.places)))
        shape = layout.condition[:, 1] * layout.condition[:, 3] + layout.condition[:, 4]
        extra = 2.0 * layout.sigma * shape * (layout.channel == 3 * place)
        diagnosis = _diagnose(made, campaign, rng, extra=extra)
        named += any(one.effects for one in diagnosis.findings)
        where += diagnosis.unexplained[0].place in (layout.places[place], "all")
    assert named <= 0.15 * cases
    assert where >= 0.7 * cases


def test_an_effect_that_is_left_out_and_what_is_the_same_as_it_are_not_named(made, campaign, rng):
    left = replace(campaign, left_out_effect=made.hypotheses[4].effect)
    assert {4, *campaign.equivalence_class(4)} <= left.left_out
    y = made.measured(rng, _sized(made, campaign, 4, 6.0))
    diagnosis = select_and_diagnose(left, Residuals(made.layout, y), seed=1)
    assert diagnosis.verdict != "none"
    assert not {h for one in diagnosis.findings for h in one.effects} & left.left_out


def test_the_same_seed_gives_the_same_diagnosis(made, campaign, rng):
    y = Residuals(made.layout, made.measured(rng, _sized(made, campaign, 4, 3.0)))
    one, two = (select_and_diagnose(campaign, y, seed=5) for _ in range(2))
    assert one.verdict == two.verdict
    assert one.findings[0].alternatives == two.findings[0].alternatives
    assert np.array_equal(one.findings[0].values, two.findings[0].values)


def test_a_size_at_its_bound_is_no_finding(made, rng):
    kept = found(made)
    few = tuple(
        replace(h, parameters=tuple(replace(p, most=0.05 * p.typical) for p in h.parameters))
        for h in kept.hypotheses
    )
    bounded = replace(kept, hypotheses=few)
    y = made.measured(rng, np.where(made.owner == 4, 1.0, 0.0))
    chosen = select(modelled(bounded), bounded, build_full_whitener(bounded), y, seed=1).chosen
    assert 4 not in chosen


@pytest.mark.parametrize("times", slow_but([1.0, 2.5], 2.5))
def test_a_nonlinear_effect_is_fitted(rng, times):
    """Within the simulated steps the parabola suffices; beyond them the simulator is needed."""
    bent = world(bent=0.8)
    campaign = modelled(found(bent))
    t = np.where(bent.owner == 4, times, 0.0)
    y = Residuals(bent.layout, bent.measured(rng, t))
    stepped, curved = (select_and_diagnose(campaign, y, seed=1, simulator=one) for one in (bent, None))
    truth = times * bent.hypotheses[4].parameters[0].typical
    assert stepped.findings[0].hypothesis == curved.findings[0].hypothesis == 4
    assert stepped.findings[0].values[0] == pytest.approx(truth, rel=0.1)
    assert (curved.findings[0].values[0] == pytest.approx(truth, rel=0.1)) == (times == 1.0)


def test_a_channel_that_several_places_have_is_mapped_place_by_place(made, rng):
    """All places share one kind of channel; the residual is at one place."""
    kinds = ("a", "b", "c")
    layout = replace(made.layout, channel=made.layout.channel % 3, channels=kinds, units=("u",) * 3)
    here = (layout.place == 2) & (layout.channel == 1)
    cells = map_residual(layout, rng.standard_normal(layout.size) * np.where(here, 5.0, 1.0), seed=1)
    assert {(cell.channel, cell.place) for cell in cells[:3]} == {("b", "place 2")}
    assert all(cell.ratio == pytest.approx(5.0, rel=0.4) for cell in cells[:3])
    assert all(cell.ratio < 2.0 for cell in cells[3:])
    assert sum(cell.features for cell in cells) == layout.size


def test_one_motion_tells_no_interval(made, rng):
    alone = replace(made.layout, place=np.where(made.layout.block == 3, 4, made.layout.place % 4))
    cells = map_residual(alone, rng.standard_normal(alone.size), seed=1)
    assert all(np.isnan(cell.least) and np.isnan(cell.most) for cell in cells if cell.place == "place 4")
    assert all(cell.least <= cell.most for cell in cells if cell.place != "place 4")


def test_an_interval_holds_what_it_is_of(made, rng):
    for cell in map_residual(made.layout, rng.standard_normal(made.layout.size), seed=1):
        assert cell.least <= cell.ratio <= cell.most
