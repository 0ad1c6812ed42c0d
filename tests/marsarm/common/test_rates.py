"""Tests of exact confidence intervals of proportions."""

import pytest
from scipy.stats import binom

from marsarm.common.rates import estimate_rate


@pytest.mark.parametrize(("hits", "of"), [(0, 60), (3, 60), (60, 60), (17, 40)])
def test_the_interval_of_a_rate_is_that_of_the_binomial(hits, of):
    rate = estimate_rate(hits, of)
    if hits:
        assert binom.sf(hits - 1, of, rate.least) == pytest.approx(0.025)
    if hits < of:
        assert binom.cdf(hits, of, rate.most) == pytest.approx(0.025)
    assert rate.least <= hits / of <= rate.most


def test_hits_beyond_the_cases_are_refused():
    with pytest.raises(ValueError, match="5 hits of 4"):
        estimate_rate(5, 4)
