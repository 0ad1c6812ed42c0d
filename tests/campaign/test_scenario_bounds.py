"""What the campaign of scenarios demands of calibrated and of as-built arms."""

from dataclasses import replace

import numpy as np
import pytest

from sim.scenario.judge import CheckResult
from validation.scenarios import ScenarioOutcome, built_errors, judge_as_built, summary

DONE = ScenarioOutcome("sampling", "as-built:1", (0.0, 0.0), "done", True, (), {}, (), True)


@pytest.mark.parametrize(
    ("case", "is_in_bounds"),
    [
        (DONE, True),
        (replace(DONE, passed=False, failed=("preloaded: force 100 N",)), False),
        (replace(DONE, replays=False), False),
        (replace(DONE, outcome="refused", passed=False), False),
        (replace(DONE, arm="calibrated:1", passed=False), False),
    ],
)
def test_every_arm_must_pass_every_check_of_its_kind(case, is_in_bounds):
    assert summary([DONE, case])["in_bounds"] is is_in_bounds


def test_an_as_built_arm_may_be_off_where_only_coordinates_lead_it_and_nowhere_else():
    far_m, turned_rad = built_errors("apxs").lateral_m, built_errors("apxs").direction_rad
    placed = CheckResult("lateral", 0.0, "m", high=0.015, check="placed")
    held = CheckResult("gravity off", 0.0, "rad", high=0.017, check="gravity_held")
    assert judge_as_built(placed, "apxs").high == far_m > 0.015
    assert judge_as_built(held, "apxs").high == turned_rad > 0.017
    for other in (
        CheckResult("lateral", 0.0, "m", high=0.01, check="same_spot"),
        CheckResult("force", 0.0, "N", 270.0, 330.0, check="preloaded"),
        CheckResult("from the point", 0.0, "m", high=0.003, check="docked"),
        CheckResult("apxs in contact", 1.0, "", 1.0, 1.0, check="placed"),
    ):
        assert judge_as_built(other, "apxs") == other


def test_a_tighter_bound_of_the_tolerances_does_not_narrow_that_of_the_scenario():
    wide = CheckResult("lateral", 0.0, "m", high=0.5, check="placed")
    assert judge_as_built(wide, "apxs") == wide
    assert np.isfinite(built_errors("drill").lateral_m)
