"""Rates, and what others make of a case."""

import numpy as np
import pytest
from scipy.stats import binom

from ground.gap.baselines import everything_free, gaussian_process, largest_error
from ground.gap.binomial import rate
from ground.gap.case import case_of
from ground.gap.layout import Evidence


@pytest.mark.parametrize(("hits", "of"), [(0, 60), (3, 60), (60, 60), (17, 40)])
def test_the_interval_of_a_rate_is_that_of_the_binomial(hits, of):
    told = rate(hits, of)
    if hits:
        assert binom.sf(hits - 1, of, told.least) == pytest.approx(0.025)
    if hits < of:
        assert binom.cdf(hits, of, told.most) == pytest.approx(0.025)
    assert told.least <= hits / of <= told.most


def test_hits_beyond_the_cases_are_refused():
    with pytest.raises(ValueError, match="5 hits of 4"):
        rate(5, 4)


def test_the_place_with_the_largest_error_is_told(made):
    residual = np.where(made.layout.place == 3, 3.0, 1.0)
    assert largest_error(made.layout, residual) == "place 3"


def test_everything_free_fits_at_least_as_much_as_any_one(made, campaign, rng):
    t = np.where(made.owner == 4, 2.0, 0.0)
    case, _ = case_of(campaign.prepared, Evidence(made.layout, made.measured(rng, t)))
    _, sizes = everything_free(campaign.prepared, case)
    z = sizes * campaign.prepared.scale
    assert 2 * case.all @ z - z @ campaign.prepared.R[-1] @ z >= case.all[4] ** 2


def test_a_gaussian_process_learns_what_is_smooth_in_the_conditions(made, rng):
    layout = made.layout
    smooth = 3.0 * np.sin(layout.condition[:, 1]) + layout.condition[:, 0]
    predicted = gaussian_process(layout, smooth + rng.standard_normal(layout.size), layout)
    assert np.mean((predicted - smooth) ** 2) < 0.3 * np.mean(smooth**2)
