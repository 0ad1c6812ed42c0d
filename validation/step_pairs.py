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
BLOCKS: Final = 30
"""Blocks of each part in a process."""
MOST_RATIO: Final = 1.03
"""Largest ratio of the medians in a part, here over there."""


class TimedTree:
    """Process that times parts in a tree, one block after the other."""

    def __init__(self, tree: Path, core: int):
        places = os.pathsep.join(map(str, (tree, tree / "simgap" / "src")))
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(PROGRAM)],
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

    def next_ns(self, part: str) -> float:
        """Run the next block of a part; return the median time of its cycles."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{part}\n")
        self._process.stdin.flush()
        return float(self._read())

    def end(self) -> None:
        """End the process."""
        self._process.communicate()


def time_pair(there: Path, core: int) -> dict[str, float]:
    """Time each part in two processes; return the ratio of this tree to the other, the median of blocks."""
    trees = [TimedTree(ROOT, core), TimedTree(there, core)]
    ratios: dict[str, list[float]] = {part: [] for part in PARTS}
    for block in range(BLOCKS):
        for part in PARTS:
            if block % 2 == 0:
                here_ns, there_ns = trees[0].next_ns(part), trees[1].next_ns(part)
            else:
                there_ns, here_ns = trees[1].next_ns(part), trees[0].next_ns(part)
            ratios[part].append(here_ns / there_ns)
    for tree in trees:
        tree.end()
    return {part: median(found) for part, found in ratios.items()}


def campaign(context: Context, other: Path = ROOT, pairs: int = 16) -> Document:
    """Time this tree and another one in this many pairs of processes."""
    if pairs < 1 or not (other / "fsw").is_dir():
        raise BadRequest(f"set other: {other} is not a checkout, or there are no pairs")
    core, there = min(os.sched_getaffinity(0)), other.resolve()
    found: list[dict[str, float]] = []
    for done in range(pairs):  # one after the other: pairs at a time would share the core
        context.progress(done, pairs, "pairs")
        found.append(time_pair(there, core))
    parts = {part: compare([one[part] for one in found]) for part in PARTS}
    is_in_bounds = all(one["ratio"] <= MOST_RATIO for one in parts.values())
    return {"parts": parts, "limit": MOST_RATIO, "in_bounds": is_in_bounds}


def compare(ratios: list[float]) -> Document:
    """Return the median ratio of the pairs, with an interval.

    In 95 of 100 cases or more, the median of endlessly many pairs lies between these two of six or more.
    """
    left_out = max(int(len(ratios) / 2 - len(ratios) ** 0.5) - 1, 0)
    ordered = sorted(ratios)
    return {"ratio": median(ratios), "from": ordered[left_out], "to": ordered[-1 - left_out]}
