"""Tests of the jobs of the arm, each by its scenario, at the tilt of the requirement."""

import pytest

from sim.arms import arm_named
from sim.initialisation import true_reference
from sim.scenario.file import built_in_scenarios
from validation.scenarios import run_scenario_on
from validation.tool_change import ToolChangeErrors, one_target

ARMS = ("calibrated:1", "calibrated:2")
JOBS = [(arm, name) for arm in ARMS for name in sorted(built_in_scenarios())]


@pytest.mark.slow
@pytest.mark.parametrize(("arm_name", "name"), JOBS)
def test_a_job_is_done_on_an_arm_whose_parameters_are_its_own(arm_name, name):
    assert run_scenario_on(arm_name, name, true_reference(arm_named(arm_name))).failed == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(built_in_scenarios()))
def test_an_arm_that_is_not_calibrated_refuses_no_job(name):
    """Fly an as-built arm with the nominal parameters."""
    ran = run_scenario_on("as-built:1", name, true_reference(arm_named("as-built:1")))
    assert (ran.outcome, ran.failed) == ("done", ())


@pytest.mark.slow
def test_a_tool_change_comes_closer_to_the_spot_than_coordinates_to_their_target():
    """Use an arm 50 K warmer or colder, and a fifth softer or stiffer, than flight software assumes."""
    reference = true_reference(arm_named("calibrated:7"))
    tried = (one_target("calibrated:7", reference, draw) for draw in range(9))
    changed = next(found for found in tried if isinstance(found, ToolChangeErrors))
    assert changed.from_spot_mm < 1.0
    assert changed.from_spot_mm < 0.5 * changed.absolute_mm
