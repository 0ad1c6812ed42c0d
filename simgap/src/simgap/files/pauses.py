"""Pauses of a log: times in which nothing is logged, and windows that cut a log there."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError

GAP: Final = 2.5
"""A row is missing where a period exceeds this many medians: two rows and half a period of jitter."""
SETTLING_S: Final = 0.3
"""Time in which the position loop of an arm settles, or less. A gap as long, or a step of the clock, is worth
a remark: a joint settles in it unseen."""
MAX_WINDOWS: Final = 8
"""Windows that a sentence lists: more are none."""
ROUNDING_s: Final = 1e-5
"""Rounding of times by which a window is not wider."""


class LongGap(RobotError):
    """A motion has a gap that no simulation should cross."""

    def __init__(self, text: str, windows_s: dict[str, list[float]]) -> None:
        """Keep the windows that cut the log there; none if it has several motions."""
        super().__init__(text)
        self.windows_s = windows_s


def find_pauses(time_s: Array, period_s: float) -> list[tuple[float, float]]:
    """Find pauses in increasing times (n,) of a usual period: last time before, first time after [s]."""
    long = np.flatnonzero(np.diff(time_s) > max(SETTLING_S, GAP * period_s))
    return [(float(time_s[k]), float(time_s[k + 1])) for k in long]


def cut_at_pauses(
    begin_s: float, pauses: Sequence[tuple[float, float]] | Array, end_s: float
) -> dict[str, list[float]]:
    """Return the windows between pauses, as `motion.windows_s` of a robot file: name -> start and end.

    They end at whole hundredths of a second, which are outwards of their rows. Parts that are too short for a
    joint to settle are left out, unless all are such.
    """
    ends_s = [(begin_s, begin_s), *pauses, (end_s, end_s)]
    parts = [(one[1], two[0]) for one, two in pairwise(ends_s)]
    parts = [(low, high) for low, high in parts if high - low >= SETTLING_S] or parts
    return {
        f"part{k}": [math.floor((low + ROUNDING_s) * 100) / 100, math.ceil((high - ROUNDING_s) * 100) / 100]
        for k, (low, high) in enumerate(parts, 1)
    }


def windows_text(windows_s: Mapping[str, Sequence[float]]) -> str:
    """Return windows as the line of a robot file."""
    shown = (f"{name} = [{low:.10g}, {high:.10g}]" for name, (low, high) in windows_s.items())
    return f"windows_s = {{ {', '.join(shown)} }}"
