"""Program that times flight software in blocks of cycles, in the tree that Python finds first.

`step_pairs` starts it, in two trees at a time, and lets them run in turn. It uses names only that both have.
It prints the tree; then, for the name of a part in each line that it reads, the median processor time [ns] of
the next block of that part.
"""

import gc
import sys
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

import fsw
import sim.loop
from fsw.cycle import step
from fsw.dictionary.commands import MoveJoints, Preload
from sim.arms import arm_named
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, place_command
from sim.record import CycleRecord
from sim.sequence import run_sequence
from sim.setting import Surface, World

BLOCK_CYCLES: Final = 64
TARGET: Final = Placement("apxs", (2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))
TURN_RAD: Final = (0.3, 0.1, -0.1, 0.2, 0.3)
PRESS_N: Final = 60.0


def main() -> None:
    """Print the tree, then a line for each name of a part in the input."""
    arm = arm_named("nominal")
    world = World(surface=Surface(TARGET.p_N_m, TARGET.normal_N))
    ready = ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, 0, true_reference(arm)))
    touching = ready.fork()
    for _ in run_sequence(touching, (place_command(TARGET),)):
        pass
    parts = {
        "rest": rest(ready.fork()),
        "move": repeat(ready, MoveJoints(TURN_RAD, relative=True)),
        "press": repeat(touching, Preload(TARGET.tool, PRESS_N)),
    }
    times_ns = list[int]()
    sim.loop.step = timed(times_ns)  # type: ignore[attr-defined]
    gc.collect()
    gc.freeze()
    print(Path(fsw.__file__).parents[1], flush=True)
    for line in sys.stdin:
        times_ns.clear()
        for _ in islice(parts[line.strip()], BLOCK_CYCLES):
            pass
        print(np.median(times_ns), flush=True)


def rest(loop: ClosedLoop) -> Iterator[CycleRecord]:
    """Run cycles without a command."""
    while True:
        yield loop.cycle()


def repeat(start: ClosedLoop, command: Any) -> Iterator[CycleRecord]:
    """Run a command again and again from the same start."""
    while True:
        yield from run_sequence(start.fork(), (command,))


def timed(times_ns: list[int]) -> Any:
    """Return `fsw.cycle.step`, with the nanoseconds of processor time of each call appended to a list."""

    def run(*arguments: Any) -> Any:
        began_ns = time.thread_time_ns()
        result = step(*arguments)
        times_ns.append(time.thread_time_ns() - began_ns)
        return result

    return run


if __name__ == "__main__":
    main()
