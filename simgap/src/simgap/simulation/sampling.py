"""Sampling of simulated positions at the times of measured ones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Array, Integers
from simgap.simulation.windows import Window


@dataclass(frozen=True, slots=True)
class _Series:
    """Samples of one joint in one window."""

    sims: slice
    joint: int
    column: int
    """Place of the first sample in the values."""
    index: Integers
    """Control periods in which they are taken, (1 or n_candidates, n), not decreasing."""
    share: Array
    """Shares of the period that have passed."""


class Sampling:
    """Take samples from a path that is simulated part by part."""

    def __init__(
        self, windows: Sequence[Window], order: Sequence[int], late_s: Array, period_s: float
    ) -> None:
        """Find the control period of each sample.

        Args:
            windows: Windows in the order of the simulations.
            order: For each of them, its place in the order of the values.
            late_s: Delays of the samples, (n_windows, n_candidates, n_joints) [s].
            period_s: Control period [s].
        """
        n_candidates = late_s.shape[1]
        counts = np.zeros((len(windows), late_s.shape[2]), dtype=np.int64)
        for w, place in enumerate(order):
            counts[place] = [one.size for one in windows[w].sample_time_s]
        columns = np.cumsum([0, *counts.ravel()])
        self.values: Array = np.empty((n_candidates, columns[-1]))
        """Sampled positions, (n_candidates, n_samples) [rad]."""
        self._series = []
        for w, window in enumerate(windows):
            for j, time_s in enumerate(window.sample_time_s):
                late = late_s[w, :, j]
                late = late[:1] if np.all(late == late[0]) else late
                position = np.clip((time_s - late[:, None]) / period_s, 0.0, window.n_ticks)
                index = np.minimum(position.astype(np.int64), window.n_ticks - 1)
                sims = slice(w * n_candidates, (w + 1) * n_candidates)
                column = int(columns[order[w] * late_s.shape[2] + j])
                self._series.append(_Series(sims, j, column, index, position - index))

    def take(self, path: Array, first: int, last: int) -> None:
        """Interpolate the samples in some control periods.

        Args:
            path: Positions at the ends of control periods, (more than last - first, n_sims, n_joints) [rad].
            first: First control period of the path.
            last: End of the control periods that are simulated.
        """
        for one in self._series:
            n_candidates = one.sims.stop - one.sims.start
            for row, index in enumerate(one.index):
                low, high = np.searchsorted(index, [first, last])
                if low == high:
                    continue
                k = index[low:high] - first
                is_common = one.index.shape[0] == 1
                part = slice(0, n_candidates) if is_common else slice(row, row + 1)
                q = path[:, one.sims, one.joint][:, part]
                share = one.share[row, low:high, None]
                value = q[k] + share * (q[k + 1] - q[k])
                self.values[part, one.column + low : one.column + high] = value.T
