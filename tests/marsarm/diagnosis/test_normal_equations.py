"""Normal equations by block agree with the whole covariance matrix, in any units and order."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from marsarm.diagnosis.model import (
    alias_cosines,
    build_full_whitener,
    detection_limits,
    equivalence_classes,
    fit_linear,
    form_normal_equations,
    noncentrality,
)
from tests.marsarm.diagnosis.worlds import world


@pytest.fixture(scope="module")
def small():
    """Return a campaign small enough for dense matrices."""
    return world(seed=3, m=160, effects=4, places=2, nuisances=4, blocks=5, alike=1, two=1)


def _dense(made):
    """Return the covariance of the features in their units."""
    layout = made.layout
    V = np.diag(layout.sigma**2)
    for index, nuisance in enumerate(made.nuisances):
        n = made.nuisance[:, index] * nuisance.sigma
        same = layout.block[:, None] == layout.block[None, :] if nuisance.random_per_block else 1.0
        V = V + np.outer(n, n) * same
    return V


def likelihood_ratio(equations, y, chosen):
    """Return the deviance that hypotheses explain: a'R a, with nuisances eliminated."""
    a, columns = fit_linear(equations, y, chosen).theta[equations.q :], np.isin(equations.owner, chosen)
    return float(a @ equations.R[np.ix_(columns, columns)] @ a)


def _deviance(V, S, y, t):
    return (y - S @ t) @ np.linalg.solve(V, y - S @ t)


def test_a_fit_is_generalised_least_squares(small, rng):
    equations, V = form_normal_equations(small), _dense(small)
    y = small.measured(rng)
    case = equations.whiten(y)
    S = small.effect[:, np.isin(small.owner, (1, 3))]
    t = np.linalg.solve(S.T @ np.linalg.solve(V, S), S.T @ np.linalg.solve(V, y))
    expected = _deviance(V, S, y, 0 * t) - _deviance(V, S, y, t)
    assert float(likelihood_ratio(equations, case, (1, 3))) == pytest.approx(expected, rel=1e-6)


def test_the_full_whitener_leaves_white_noise(small):
    """W V W' is the identity, with V the covariance by noise and all nuisances."""
    W = build_full_whitener(small)(np.eye(small.layout.size))
    np.testing.assert_allclose(W @ _dense(small) @ W.T, np.eye(small.layout.size), atol=1e-6)


def test_what_is_alike_shares_a_class_and_nothing_else_does(campaign):
    cosine, label = alias_cosines(campaign.equations), equivalence_classes(campaign.equations)
    same = label[:, None] == label[None, :]
    assert label.max() + 1 == 30
    assert np.all(cosine[~same] <= 0.99)
    assert np.all(cosine[same] > 0.99)


def test_what_nuisances_imitate_is_not_seen(small):
    kept = small
    free = tuple(replace(n, sigma=1e6, random_per_block=False) for n in kept.nuisances)
    effect = kept.effect.copy()
    effect[:, 0] = kept.nuisance[:, 3]
    equations = form_normal_equations(replace(kept, nuisances=free, effect=effect))
    assert list(np.flatnonzero(~equations.identifiable)) == [0]
    assert detection_limits(equations, equivalence_classes(equations))[0][0] == np.inf


def test_the_detection_limit_is_found_in_nine_of_ten(made, campaign, rng):
    """Power of the likelihood-ratio test at the limit, simulated: the interval of 400 cases is +-3 %."""
    one = int(np.flatnonzero(np.bincount(made.owner) == 2)[0])
    limit = campaign.limits[one]
    hits = 0
    for _ in range(400):
        y = made.measured(rng, t=np.where(made.owner == one, limit, 0.0))
        case = campaign.equations.whiten(y)
        hits += float(likelihood_ratio(campaign.equations, case, (one,))) > chi2.isf(0.05, 2)
    assert 0.86 <= hits / 400 <= 0.94
    assert noncentrality(1) == pytest.approx((1.959964 + 1.281552) ** 2, rel=1e-3)
