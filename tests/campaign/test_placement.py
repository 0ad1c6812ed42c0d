"""Tests of APXS placements at random reachable targets in the closed loop."""

from functools import cache

import numpy as np
import pytest

from fsw.estimate.reference import Reference
from sim.arms import BuiltArm, arm_named
from sim.initialisation import initialise_joints
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementResult, PlacementRun, random_placement
from sim.sequence import Outcome
from sim.world import World

pytestmark = pytest.mark.slow
MAX_TILT_RAD = np.radians(20.0)
TARGETS = range(3)


@cache
def found_at_its_hardstops(name: str) -> Reference:
    """Return the reference of flight software after every joint was at its hardstop."""
    runs = list(initialise_joints(arm_named(name)))
    assert [run.outcome for run in runs] == 5 * [Outcome.DONE]
    return runs[-1].reference


def run_placement(
    arm: BuiltArm, reference: Reference, world: World, placement: Placement, seed: int
) -> PlacementResult:
    """Run a placement in the closed loop, from the ready pose."""
    run = PlacementRun(ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, seed, reference)), placement)
    for _ in run:
        pass
    return run.result()


@pytest.mark.parametrize("seed", TARGETS)
def test_the_nominal_arm_touches_within_a_millimetre_and_a_fifth_of_a_degree(seed):
    arm = arm_named("nominal")
    world, seen = random_placement(seed, arm, "apxs", MAX_TILT_RAD)
    result = run_placement(arm, found_at_its_hardstops("nominal"), world, seen.placement, seed)
    assert result.outcome is Outcome.DONE
    assert result.contact is not None
    assert result.contact.total_m < 1e-3
    assert np.degrees(result.contact.axis_rad) < 0.2


@pytest.mark.parametrize("seed", TARGETS)
def test_an_as_built_arm_touches_too_and_its_error_is_told(seed):
    arm = arm_named(f"as-built:{seed}")
    world, seen = random_placement(seed, arm, "apxs", MAX_TILT_RAD)
    result = run_placement(arm, found_at_its_hardstops(arm.name), world, seen.placement, seed)
    assert result.outcome is Outcome.DONE
    assert result.contact is not None
    assert 0 < result.contact.total_m < 0.06
