"""Rates and baselines."""

import numpy as np

from ground.gap.baselines import everything_free, gaussian_process, largest_error
from ground.gap.case import case_of
from ground.gap.diagnose import diagnose
from ground.gap.layout import Evidence
from ground.gap.score import Truth, score


def test_cases_are_scored_by_class_and_against_their_truth(made, campaign, rng):
    one = 4
    size = 3.0 * campaign.limits[one].limit
    value = np.array([size * made.hypotheses[one].parameters[0].typical])
    clear = diagnose(
        campaign, Evidence(made.layout, made.measured(rng, np.where(made.owner == one, size, 0.0))), 1
    )
    told = score(campaign, [
        (Truth((one,), (value,), False, 3.0), clear),
        (Truth((one,), (value,), False, 0.5), clear),
        (Truth((), (), True, 3.0), clear),
        (Truth((), (), False, 0.0), clear),
    ])  # fmt: skip
    assert (told.effect.hits, told.effect.of) == (1, 1)
    assert (told.place.hits, told.in_set.hits) == (1, 1)
    assert (told.wrong_name.hits, told.false_alarm.hits) == (1, 1)
    assert told.covered.of == 1


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
