"""Tests of APXS placements at random reachable targets in the closed loop."""

from functools import cache

import numpy as np
import pytest

from fsw.estimate.reference import Reference
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import PlacementResult, PlacementRun, random_placement
from sim.sequence import Outcome

pytestmark = pytest.mark.slow
MAX_TILT_RAD = np.radians(20.0)
TARGETS = range(3)


@cache
def found_at_its_hardstops(name: str) -> Reference:
    return initial_reference(arm_named(name))


def run_placement(name: str, seed: int) -> PlacementResult:
    """Run a random placement in the closed loop, from the ready pose, after the hardstops were found."""
    arm = arm_named(name)
    world, seen = random_placement(seed, arm, "apxs", MAX_TILT_RAD)
    setup = Setup(arm, world, arm.params.poses.ready_rad, seed, found_at_its_hardstops(name))
    run = PlacementRun(ClosedLoop(setup), seen.placement)
    for _ in run:
        pass
    assert run.result().outcome is Outcome.DONE
    return run.result()


@pytest.mark.parametrize("seed", TARGETS)
def test_the_nominal_arm_touches_within_a_millimetre_and_a_fifth_of_a_degree(seed):
    contact = run_placement("nominal", seed).contact
    assert contact is not None
    assert contact.total_m < 1e-3
    assert np.degrees(contact.axis_rad) < 0.2


@pytest.mark.parametrize("seed", TARGETS)
def test_an_as_built_arm_touches_too_and_its_error_is_told(seed):
    contact = run_placement(f"as-built:{seed}", seed).contact
    assert contact is not None
    assert 0 < contact.total_m < 0.06
