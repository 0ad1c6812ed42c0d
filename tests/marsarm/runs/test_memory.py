"""Memory of a run without a log."""

import gc
import tracemalloc

import pytest

from fsw.dictionary.commands import MoveJoint, Process
from fsw.dictionary.enums import Joint
from marsarm.runs.execution import FRAME_CYCLES, execute
from marsarm.runs.request import NO_FILES
from sim.arms import arm_named
from sim.loop import ClosedLoop
from sim.scenario.data import Done, GravityHeld, Scenario
from sim.scenario.run import ScenarioRun, scenario_setup
from sim.setting import World
from simgap.common.progress import no_progress
from tests.sim import lab

GRAVITY_T = (-0.02, 0.0, -1.0)
"""Gravity in the axes of the portioner in the ready pose, almost."""
FIRST, LAST = FRAME_CYCLES, 4 * FRAME_CYCLES
"""Cycles in the first command and in the second."""


@pytest.mark.slow
def test_a_run_that_shakes_and_moves_keeps_no_object_of_each_cycle():
    """No line keeps as many more blocks as there are cycles; caches of NumPy keep a few, never the same."""
    commands = (Process("portion", GRAVITY_T, 6.0), MoveJoint(Joint.TURRET, 1.4))
    checks = (Done(), GravityHeld(1, "portion", GRAVITY_T))
    scenario = Scenario("test", "T", "S.", World(), commands, checks, "ready")
    arm = arm_named("nominal")
    loop = ClosedLoop(scenario_setup(scenario, arm, lab.true_reference(arm), 1))
    run, kept = ScenarioRun(loop, scenario), {}

    def note(record):
        if record.tick in (FIRST, LAST):
            gc.collect()
            kept[record.tick] = tracemalloc.take_snapshot()
        return run.guess_share(record.tick), 1.0

    tracemalloc.start()
    try:
        done = execute(
            run, loop, {}, NO_FILES, scenario.world, no_progress, note, lambda _: False, arm.model, "T"
        )
    finally:
        tracemalloc.stop()
    assert done.result.passed
    lines = kept[LAST].compare_to(kept[FIRST], "lineno")
    assert max(lines, key=lambda line: line.count_diff).count_diff < LAST - FIRST
