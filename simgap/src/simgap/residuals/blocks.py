"""Blocks: parts of a motion that count as motions, where a log has too few motions of its own.

Blocks must be longer than the time over which a residual remembers, or they would not be independent. With
the autocorrelation rho of the residual of a joint in a motion, n residuals scatter like n T / tau independent
ones, where

    tau = T (1 + 2 sum of rho(k T)),  k = 1, 2, .. up to the first rho that is not positive.

That is the correlation time. Each joint is cut by its own, so that one joint with a slow misfit leaves the
others their blocks; where it is longer than a motion, the motion stays one block. The motion is not cut:
blocks share its filter and its simulation, and only the residuals are counted by block.
"""

from collections.abc import Sequence
from copy import copy

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.residuals.residuals import ResidualModel


class Blocks:
    """A residual model whose units of inference are blocks; see `ResidualModel`.

    A block is named after its motion, its joint and its place: "A:shoulder:1", "A:shoulder:2".
    """

    by_motion = False

    def __init__(self, model: ResidualModel, counts: Integers) -> None:
        """Divide the motions.

        Args:
            model: Residuals of whole motions.
            counts: Number of blocks of each motion and joint, which are equally long, (n_motions, n_joints);
                0 without residuals.
        """
        block = np.zeros(model.time_s.size, dtype=np.int64)
        names: list[str] = []
        self.parents: tuple[str, ...] = ()
        """Name of the motion of each block."""
        for m, j in np.argwhere(counts > 0):
            rows = (model.motion_of == m) & (model.joint_of == j)
            kept, place = np.unique(_divide(model.time_s[rows], int(counts[m, j])), return_inverse=True)
            block[rows] = len(names) + place  # a block in a gap of the samples is none
            names += [f"{model.motions[m]}:{model.joints[j]}:{k + 1}" for k in range(kept.size)]
            self.parents += (model.motions[m],) * kept.size
        self.whole = model
        self._fill(model, np.arange(model.time_s.size), block, tuple(names))

    @property
    def joint_of_block(self) -> Integers:
        """Joint of each block, (n_blocks,), index."""
        found = np.zeros(len(self.motions), dtype=np.int64)
        found[self.motion_of] = self.joint_of
        return found

    @property
    def parent_of(self) -> Integers:
        """Motion of each residual, (n,), index."""
        names = list(dict.fromkeys(self.parents))
        return np.array([names.index(name) for name in self.parents], dtype=np.int64)[self.motion_of]

    def _fill(self, model: ResidualModel, rows: Integers, block: Integers, names: tuple[str, ...]) -> None:
        self._model, self._rows = model, rows
        self.kind, self.unit, self.joints = model.kind, model.unit, model.joints
        self.step_s, self.method, self.noise_std = model.step_s, model.method, model.noise_std
        self.motions = names
        self.repeat_of = ("",) * len(names)  # parts of a motion do not repeat one another
        self.motion_of: Integers = block
        self.joint_of: Integers = model.joint_of[rows]
        self.time_s: Array = model.time_s[rows]

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n), as the whole motions have them."""
        return self._model.residuals(effects, sizes)[:, self._rows]

    def select(self, motions: Sequence[str]) -> "Blocks":
        """Return the residuals of these blocks alone; only their motions are computed.

        Args:
            motions: Names of blocks.

        Returns:
            A model with fewer blocks.
        """
        wanted = set(motions)
        kept = [k for k, name in enumerate(self.motions) if name in wanted]
        parents = {self.parents[k] for k in kept}
        part = self._model.select([name for name in self._model.motions if name in parents])
        # the rows of the motions that stay keep their order
        stays = np.array([name in parents for name in self._model.motions])[self._model.motion_of]
        place = np.cumsum(stays) - 1
        mine = np.isin(self.motion_of, kept)
        chosen = copy(self)
        chosen.parents = tuple(self.parents[k] for k in kept)
        new = np.searchsorted(kept, self.motion_of[mine])
        chosen._fill(part, place[self._rows[mine]], new, tuple(self.motions[k] for k in kept))
        return chosen

    def explain(self, name: str) -> Array:
        """Return a variable on which a residual may depend, (n,)."""
        return self._model.explain(name)[self._rows]


def cut_into_blocks(model: ResidualModel, residuals: Array) -> Blocks:
    """Cut motions into blocks that are at least as long as the correlation time of the residuals.

    Args:
        model: Residuals of whole motions.
        residuals: Residuals with the base effects fitted, (n,).

    Returns:
        The same residuals, counted by block.
    """
    counts = np.zeros((len(model.motions), len(model.joints)), dtype=np.int64)
    for m, j in np.ndindex(counts.shape):
        rows = (model.motion_of == m) & (model.joint_of == j)
        if rows.any():
            counts[m, j] = int(_independent(model.time_s[rows], residuals[rows]))
    return Blocks(model, counts)


def _independent(time_s: Array, residuals: Array) -> float:
    """Return the number of independent residuals that scatter like these of a motion; at least 1."""
    memory_s = correlation_time_s(time_s, residuals)
    return max(1.0, float(np.ptp(time_s)) / memory_s) if memory_s > 0.0 else 1.0


def _whole_motion_of(model: ResidualModel) -> Integers:
    """Return the motion of each residual, (n,), index; of blocks, the motion that they were cut from."""
    return model.parent_of if isinstance(model, Blocks) else model.motion_of


def count_independent(model: ResidualModel, rows: Integers, residuals: Array) -> int:
    """Count the independent residuals that scatter like those of some rows.

    Args:
        rows: Rows of the model, (n_rows,) indices.
        residuals: Residuals in these rows, (n_rows,), in any unit.

    Returns:
        Number, at least 1 for each joint in each motion.
    """
    cell = _whole_motion_of(model)[rows] * len(model.joints) + model.joint_of[rows]
    parts = [cell == k for k in np.unique(cell)]
    return int(sum(_independent(model.time_s[rows][part], residuals[part]) for part in parts))


def _divide(time_s: Array, count: int) -> Integers:
    """Return the block of each row, (n,), from 0, of so many that are equally long."""
    share = (time_s - time_s.min()) / max(float(np.ptp(time_s)), 1e-12)
    return np.asarray(np.minimum((share * count).astype(np.int64), count - 1))


def correlation_time_s(time_s: Array, residuals: Array) -> float:
    """Estimate the time after which residuals are independent.

    Args:
        time_s: Times, (n,), increasing and about evenly spaced [s].
        residuals: Residuals, (n,).

    Returns:
        tau = T (1 + 2 sum rho) [s]; 0 if they do not vary.
    """
    if residuals.size < 2 or float(np.ptp(residuals)) == 0.0:
        return 0.0
    n = residuals.size
    spectrum = np.fft.rfft(residuals - residuals.mean(), 2 * n)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[:n]
    rho = covariance / covariance[0]
    end = int(np.argmax(rho <= 0)) or n
    period_s = float(np.median(np.diff(time_s)))
    return float(period_s * (1 + 2 * np.sum(rho[1:end])))


def cut_rows(model: ResidualModel, rows: Integers, residuals: Array) -> Integers:
    """Cut whole motions into blocks that are as long as the correlation time of residuals.

    Args:
        rows: Rows of the model, (n_rows,) indices.
        residuals: Residuals in these rows, (n_rows,), in any unit. Of joints, the longest memory counts.

    Returns:
        Block of each row, (n_rows,), from 0.
    """
    time_s, joint = model.time_s[rows], model.joint_of[rows]
    motion = _whole_motion_of(model)[rows]
    block, n_blocks = np.zeros(rows.size, dtype=np.int64), 0
    for m in np.unique(motion):
        here = motion == m
        parts = [here & (joint == j) for j in np.unique(joint[here])]
        count = int(min(_independent(time_s[part], residuals[part]) for part in parts))
        block[here] = n_blocks + _divide(time_s[here], count)
        n_blocks += count
    return block
