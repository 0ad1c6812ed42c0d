"""Logs to measure with: a placement, recorded again and again until the log is as long as it shall be."""

from dataclasses import replace
from functools import cache
from itertools import cycle, islice
from pathlib import Path

from benchmarks.closed_loop import TARGET
from ground.telemetry.record import Recorder
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import PlacementRun
from sim.record import CycleRecord
from sim.world import Surface, World


@cache
def placement(most: int) -> tuple[CycleRecord, ...]:
    """The first cycles of a placement, so many at most, the truth of the plant with them."""
    arm = arm_named("nominal")
    world = World(surface=Surface(TARGET.target_N_m, TARGET.normal_N))
    setup = Setup(arm, world, arm.params.poses.ready_rad, reference=initial_reference(arm))
    return tuple(islice(PlacementRun(ClosedLoop(setup, with_truth=True), TARGET), most))


def recorded(path: Path, cycles: int, chunk_s: float) -> Path:
    """A closed log of so many cycles."""
    with Recorder(path, {"seed": "0", "arm": "nominal"}, chunk_s=chunk_s) as recorder:
        for tick, record in zip(range(cycles), cycle(placement(max(cycles, 1)))):
            recorder.write(replace(record, tick=tick))
    return path
