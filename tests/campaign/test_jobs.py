"""The jobs of the arm, each as its scenario has it, at the tilt of the requirement."""

from functools import cache

import numpy as np
import pytest

from benchmarks.scenarios import SAMPLING_TILT_DEG, TILT_DEG
from benchmarks.tool_change import Changed, one_target
from sim.arms import arm_named
from sim.loop import ClosedLoop
from sim.scenario.file import load, shipped
from sim.scenario.run import ScenarioRun, setup_of
from tests.sim.lab import true_reference


@cache
def ran(name: str, arm_name: str, heading_deg: float):
    """A scenario on an arm whose joints are known, the rover tilted towards a heading."""
    arm = arm_named(arm_name)
    tilt, heading = np.radians(TILT_DEG.get(name, SAMPLING_TILT_DEG)), np.radians(heading_deg)
    roll, pitch = np.arcsin(np.sin(tilt) * np.sin(heading)), np.arctan(np.tan(tilt) * np.cos(heading))
    scenario = load(name).tilted(float(roll) * (1 - 1e-9), float(pitch) * (1 - 1e-9))
    loop = ClosedLoop(setup_of(scenario, arm, true_reference(arm), 0))
    run = ScenarioRun(loop, scenario)
    for _ in run:
        pass
    return run.result()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(shipped()))
def test_a_job_is_done_on_the_nominal_arm_on_a_tilted_rover(name):
    result = ran(name, "nominal", 40.0)
    assert [f"{m.check}: {m.name} {m.value} {m.unit}" for m in result.measured if not m.passed] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sampling", "bit-exchange"])
def test_a_job_is_done_on_a_calibrated_arm_on_a_tilted_rover(name):
    result = ran(name, "calibrated:3", -150.0)
    assert [f"{m.check}: {m.name} {m.value} {m.unit}" for m in result.measured if not m.passed] == []


@pytest.mark.slow
def test_a_tool_change_comes_closer_to_the_spot_than_coordinates_to_their_target():
    """On an arm fifty kelvin off and a fifth softer or stiffer than flight software knows."""
    reference = true_reference(arm_named("calibrated:7"))
    tried = (one_target("calibrated:7", reference, draw) for draw in range(9))
    changed = next(found for found in tried if isinstance(found, Changed))
    assert changed.from_spot_mm < 1.0
    assert changed.from_spot_mm < 0.5 * changed.absolute_mm
