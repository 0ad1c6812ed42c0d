"""Baseline methods on a case."""

import numpy as np

from ground.diagnosis.normal_equations import reduce_residuals
from ground.diagnosis.problem import Residuals
from validation.blind.baselines import everything_free, gaussian_process, largest_error


def test_the_place_with_the_largest_error_is_found(made):
    residual = np.where(made.layout.place == 3, 3.0, 1.0)
    assert largest_error(made.layout, residual) == "place 3"


def test_everything_free_fits_at_least_as_much_as_any_one(made, campaign, rng):
    t = np.where(made.owner == 4, 2.0, 0.0)
    case, _ = reduce_residuals(campaign.equations, Residuals(made.layout, made.measured(rng, t)))
    _, sizes = everything_free(campaign.equations, case)
    z = sizes * campaign.equations.scale
    assert 2 * case.all @ z - z @ campaign.equations.R[-1] @ z >= case.all[4] ** 2


def test_a_gaussian_process_learns_what_is_smooth_in_the_conditions(made, rng):
    layout = made.layout
    smooth = 3.0 * np.sin(layout.condition[:, 1]) + layout.condition[:, 0]
    predicted = gaussian_process(layout, smooth + rng.standard_normal(layout.size), layout)
    assert np.mean((predicted - smooth) ** 2) < 0.3 * np.mean(smooth**2)
