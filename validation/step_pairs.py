"""Campaign of pairs: the median time of `fsw.cycle.step` here over that in another checkout.

Two processes on one core, of this tree and of the other, run blocks of 64 cycles in turn, so that whatever
slows the machine down slows both. Each runs the closed loop of its own tree: recorded sensors would not fit a
flight software that moves at another time. Several pairs of processes are started, as the place of a program
in memory changes its speed. Compared with itself, a tree shows how much the ratio is to be trusted.
"""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from statistics import median
from typing import Final

from simgap.common.errors import BadRequest
from validation.campaigns import ROOT, Context, Document

PROGRAM: Final = Path(__file__).with_name("step_part.py")
PARTS: Final = ("rest", "move", "press")
BLOCKS: Final = 60
"""Blocks of each process."""
MOST_RATIO: Final = 1.03
"""Largest ratio of the medians in a part, here over there."""


class TimedTree:
    """Process that times a part in a tree, one block after the other."""

    def __init__(self, tree: Path, part: str, core: int):
        places = os.pathsep.join(map(str, (tree, tree / "simgap" / "src")))
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(PROGRAM), part],
            cwd=tree,
            env={**os.environ, "PYTHONPATH": places, "PYTHONHASHSEED": "0"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=partial(os.sched_setaffinity, 0, {core}),
        )
        found = self._read()
        if Path(found) != tree:
            self.end()
            raise BadRequest(f"set other: {tree} has no flight software that can be timed; found {found!r}")

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def next_ns(self) -> float:
        """Run the next block; return the median time of its cycles."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._read())

    def end(self) -> None:
        """End the process."""
        self._process.communicate()


def time_pair(here: Path, there: Path, part: str, core: int) -> tuple[list[float], list[float]]:
    """Time a part in both trees; return the medians [ns] of the blocks of each."""
    trees = [TimedTree(here, part, core), TimedTree(there, part, core)]
    found: tuple[list[float], list[float]] = ([], [])
    for block in range(BLOCKS):
        for k in (0, 1) if block % 2 == 0 else (1, 0):
            found[k].append(trees[k].next_ns())
    for tree in trees:
        tree.end()
    return found


def campaign(context: Context, other: Path = ROOT, pairs: int = 6) -> Document:
    """Time this tree and another one in this many pairs of processes for each part."""
    if pairs < 1 or not (other / "fsw").is_dir():
        raise BadRequest(f"set other: {other} is not a checkout, or there are no pairs")
    core, there = min(os.sched_getaffinity(0)), other.resolve()
    parts: dict[str, Document] = {}
    for k, part in enumerate(PARTS):
        context.progress(k, len(PARTS), part)
        # one after the other: pairs at a time would share the core
        parts[part] = compare([time_pair(ROOT, there, part, core) for _ in range(pairs)])
    is_in_bounds = all(one["ratio"] <= MOST_RATIO for one in parts.values())
    return {"parts": parts, "limit": MOST_RATIO, "in_bounds": is_in_bounds}


def compare(timed: list[tuple[list[float], list[float]]]) -> Document:
    """Compare the medians of blocks that followed each other.

    The ratio of a pair of processes is the median of the ratios of its blocks. The median of the pairs is
    told with the least and the largest; with six pairs, the median of endlessly many lies between them in 97
    of 100 cases.
    """
    ratios = [median(a / b for a, b in zip(here, there, strict=True)) for here, there in timed]
    return {
        "ratio": median(ratios),
        "least": min(ratios),
        "largest": max(ratios),
        "here_us": 1e-3 * median(ns for here, _ in timed for ns in here),
        "there_us": 1e-3 * median(ns for _, there in timed for ns in there),
    }
