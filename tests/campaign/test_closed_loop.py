"""Parts of campaigns in the closed loop: jobs, placements, obstacles and random commands."""

import numpy as np
import pytest

from helpers.marks import slow_but
from sim.arms import arm_named
from sim.initialisation import initial_reference, true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import PlacementRun, random_placement
from sim.scenario.file import built_in_scenarios
from sim.sequence import Outcome
from tests.tools import TOOLS, WITH_SWITCHES
from validation.campaigns import Context
from validation.commands import campaign
from validation.instruments import bring_tool
from validation.obstacles import STRAIGHT_N, draw, meet
from validation.scenarios import run_scenario_on
from validation.tool_change import ToolChangeErrors, one_target


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(built_in_scenarios()))
def test_a_job_is_done_on_an_arm_whose_parameters_are_its_own(name):
    assert run_scenario_on("calibrated:1", name, true_reference(arm_named("calibrated:1"))).failed == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bit-exchange", "sampling"])
def test_an_arm_that_is_not_calibrated_refuses_no_job(name):
    """Fly an as-built arm with the nominal parameters."""
    ran = run_scenario_on("as-built:1", name, true_reference(arm_named("as-built:1")))
    assert (ran.outcome, ran.failed) == ("done", ())


@pytest.mark.parametrize("tool", slow_but(TOOLS, "mahli"))
def test_every_tool_comes_to_where_it_works_first(tool):
    run = bring_tool("calibrated:1", true_reference(arm_named("calibrated:1")), tool, 1)
    assert run.accepted
    assert run.completed
    assert run.faults == ()
    assert run.lateral_mm < 5.0
    assert (run.force_N > 0.0) == (tool in WITH_SWITCHES)


@pytest.mark.slow
def test_a_tool_change_comes_closer_to_the_spot_than_coordinates_to_their_target():
    """Use an arm 50 K warmer or colder, and a fifth softer or stiffer, than flight software assumes."""
    reference = true_reference(arm_named("calibrated:7"))
    tried = (one_target("calibrated:7", reference, draw) for draw in range(9))
    changed = next(found for found in tried if isinstance(found, ToolChangeErrors))
    assert changed.from_spot_mm < 1.0
    assert changed.from_spot_mm < 0.5 * changed.absolute_mm


@pytest.mark.slow
def test_an_as_built_arm_touches_too_and_its_error_is_told():
    """It begins in the ready pose, after the hardstops were found, and its target is drawn."""
    arm = arm_named("as-built:1")
    world, seen = random_placement(1, arm, "apxs", np.radians(20.0))
    run = PlacementRun(
        ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, 1, initial_reference(arm))), seen.placement
    )
    for _ in run:
        pass
    assert run.result().outcome is Outcome.DONE
    contact = run.result().contact
    assert contact is not None
    assert 0 < contact.total_m < 0.06


TURNS = (1, 8, 24)


@pytest.mark.slow
@pytest.mark.parametrize("index", [10, 31, 34])
def test_an_obstacle_in_a_straight_move_is_reported_below_50_newtons(index):
    met = meet(0, index)
    assert met.reported, met.report
    assert met.kind == "line"
    assert met.true_N <= STRAIGHT_N


def test_turns_and_straight_moves_are_among_the_first_four():
    assert {draw(0, index, 0).kind for index in range(4)} == {"AZIMUTH", "line"}


@pytest.mark.parametrize("index", slow_but(TURNS, 24))
def test_an_obstacle_in_a_turn_is_reported_with_joint_and_torque(index):
    met = meet(0, index)
    assert met.report.startswith("unexpected contact: ")
    assert met.reported
    assert met.true_N < 154.0  # docs/faults.md, at a lever of 1 m


@pytest.mark.slow
def test_no_random_command_ends_flight_software_or_moves_anything_when_it_is_refused():
    found = campaign(Context(101), 1500)
    assert found["bugs"] == []
    assert found["cycles"] == 1500
    assert found["accepted"]
    assert sum(found["refused"].values()) > 300
