"""Verdicts on synthetic cases: none, named, set or unknown, at the required rates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from ground.common.rates import estimate_rate
from ground.diagnosis.diagnose import ModelComparison, diagnose, fit_subset
from ground.diagnosis.linear_fit import fit_linear
from ground.diagnosis.model import build_model
from ground.diagnosis.normal_equations import reduce_residuals
from ground.diagnosis.problem import Residuals
from ground.diagnosis.residual_analysis import find_lack_of_fit
from ground.diagnosis.selection import select_effects
from tests.ground.diagnosis.worlds import found, world


def _sized(made, campaign, one, times):
    return np.where(made.owner == one, times * campaign.limits[one].limit, 0.0)


@pytest.mark.slow
def test_no_effect_is_not_called_one(made, campaign, rng):
    """At most as many alarms as 97.5 % of samples of a rate of 5 %."""
    alarms, cases = 0, 120
    for _ in range(cases):
        case, y = reduce_residuals(campaign.equations, Residuals(made.layout, made.measured(rng)))
        model = fit_linear(campaign.equations, case, campaign.equations.columns(()))
        left = find_lack_of_fit(campaign.equations, campaign.groups, model, y)[0].neg_log10_p
        alarms += (
            bool(select_effects(campaign.candidates, case).chosen) or left >= campaign.thresholds.structure
        )
    assert alarms <= binom.ppf(0.975, cases, 0.05)
    assert estimate_rate(alarms, cases).least <= 0.05


def test_the_right_one_wins_and_its_interval_covers(made, campaign, rng):
    right, covered, cases = 0, [], 80
    for _ in range(cases):
        one = int(rng.integers(len(made.hypotheses)))
        t = _sized(made, campaign, one, 3.0)
        case, _ = reduce_residuals(campaign.equations, Residuals(made.layout, made.measured(rng, t)))
        selection = select_effects(campaign.candidates, case)
        right += campaign.label[one] in campaign.label[list(selection.chosen)]
        if selection.chosen == (one,):
            at = campaign.equations.columns((one,))
            sigma = np.sqrt(np.diag(np.linalg.inv(campaign.equations.R[-1][np.ix_(at, at)])))
            covered += list(np.abs(selection.a - t[at] * campaign.equations.scale[at]) < 1.645 * sigma)
    assert right >= 0.95 * cases
    share = estimate_rate(sum(covered), len(covered))
    assert share.least <= 0.9 <= share.most


def test_a_pair_is_found_with_its_shares(made, campaign, rng):
    hits = 0
    for _ in range(16):
        pair = rng.choice(len(made.hypotheses), 2, replace=False)
        t = sum(_sized(made, campaign, one, 3.5) for one in pair)
        case, _ = reduce_residuals(campaign.equations, Residuals(made.layout, made.measured(rng, t)))
        selection = select_effects(campaign.candidates, case)
        hits += set(campaign.label[pair]) == set(campaign.label[list(selection.chosen)])
        assert all(0.0 <= share <= 1.0 + 1e-9 for share in selection.shares)
    assert hits >= 12


@pytest.mark.slow
def test_the_winner_of_a_model_comparison_keeps_its_values_in_any_order(made, campaign, rng):
    pair = (2, 25)
    t = _sized(made, campaign, pair[0], 4.0) + _sized(made, campaign, pair[1], 6.0)
    residuals = Residuals(made.layout, made.measured(rng, t))
    case, y = reduce_residuals(campaign.equations, residuals)
    diagnosis = diagnose(campaign, residuals, seed=1)
    found_first = tuple(one.hypothesis for one in diagnosis.findings)
    assert sorted(found_first) == sorted(pair)
    for first in (found_first, found_first[::-1]):
        comparison = ModelComparison(first, fit_subset(campaign, y, case, first, None), (first[0], 8), 1.0)
        findings = diagnose(campaign, residuals, seed=1, comparison=comparison).findings
        assert tuple(one.hypothesis for one in findings) == found_first
        for one, same in zip(findings, diagnosis.findings, strict=True):
            np.testing.assert_allclose(one.values, same.values, rtol=1e-6)
        (instead,) = [one for one in findings if one.hypothesis == first[1]]
        assert 8 in instead.alternatives.hypotheses


@pytest.mark.slow
def test_sets_hold_the_truth_and_intervals_the_size(made, campaign, rng):
    held, sizes, covered, cases = 0, [], [], 40
    for _ in range(cases):
        one = int(rng.integers(len(made.hypotheses)))
        t = _sized(made, campaign, one, 2.0)
        diagnosis = diagnose(campaign, Residuals(made.layout, made.measured(rng, t)), seed=1)
        true = [
            t * p.typical for t, p in zip(t[made.owner == one], made.hypotheses[one].parameters, strict=True)
        ]
        for finding in diagnosis.findings:
            if finding.hypothesis == one:
                covered += list((finding.least <= true) & (true <= finding.most))
        reported = [h for f in diagnosis.findings for h in f.alternatives.hypotheses]
        held += campaign.label[one] in campaign.label[reported]
        sizes += [len(f.alternatives.hypotheses) for f in diagnosis.findings]
    assert held >= binom.ppf(0.025, cases, 0.95)
    assert np.mean(sizes) < 2.0
    share = estimate_rate(sum(covered), len(covered))
    assert len(covered) > cases / 2
    assert share.least <= 0.9 <= share.most


@pytest.mark.slow
def test_what_is_in_no_catalogue_gets_no_name(made, campaign, rng):
    """The structure in one channel is several times the detectable size, and no hypothesis imitates it."""
    named, where, cases = 0, 0, 10
    layout = made.layout
    for _ in range(cases):
        place = int(rng.integers(len(layout.places)))
        shape = layout.condition[:, 1] * layout.condition[:, 3] + layout.condition[:, 4]
        extra = 2.0 * layout.sigma * shape * (layout.channel == 3 * place)
        diagnosis = diagnose(campaign, Residuals(layout, made.measured(rng, extra=extra)), seed=1)
        named += diagnosis.verdict in ("named", "set")
        where += diagnosis.unexplained[0].place in (layout.places[place], "all")
    assert named <= 0.15 * cases
    assert where >= 0.7 * cases


def test_the_same_seed_gives_the_same_diagnosis(made, campaign, rng):
    y = Residuals(made.layout, made.measured(rng, _sized(made, campaign, 4, 3.0)))
    one, two = (diagnose(campaign, y, seed=5) for _ in range(2))
    assert one.verdict == two.verdict
    assert one.findings[0].alternatives == two.findings[0].alternatives
    assert np.array_equal(one.findings[0].values, two.findings[0].values)


def test_a_size_at_its_bound_is_no_finding(made, rng):
    kept = found(made)
    few = tuple(
        replace(h, parameters=tuple(replace(p, most=0.05 * p.typical) for p in h.parameters))
        for h in kept.hypotheses
    )
    bounded = build_model(replace(kept, hypotheses=few), seed=1, cases=10)
    case, _ = reduce_residuals(
        bounded.equations, Residuals(made.layout, made.measured(rng, np.where(made.owner == 4, 1.0, 0.0)))
    )
    assert 4 not in select_effects(bounded.candidates, case).ranking


@pytest.mark.slow
@pytest.mark.parametrize("times", [1.0, 2.5])
def test_a_nonlinear_effect_is_fitted(rng, times):
    """Within the simulated steps the parabola suffices; beyond them the simulator is needed."""
    bent = world(bent=0.8)
    campaign = build_model(found(bent), seed=1, cases=10)
    t = np.where(bent.owner == 4, times, 0.0)
    y = Residuals(bent.layout, bent.measured(rng, t))
    stepped, curved = (diagnose(campaign, y, seed=1, simulator=one) for one in (bent, None))
    truth = times * bent.hypotheses[4].parameters[0].typical
    assert stepped.findings[0].hypothesis == curved.findings[0].hypothesis == 4
    assert stepped.findings[0].values[0] == pytest.approx(truth, rel=0.1)
    assert (curved.findings[0].values[0] == pytest.approx(truth, rel=0.1)) == (times == 1.0)
