"""Tools at rest in contact: no contact is lost, no switch changes, and the force stays."""

import pytest

from fsw.dictionary.commands import PlaceTool
from sim.arms import arm_named
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, placement_commands
from sim.world import Surface, World
from validation.contacts import ContactRest, rest_after

POINT_N_M, NORMAL_N = (2.05, 0.1, -0.25), (-0.5, 0.1, -0.85)


@pytest.mark.slow
@pytest.mark.parametrize("arm_name", ["nominal", "calibrated:1"])
@pytest.mark.parametrize("tool", ["apxs", "drill"])
def test_a_touch_rests_half_a_second_after_the_last_set_point(tool: str, arm_name: str) -> None:
    """The force is within 20 % of the mean of the last second, and within 5 % from 2 s or the brakes on."""
    arm = arm_named(arm_name)
    world = World(surface=Surface(POINT_N_M, NORMAL_N))
    loop = ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, reference=true_reference(arm)))
    commands = placement_commands(Placement(tool, POINT_N_M, NORMAL_N), stowed=False)[:-1]
    assert isinstance(commands[-1], PlaceTool)
    rest = rest_after(loop, commands, tool)
    assert isinstance(rest, ContactRest)
    assert rest.mean_N > 5.0
    assert rest.force_error_0_5_s < 0.2
    assert rest.force_error_2_s < 0.05
    assert rest.lost == rest.switched == 0
