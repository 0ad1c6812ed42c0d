"""Forward simulation of many candidates in many windows at once, with effects in each control period."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.simulation.compiled import Models
from simgap.simulation.profiler import profiler_off
from simgap.simulation.simulation import ActiveEffect, Simulation
from simgap.simulation.windows import Window

MEMORY_BYTES: Final = 200_000_000
"""Commands that are kept at once, beside a few copies. More candidates in one batch would not be faster."""


class Engine:
    """Simulations of a robot with a set of effects in a set of windows.

    A candidate is simulated with those effects alone that have a size other than 0, so that its result does
    not depend on the other candidates.
    """

    def __init__(
        self, models: Models, effects: Sequence[Effect], windows: Sequence[Window], n_threads: int = 0
    ) -> None:
        """Keep what is common to all candidates.

        Args:
            models: Models of the robot.
            effects: Effects of all candidates.
            windows: Windows to simulate.
            n_threads: Most threads; 0: as many as there are processors. The result does not depend on it.
        """
        self.models = models
        self.effects = tuple(effects)
        self.windows = tuple(windows)
        self.n_threads = n_threads
        first = np.cumsum([0, *(len(effect.sizes) for effect in effects)])
        self._sizes = [slice(int(a), int(b)) for a, b in pairwise(first)]

    def positions(self, sizes: Array) -> Array:
        """Simulate candidates and sample what the encoders show.

        Args:
            sizes: Sizes of all effects one after the other, (n_candidates, n_sizes) or (n_candidates,
                n_windows, n_sizes), each in its own unit.

        Returns:
            Positions, (n_candidates, n_samples) [rad], in the order of windows, joints, times; NaN in
            windows in which the simulation blew up.
        """
        if sizes.ndim == 2:
            sizes = np.repeat(sizes[:, None], len(self.windows), axis=1)
        active = np.zeros((sizes.shape[0], len(self.effects)), dtype=bool)
        for e, part in enumerate(self._sizes):
            active[:, e] = np.any(sizes[..., part] != 0.0, axis=(1, 2))
        n_samples = sum(one.size for window in self.windows for one in window.sample_time_s)
        shown = np.empty((sizes.shape[0], n_samples))
        for rows in self._groups(active):
            chosen = np.flatnonzero(active[rows].any(axis=0))
            effects = [ActiveEffect(self.effects[e], sizes[rows][..., self._sizes[e]]) for e in chosen]
            simulation = Simulation(self.models, effects, self.windows, len(rows), self.n_threads)
            with profiler_off():
                shown[rows] = simulation.positions()
        return shown

    def _groups(self, active: Integers) -> list[Integers]:
        """Put candidates together that have the same model, and like effects in each control period."""
        varies = np.array([effect.overrides("vary") for effect in self.effects], dtype=bool)
        acts = np.array([_acts(effect) for effect in self.effects], dtype=bool)
        # candidates without effects in each period need no Python between the steps
        kind = np.column_stack([active[:, varies], active[:, acts].any(axis=1)])
        keys = np.column_stack([kind, active[:, acts]])
        order = np.lexsort(keys.T[::-1])
        longest = max(window.n_ticks for window in self.windows)
        candidate_bytes = 8 * longest * len(self.models.robot.joints) * len(self.windows)
        at_once = max(1, MEMORY_BYTES // candidate_bytes)
        groups = []
        first = 0
        for k in range(1, order.size + 1):
            is_end = k == order.size or k - first == at_once
            if is_end or np.any(kind[order[k]] != kind[order[first]]):
                groups.append(order[first:k])
                first = k
        return groups


def _acts(effect: Effect) -> bool:
    hooks = ("act",) if effect.is_steady else ("act", "friction_Nm", "torque_Nm")
    return effect.overrides(*hooks)
