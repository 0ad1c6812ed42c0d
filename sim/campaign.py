"""Random placements for campaigns: reachable ones, each from a seed of its own."""

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.estimate.reference import Reference
from sim.arms import BuiltArm
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementResult, PlacementRun
from sim.preview import Preview, preview
from sim.workspace import random_surface
from sim.world import Surface, World


def random_placement(seed: int, arm: BuiltArm, tool: Tool, max_tilt_rad: float) -> tuple[World, Preview]:
    """The first placement of this seed that a planner accepts: point, normal and tilt (either way) random."""
    rng = np.random.default_rng([seed, 3])
    while True:
        point, normal = random_surface(rng)
        tilt, heading = rng.uniform(0.0, max_tilt_rad), rng.uniform(-np.pi, np.pi)
        roll, pitch = float(tilt * np.cos(heading)), float(tilt * np.sin(heading))
        world = World("mars", roll, pitch, Surface(point, normal))
        seen = preview(arm, world, Placement(tool, point, normal))
        if seen.problem is None:
            return world, seen


def run_placement(
    arm: BuiltArm, reference: Reference, world: World, placement: Placement, seed: int
) -> PlacementResult:
    """A placement in the closed loop, from the ready pose."""
    loop = ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, seed, reference))
    run = PlacementRun(loop, placement)
    for _ in run:
        pass
    return run.result()
