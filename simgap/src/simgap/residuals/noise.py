"""Noise from motions that repeat one another: its level and its correlation in time."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.residuals.loss import pseudo_huber
from simgap.residuals.residuals import ResidualModel


class WhitenedResiduals:
    """Residuals from which the part is subtracted that the noise of the sample before predicts.

    The noise is taken for a first-order autoregression. What is left of it is white: a sum over samples
    has the variance that it seems to have.
    """

    def __init__(self, raw: ResidualModel, correlation: Array) -> None:
        """Whiten another residual model.

        Args:
            correlation: Correlation of neighbouring samples of the noise, (n_joints,), as a ratio.
        """
        self.raw, self.correlation = raw, correlation
        self.kind, self.unit, self.joints, self.motions = raw.kind, raw.unit, raw.joints, raw.motions
        self.by_motion, self.step_s, self.method = raw.by_motion, raw.step_s, raw.method
        self.noise_std = raw.noise_std
        self.repeat_of, self.joint_of, self.motion_of = raw.repeat_of, raw.joint_of, raw.motion_of
        self.time_s = raw.time_s
        follows = np.zeros(len(raw.time_s), bool)
        follows[1:] = (np.diff(raw.joint_of) == 0) & (np.diff(raw.motion_of) == 0) & (np.diff(raw.time_s) > 0)
        gap_s = np.diff(raw.time_s, prepend=raw.time_s[:1])
        usual_s = float(np.median(gap_s[follows])) if follows.any() else 1.0
        decay = correlation[raw.joint_of] ** np.where(follows, gap_s / usual_s, 1.0)
        self._decay = np.where(follows, decay, 0.0)
        self._scale = 1.0 / np.sqrt(1.0 - self._decay**2)

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return whitened residuals of candidates.

        Args:
            effects: Union of the effects of all candidates.
            sizes: Sizes of all effects one after the other, (n_candidates, n_sizes), in their own units.

        Returns:
            (n_candidates, n), in the unit of the model.
        """
        return self.whiten(self.raw.residuals(effects, sizes))

    def whiten(self, residuals: Array) -> Array:
        """Subtract what noise predicts from the sample before.

        Args:
            residuals: (n_candidates, n), in the unit of the model.

        Returns:
            (n_candidates, n), in the unit of the model.
        """
        before = np.concatenate([residuals[..., :1], residuals[..., :-1]], axis=-1)
        white: Array = (residuals - self._decay * before) * self._scale
        return white

    def select(self, motions: Sequence[str]) -> ResidualModel:
        """Return the whitened residuals of these motions alone.

        Args:
            motions: Names.

        Returns:
            A model with fewer motions.
        """
        return WhitenedResiduals(self.raw.select(motions), self.correlation)

    def explain(self, name: str) -> Array:
        """Return a variable at the measured motion.

        Args:
            name: Name of the variable.

        Returns:
            Its value at each residual, (n,).
        """
        return self.raw.explain(name)


def repeat_pairs(model: ResidualModel, joint: int) -> list[tuple[Integers, Integers]]:
    """List the rows of a joint in motions that repeat one another.

    Args:
        joint: Index of the joint.

    Returns:
        Rows of two motions at the same times, (n_rows,) each.
    """
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
    """Return the residuals that noise alone leaves.

    The model moves alike in motions that repeat one another, so that their difference is that of two noises.

    Args:
        residuals: (n,), in the unit of the model.
        joint: Index of the joint.

    Returns:
        Differences over the square root of 2, (n_noise,); empty without repeats.
    """
    pairs = repeat_pairs(model, joint)
    return np.concatenate([np.empty(0), *((residuals[a] - residuals[b]) / np.sqrt(2.0) for a, b in pairs)])


def noise_losses(model: ResidualModel, residuals: Array, scales: Array) -> Array:
    """Return the mean pseudo-Huber loss that noise alone leaves at each joint.

    Known noise has a loss of squares, as `scale_residuals` chooses.
    Otherwise the motions that repeat one another show the loss.

    Args:
        residuals: (n,), in the unit of the model.
        scales: (n_joints,), in the unit of the model.

    Returns:
        (n_joints,), without a unit; 0 where no motion was repeated.
    """
    if model.noise_std:
        return np.asarray((model.noise_std / scales) ** 2)
    found = np.zeros(len(model.joints))
    for joint, scale in enumerate(scales):
        z = noise_residuals(model, residuals, joint) / scale
        found[joint] = float(np.mean(pseudo_huber(z))) if len(z) else 0.0
    return found


def whiten_noise(model: ResidualModel, residuals: Array) -> ResidualModel:
    """Whiten the residuals of a model by the noise that its repeated motions show.

    Args:
        residuals: Residuals of its base model, (n,), in the unit of the model.

    Returns:
        The whitened model; the model itself without repeats.
    """
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
