"""Noise from motions that repeat one another, and blocks that count as motions where these are few.

Residuals are arrays (n,) in the unit of their model, or those of rows, which are indices, (n_rows,). Scales
are (n_joints,) in the same unit.
"""

from collections.abc import Sequence
from copy import copy
from itertools import pairwise

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.residuals.residuals import ResidualModel, WrappedResiduals, pseudo_huber, refer_to


class WhitenedResiduals(WrappedResiduals):
    """Residuals from which the part is subtracted that the noise of the sample before predicts.

    The noise is taken for a first-order autoregression. What is left of it is white: a sum over samples
    has the variance that it seems to have.
    """

    def __init__(self, raw: ResidualModel, correlation: Array) -> None:
        """Whiten by the correlation of neighbouring samples of the noise, (n_joints,), as a ratio."""
        super().__init__(raw)
        self.correlation = correlation
        follows = np.zeros(len(raw.time_s), bool)
        follows[1:] = (np.diff(raw.joint_of) == 0) & (np.diff(raw.motion_of) == 0) & (np.diff(raw.time_s) > 0)
        gap_s = np.diff(raw.time_s, prepend=raw.time_s[:1])
        usual_s = float(np.median(gap_s[follows])) if follows.any() else 1.0
        decay = correlation[raw.joint_of] ** np.where(follows, gap_s / usual_s, 1.0)
        self._decay = np.where(follows, decay, 0.0)
        self._scale = 1.0 / np.sqrt(1.0 - self._decay**2)

    def around(self, effects: Sequence[Effect], sizes: Array) -> "WhitenedResiduals":
        """Return the residuals with another reference: effects with their sizes, (1, total sizes)."""
        return WhitenedResiduals(refer_to(self.raw, effects, sizes[0]), self.correlation)

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return whitened residuals of candidates, (n_candidates, n), in the unit of the model."""
        return self.whiten(self.raw.residuals(effects, sizes))

    def whiten(self, residuals: Array) -> Array:
        """Subtract what noise predicts from the sample before, (n_candidates, n)."""
        before = np.concatenate([residuals[..., :1], residuals[..., :-1]], axis=-1)
        return np.asarray((residuals - self._decay * before) * self._scale)

    def select(self, motions: Sequence[str]) -> ResidualModel:
        """Return the whitened residuals of these motions alone."""
        return WhitenedResiduals(self.raw.select(motions), self.correlation)


def repeat_pairs(model: ResidualModel, joint: int) -> list[tuple[Integers, Integers]]:
    """List the rows, (n_rows,) each, of a joint in two motions that repeat one another at the same times."""
    groups: dict[str, list[Integers]] = {}
    for k, label in enumerate(model.repeat_of):
        if label:
            rows = np.flatnonzero((model.motion_of == k) & (model.joint_of == joint))
            groups.setdefault(label, []).append(rows)
    pairs = [_pair_times(model.time_s, *pair) for group in groups.values() for pair in pairwise(group)]
    return [(a, b) for a, b in pairs if len(a) > 2]


def _pair_times(time_s: Array, one: Integers, other: Integers) -> tuple[Integers, Integers]:
    """Return the rows of two motions that are at the same times; some samples may be missing in one."""
    if min(len(one), len(other)) < 2:
        return one[:0], other[:0]
    wanted_s, there_s = time_s[one], time_s[other]
    after = np.clip(np.searchsorted(there_s, wanted_s), 1, len(other) - 1)
    nearest = after - (wanted_s - there_s[after - 1] < there_s[after] - wanted_s)
    is_same = np.abs(there_s[nearest] - wanted_s) < 0.5 * float(np.median(np.diff(wanted_s)))
    return one[is_same], other[nearest[is_same]]


def noise_residuals(model: ResidualModel, residuals: Array, joint: int) -> Array:
    """Return the residuals that noise alone leaves, (n_noise,); empty without repeats.

    The model moves alike in motions that repeat one another, so that their difference is that of two noises.
    """
    pairs = repeat_pairs(model, joint)
    return np.concatenate([np.empty(0), *((residuals[a] - residuals[b]) / np.sqrt(2.0) for a, b in pairs)])


def noise_losses(model: ResidualModel, residuals: Array, scales: Array) -> Array:
    """Return the mean pseudo-Huber loss of noise alone at each joint, (n_joints,); 0 without repeats.

    Known noise has a loss of squares, as `scale_residuals` chooses.
    Otherwise the motions that repeat one another show the loss.
    """
    if model.noise_std:
        return np.asarray((model.noise_std / scales) ** 2)
    found = np.zeros(len(model.joints))
    for joint, scale in enumerate(scales):
        z = noise_residuals(model, residuals, joint) / scale
        found[joint] = float(np.mean(pseudo_huber(z))) if len(z) else 0.0
    return found


def whiten_noise(model: ResidualModel, residuals: Array) -> ResidualModel:
    """Whiten a model by the noise that its repeated motions show; the model itself without repeats."""
    correlation = np.zeros(len(model.joints))
    for joint in range(len(model.joints)):
        product, energy = 0.0, 0.0
        for a, b in repeat_pairs(model, joint):
            noise = residuals[a] - residuals[b]
            noise = noise - noise.mean()
            product += float(noise[1:] @ noise[:-1])
            energy += float(noise @ noise)
        correlation[joint] = np.clip(product / energy, 0.0, 0.95) if energy > 0.0 else 0.0
    return WhitenedResiduals(model, correlation) if correlation.any() else model


class Blocks:
    """A residual model whose units of inference are blocks; see `ResidualModel`.

    A block is named after its motion, its joint and its place: "A:shoulder:1", "A:shoulder:2".
    """

    by_motion = False

    def __init__(self, model: ResidualModel, counts: Integers) -> None:
        """Divide motions and joints into so many equal blocks, (n_motions, n_joints); 0 without residuals."""
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
        self.kind, self.units, self.joints = model.kind, model.units, model.joints
        self.step_s, self.method, self.noise_std = model.step_s, model.method, model.noise_std
        self.motions = names
        self.repeat_of = ("",) * len(names)  # parts of a motion do not repeat one another
        self.motion_of: Integers = block
        self.joint_of: Integers = model.joint_of[rows]
        self.time_s: Array = model.time_s[rows]

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Compute the residuals of candidates as the whole motions have them, (n_candidates, n)."""
        return self._model.residuals(effects, sizes)[:, self._rows]

    def select(self, motions: Sequence[str]) -> "Blocks":
        """Return the residuals of these blocks alone; only their motions are computed."""
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
    """Cut motions into blocks that are at least as long as the correlation time of the residuals."""
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
    """Count the independent residuals that scatter like those of some rows, at least 1 a joint and motion."""
    cell = _whole_motion_of(model)[rows] * len(model.joints) + model.joint_of[rows]
    parts = [cell == k for k in np.unique(cell)]
    return int(sum(_independent(model.time_s[rows][part], residuals[part]) for part in parts))


def _divide(time_s: Array, count: int) -> Integers:
    """Return the block of each row, (n,), from 0, of so many that are equally long."""
    share = (time_s - time_s.min()) / max(float(np.ptp(time_s)), 1e-12)
    return np.asarray(np.minimum((share * count).astype(np.int64), count - 1))


def correlation_time_s(time_s: Array, residuals: Array) -> float:
    """Estimate the time after which residuals are independent, T (1 + 2 sum rho) [s]; 0 if all are alike."""
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
    """Cut whole motions into blocks, (n_rows,) from 0, as long as the longest memory of a joint in them."""
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
