"""Segments of motion and rests in a recording, found from its drive alone, so that imported logs work too."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.logs import Recording

BIN_TICKS: Final = CYCLE_HZ // 4
"""Width of a bin in ticks: a quarter of a second."""
STILL_COUNTS: Final = 50
"""Least range of the set-point in a motion."""
SLOW_SHARE: Final = 0.5
"""Share of the nominal speed below which a motion is slow."""
REVERSAL_S: Final = 1.0
"""Time after a reversal that belongs to the regime "reversal"."""


@dataclass(frozen=True, slots=True)
class Segment:
    """Motion of a powered joint, from tick `first` to before `end`."""

    joint: Joint
    first: int
    end: int
    direction: int
    """+1 or -1."""
    slow: bool
    reversed: bool
    """Motion against the previous motion of the joint in this recording."""

    def bins(self) -> list[tuple[int, int]]:
        """Return the first tick, and the one after the last, of each whole bin."""
        return [(k, k + BIN_TICKS) for k in range(self.first, self.end - BIN_TICKS + 1, BIN_TICKS)]

    def regime(self, first: int) -> str:
        """Return the regime of a bin that begins at this tick."""
        early = first - self.first < REVERSAL_S * CYCLE_HZ
        return "reversal" if self.reversed and early else "slow" if self.slow else "fast"


def find_segments(recording: Recording) -> list[Segment]:
    """Find the segments in the order of joints, then of time."""
    found = []
    for joint in Joint:
        power = recording.drive["power_on"][:, joint].astype(np.int8)
        edges = np.flatnonzero(np.diff(power, prepend=0, append=0))
        before = 0
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            moved = recording.drive["setpoint_count"][first:end, joint]
            if np.ptp(moved) < STILL_COUNTS:
                continue
            direction = int(np.sign(moved[-1] - moved[0])) or 1
            most = float(np.abs(recording.drive["setpoint_rate_rad_s"][first:end, joint]).max())
            slow = most < SLOW_SHARE * recording.params.joints.in_order()[joint].speed_rad_s
            found.append(Segment(joint, int(first), int(end), direction, slow, before * direction < 0))
            before = direction
    return found


def find_rests(recording: Recording) -> list[int]:
    """Find the last tick of every rest on the brakes of at least half a second."""
    still = ~recording.drive["power_on"].any(axis=1) & ~recording.drive["brake_release"].any(axis=1)
    edges = np.flatnonzero(np.diff(still.astype(np.int8), prepend=0, append=0))
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [int(end) - 1 for first, end in pairs if end - first >= CYCLE_HZ // 2]


def bin_means(values: Array, bins: list[tuple[int, int]]) -> Array:
    """Compute means over bins.

    Args:
        values: Values by tick in any unit, shape (n,).
        bins: First tick, and the one after the last, of each of b bins.

    Returns:
        Means in the same unit, shape (b,).
    """
    return np.array([values[first:end].mean() for first, end in bins])
