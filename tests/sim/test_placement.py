"""Preview of a path without collisions, and placement of an instrument along it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.evrs import CommandCompleted, ContactMade
from fsw.dictionary.faults import ContactInFreeSpace
from fsw.dictionary.types import Vector3
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementResult, PlacementRun, Preview, preview_placement
from sim.sequence import Outcome
from sim.setting import Surface, World
from tests.sim import lab
from tests.tools import TOOL_SWITCHES, TOOLS

NOMINAL = arm_named("nominal")
OPEN: tuple[Vector3, Vector3] = ((2.1, 0.2, -0.3), (-0.3, 0.0, -1.0))
BEHIND_AN_EDGE: tuple[Vector3, Vector3] = ((2.166, -0.129, -0.127), (-0.927, 0.275, -0.254))
"""Face so steep that the path from the ready pose leads through the rock."""


def preview(surface: tuple[Vector3, Vector3], tool: str = "apxs") -> Preview:
    return preview_placement(NOMINAL, World(surface=Surface(*surface)), Placement(tool, *surface))


def place(placement: Placement, world: World) -> tuple[ClosedLoop, PlacementResult]:
    known = lab.true_reference(NOMINAL)
    loop = ClosedLoop(Setup(NOMINAL, world, NOMINAL.params.poses.ready_rad, seed=1, reference=known))
    run = PlacementRun(loop, placement)
    ticks = [record.tick for record in run]
    assert ticks == list(range(len(ticks)))
    return loop, run.result()


@pytest.mark.parametrize(("surface", "moves"), [(OPEN, 2), (BEHIND_AN_EDGE, 3)])
def test_an_open_target_has_a_direct_way_and_one_behind_an_edge_one_from_farther_away(surface, moves):
    found = preview(surface)
    assert (found.problem, len(found.plans)) == (None, moves)
    assert 10.0 < found.duration_s < 300.0


def test_a_preview_takes_a_tool_in_any_case_and_tells_what_no_command_may_hold():
    assert preview(OPEN, tool="APXS").branch == preview(OPEN).branch
    assert preview(OPEN, tool="spoon").problem == "tool: 'spoon' is not known; there are " + ", ".join(TOOLS)
    problem = preview(((100.0, 0.0, 0.0), (0.0, 0.0, -1.0))).problem
    assert problem == "p_RoTo_R_m: number 1: 99.90998 is outside -20 .. 20"


@pytest.mark.parametrize(
    ("surface", "problem"),
    [
        (((5.0, 0.0, 0.0), (0.0, 0.0, -1.0)), "out of reach"),
        (((2.1, 0.0, -0.3), (0.0, 0.0, 1.0)), "below the surface"),
        (((1.3, -0.3, -0.3), (0.0, 0.0, -1.0)), "the drill meets the mast head"),
    ],
    ids=["too far", "from below", "close to the rover"],
)
def test_a_target_without_a_way_is_told_with_what_is_in_it(surface, problem):
    found = preview(surface)
    assert found.problem is not None
    assert re.search(problem, found.problem), found.problem


def test_the_way_from_the_stowed_pose_is_looked_at_where_the_arm_starts_there():
    world, placement = World(surface=Surface(*OPEN)), Placement("apxs", *OPEN)
    poses = replace(NOMINAL.params.poses, unstow_via_rad=((-3.0, 0.0, 0.0, 0.0, 0.0),))
    through_the_rover = replace(NOMINAL, params=replace(NOMINAL.params, poses=poses))
    assert preview_placement(NOMINAL, world, placement, stowed=True).problem is None
    assert preview_placement(through_the_rover, world, placement).problem is None
    problem = preview_placement(through_the_rover, world, placement, stowed=True).problem
    assert problem is not None
    assert re.search(r"^the upper arm .* on the way from the stowed to the ready pose$", problem), problem


@pytest.mark.slow
@pytest.mark.parametrize("surface", [OPEN, BEHIND_AN_EDGE], ids=["open", "behind an edge"])
def test_the_nominal_arm_places_the_apxs_from_the_ready_pose(surface):
    world = World(tilt_roll_rad=0.1, tilt_pitch_rad=-0.15, surface=Surface(*surface))
    found = preview_placement(NOMINAL, world, Placement("apxs", *surface))
    assert found.problem is None
    loop, result = place(found.placement, world)
    evrs = [evr for _, evr in result.evrs]
    assert result.outcome is Outcome.DONE
    assert result.branch == found.branch
    assert not any(isinstance(evr, ContactInFreeSpace) for evr in evrs)
    touched = [evr.switch for evr in evrs if isinstance(evr, ContactMade)]
    assert touched
    assert set(touched) <= set(TOOL_SWITCHES["apxs"])
    assert CommandCompleted("Retract") in evrs
    assert result.contact is not None
    assert result.contact.total_m < 1e-3
    assert np.degrees(result.contact.axis_rad) < 0.2
    assert result.standoff is not None
    assert result.standoff.total_m < 1e-3
    assert loop.plant.truth().contact_force_N == 0.0
    assert loop.plant.data.eq_active[loop.plant.at.brake].all()
    times = [time_s for time_s, _ in result.evrs]
    assert times == sorted(times)
    assert result.duration_s == pytest.approx(loop.state.tick / 64)
