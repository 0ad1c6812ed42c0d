"""Random placements for campaigns: reachable ones, each from a seed of its own."""

from dataclasses import replace
from typing import Final

import numpy as np

from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.joints import Tool
from fsw.dictionary.tuples import joints5
from fsw.estimate.reference import Reference
from sim.arms import BuiltArm
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementError, PlacementResult, PlacementRun
from sim.preview import Preview, preview
from sim.workspace import random_surface
from sim.world import Surface, World

SHORT_MOVE_RAD: Final = 0.05


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


def standoff_error(arm: BuiltArm, reference: Reference, seed: int, max_tilt_rad: float) -> PlacementError:
    """How far the true APXS is from its commanded standoff in free space, after a short move to it."""
    world, seen = random_placement(seed, arm, Tool.APXS, max_tilt_rad)
    way = np.array(arm.params.poses.ready_rad) - seen.standoff_rad
    near = seen.standoff_rad + np.clip(way, -SHORT_MOVE_RAD, SHORT_MOVE_RAD)
    loop = ClosedLoop(Setup(arm, world, joints5(near), seed, reference))
    run = PlacementRun(loop, replace(seen.placement, via_m=0.0))
    for record in run:
        if CommandCompleted("MoveTool") in record.outputs.evrs:
            break
    error = run.result().standoff
    if error is None:
        raise RuntimeError(f"{arm.name}: the move to the standoff did not end: {run.result().evrs[-1]}")
    return error


def run_placement(
    arm: BuiltArm, reference: Reference, world: World, placement: Placement, seed: int
) -> PlacementResult:
    """A placement in the closed loop, from the ready pose."""
    loop = ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, seed, reference))
    run = PlacementRun(loop, placement)
    for _ in run:
        pass
    return run.result()
