"""A tool that has touched rests: no contact is lost, no switch changes, and the force stays."""

import numpy as np
import pytest

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import GuardedMove
from fsw.dictionary.joints import SWITCHES_OF, Tool
from sim.arms import arm_named
from sim.contact import tool_forces
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, placement_commands
from sim.sequence import run_sequence
from sim.world import Surface, World

POINT_N_M, NORMAL_N = (2.05, 0.1, -0.25), (-0.5, 0.1, -0.85)
HELD_S = 4.0


@pytest.mark.parametrize("arm_name", ["nominal", "calibrated:1"])
@pytest.mark.parametrize("tool", [Tool.APXS, Tool.DRILL])
def test_a_touch_rests_half_a_second_after_the_last_set_point(tool: Tool, arm_name: str) -> None:
    """Within 20 % of the mean of the last second, and within 5 % from 2 s on."""
    arm = arm_named(arm_name)
    world = World(surface=Surface(POINT_N_M, NORMAL_N))
    loop = ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, reference=true_reference(arm)))
    commands = placement_commands(Placement(tool, POINT_N_M, NORMAL_N), stowed=False)[:-1]
    assert isinstance(commands[-1], GuardedMove)
    force_N, closed, asked = [], [], []

    def note(record) -> None:
        force_N.append(float(np.linalg.norm(tool_forces(loop.plant)[tool])))
        closed.append(record.sensors.switch_closed[list(SWITCHES_OF[tool])])
        asked.append(record.outputs.drive.setpoint_count)

    for record in run_sequence(loop, commands):
        note(record)
    for _ in range(round(HELD_S * CYCLE_HZ)):
        note(loop.cycle())
    changed = np.flatnonzero(np.diff(np.array(asked), axis=0).any(axis=1))
    rests = changed[-1] + 1 + CYCLE_HZ // 2
    force, mean = np.array(force_N), np.mean(force_N[-CYCLE_HZ:])
    assert mean > 5.0
    assert np.abs(force[rests:] - mean).max() < 0.2 * mean
    assert np.abs(force[rests + 3 * CYCLE_HZ // 2 :] - mean).max() < 0.05 * mean
    assert not np.diff(np.array(closed[rests:]).astype(int), axis=0).any()
