"""Sample logs of any length, which repeat the beginning of a hardstop initialisation."""

from dataclasses import replace
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Final

from fsw.config import configure
from fsw.dictionary.commands import CalibrateAll
from marsarm.telemetry.format import CHUNK_CYCLES
from marsarm.telemetry.recorder import Recorder
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.world import World

PERIOD: Final = 8192
"""Cycles after which the recorded cycles repeat."""


@cache
def hardstop_cycles(cycles: int) -> tuple[CycleRecord, ...]:
    """Run the first cycles of a hardstop initialisation; the records contain the truth of the plant."""
    arm = arm_named("nominal")
    loop = ClosedLoop(Setup(arm, World(), arm.params.poses.ready_rad), with_truth=True)
    return tuple(loop.cycle((CalibrateAll(),) if tick == 0 else ()) for tick in range(cycles))


def record_log(path: Path, cycles: int, chunk_cycles: int = CHUNK_CYCLES) -> Path:
    """Write a complete log of this many cycles."""
    config = configure(arm_named("nominal").params)
    with Recorder(path, {"seed": "0", "arm": "nominal"}, config, chunk_cycles) as recorder:
        for tick, record in zip(range(cycles), cycle(hardstop_cycles(min(max(cycles, 1), PERIOD)))):
            recorder.write(replace(record, tick=tick))
    return path
