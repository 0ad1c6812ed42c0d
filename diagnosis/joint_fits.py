"""Fit the base parameters and the accepted effects of every joint, with all motions and without some."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Integers
from diagnosis.catalogue import base_prior_std
from diagnosis.effects.effect import Effect
from diagnosis.fit import Fit, Hypothesis, Union, fit_hypotheses, measure_coupling, scale_residuals
from diagnosis.residuals import ResidualModel

FOLDS: Final = 4
MAX_COUPLING: Final = 0.02
"""Largest share of a change that may show at another joint when joints share a simulation."""
Report = Callable[[str, int], None]


@dataclass(frozen=True, slots=True)
class Context:
    """Inputs that stay the same while effects are selected."""

    model: ResidualModel
    union: Union
    base: tuple[Effect, ...]
    catalogue: tuple[Effect, ...]
    scales: Array
    """(n_joints,)."""
    noise_loss: Array
    """Mean loss of the noise of each joint, (n_joints,); 0 where it is unknown."""
    base_scores: Array
    """Losses of left-out motions with base parameters alone, (n_joints, n_motions)."""
    share: bool
    """True if hypotheses at different joints share simulations."""
    folds: tuple[frozenset[int], ...]
    seed: int
    report: Report


@dataclass(frozen=True, slots=True)
class Present:
    """A model: its effects, its fit at each joint, its errors on motions that were left out."""

    effects: tuple[Effect, ...]
    """Accepted effects, without base parameters."""
    sizes: Array
    """(n_sizes,)."""
    fits: tuple[Fit, ...]
    """One a joint."""
    scores: Array
    """Mean loss when the motion was left out, (n_joints, n_motions); NaN without data."""

    def at(self, place: str) -> tuple[Effect, ...]:
        """Return the accepted effects at a place."""
        return tuple(effect for effect in self.effects if effect.place == place)


def start_context(
    model: ResidualModel, base: Sequence[Effect], catalogue: Sequence[Effect], seed: int, report: Report
) -> Context:
    """Put base and catalogue into one union and divide the motions into folds.

    Args:
        model: Residuals of the motions that are fitted.
        base: Nuisance effects.
        catalogue: Effects that compete; those that are also in the base are left out.
        seed: Seed of the folds.
        report: Called with a text and the number of simulated candidates.

    Returns:
        The context, with scales of 1 and without shared simulations.
    """
    known = {effect.key for effect in base}
    rivals = tuple(effect for effect in catalogue if effect.key not in known)
    order = np.random.default_rng(seed).permutation(len(model.motions))
    count = min(FOLDS, len(order))
    folds = tuple(frozenset(int(m) for m in order[k::count]) for k in range(count))
    free = [size.prior_std for effect in rivals for size in effect.sizes]
    union = Union((*base, *rivals), (*base_prior_std(base).tolist(), *free))
    ones = np.ones(len(model.joints))
    return Context(
        model, union, tuple(base), rivals, ones, 0.0 * ones, np.empty((0, 0)), False, folds, seed, report
    )


def fit_base(context: Context) -> tuple[Context, Present]:
    """Fit the base parameters of each joint, twice: the scales follow from the first fit.

    Args:
        context: The context.

    Returns:
        The context with its scales, and the base model.
    """
    model, union = context.model, context.union
    zero = np.zeros(len(union.sizes))
    coupling = measure_coupling(model, union, zero, context.base)
    context = replace(context, share=coupling <= MAX_COUPLING)
    (residuals,) = model.residuals([], np.zeros((1, 0)))
    context = replace(context, scales=scale_residuals(model, residuals))
    sizes = zero
    for _ in range(2):
        fits = fit_joints(context, (), sizes)
        sizes = merge_sizes(context, sizes, fits)
        together = np.zeros(len(model.joint_of))
        for fit in fits:
            together[fit.rows] = fit.residuals
        scales = scale_residuals(model, together)
        noise = noise_losses(model, together, scales)
        context = replace(context, scales=scales, noise_loss=noise)
    scores = cross_validate(context, (), sizes)
    return replace(context, base_scores=scores), Present((), sizes, fits, scores)


def free_columns(context: Context, effects: Sequence[Effect], place: str) -> Integers:
    """Return the columns of the base and of these effects that belong to a place.

    Args:
        context: The context.
        effects: Accepted effects.
        place: Name of a joint.

    Returns:
        Indices, (p,).
    """
    return context.union.columns([one for one in (*context.base, *effects) if one.place == place])


def fit_joints(
    context: Context, effects: Sequence[Effect], sizes: Array, left_out: frozenset[int] = frozenset()
) -> tuple[Fit, ...]:
    """Fit base and effects of every joint; sizes at other places stay.

    Args:
        context: The context.
        effects: Accepted effects.
        sizes: Sizes from which the fits start, (n_sizes,), in their own units.
        left_out: Motions that take no part.

    Returns:
        One fit a joint.
    """
    joints = enumerate(context.model.joints)
    free = [Hypothesis(free_columns(context, effects, name), sizes, j, left_out) for j, name in joints]
    return tuple(run(context, free, "fit"))


def run(context: Context, hypotheses: Sequence[Hypothesis], text: str) -> list[Fit]:
    """Fit hypotheses in this context.

    Args:
        context: The context.
        hypotheses: The hypotheses.
        text: Name of the work, for the progress.

    Returns:
        The fits.
    """
    return fit_hypotheses(
        context.model,
        context.union,
        hypotheses,
        context.scales,
        share=context.share,
        report=lambda count: context.report(text, count),
    )


def merge_sizes(context: Context, sizes: Array, fits: Sequence[Fit]) -> Array:
    """Return the sizes with those that each fit has found.

    Args:
        context: The context.
        sizes: (n_sizes,), in their own units.
        fits: The fits.

    Returns:
        (n_sizes,).
    """
    merged = sizes.copy()
    for fit in fits:
        merged[fit.columns] = fit.sizes[fit.columns]
    return merged


def cross_validate(context: Context, effects: Sequence[Effect], sizes: Array) -> Array:
    """Fit every joint without each fold, and measure the error on the fold.

    Args:
        context: The context.
        effects: Accepted effects.
        sizes: Sizes from which the fits start, (n_sizes,), in their own units.

    Returns:
        Mean loss of left-out motions, (n_joints, n_motions).
    """
    names = context.model.joints
    hypotheses = [
        Hypothesis(free_columns(context, effects, name), sizes, j, fold)
        for fold in context.folds
        for j, name in enumerate(names)
    ]
    fits = run(context, hypotheses, "cross-validation")
    scores = np.full((len(names), len(context.model.motions)), np.nan)
    for hypothesis, fit in zip(hypotheses, fits, strict=True):
        left_out = sorted(hypothesis.left_out)
        scores[hypothesis.joint, left_out] = motion_losses(context, fit)[left_out]
    return scores


def motion_losses(context: Context, fit: Fit) -> Array:
    """Return the mean pseudo-Huber loss of each motion.

    It is the loss that the fit minimises: square of small residuals, absolute value of large ones.

    Args:
        context: The context.
        fit: A fit.

    Returns:
        (n_motions,), without a unit: residuals count in the scale of their joint; NaN if it has none.
    """
    model = context.model
    motion = model.motion_of[fit.rows]
    z = fit.residuals / context.scales[model.joint_of[fit.rows]]
    loss = 2.0 * (np.sqrt(1.0 + z * z) - 1.0)
    count = np.bincount(motion, minlength=len(model.motions))
    total = np.bincount(motion, weights=loss, minlength=len(model.motions))
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count)


def noise_residuals(model: ResidualModel, residuals: Array, joint: int) -> Array:
    """Return the residuals that noise alone leaves, from motions that repeat one another.

    The model moves alike in both, so that their difference is that of two noises.

    Args:
        model: The residual model.
        residuals: (n,), in the unit of the model.
        joint: Index of the joint.

    Returns:
        Differences over the square root of 2, (n_noise,); empty without repeats.
    """
    labels = model.repeat_of
    groups = {label: [k for k, one in enumerate(labels) if one == label] for label in labels if label}
    found = [np.empty(0)]
    for members in groups.values():
        rows = [np.flatnonzero((model.motion_of == k) & (model.joint_of == joint)) for k in members]
        for first, second in pairwise(rows):
            if len(first) == len(second):
                found.append((residuals[first] - residuals[second]) / np.sqrt(2.0))
    return np.concatenate(found)


def noise_losses(model: ResidualModel, residuals: Array, scales: Array) -> Array:
    """Return the mean loss that noise alone leaves at each joint.

    Args:
        model: The residual model.
        residuals: (n,), in the unit of the model.
        scales: (n_joints,), in the unit of the model.

    Returns:
        (n_joints,), without a unit; 0 where no motion was repeated.
    """
    found = np.zeros(len(model.joints))
    for joint, scale in enumerate(scales):
        z = noise_residuals(model, residuals, joint) / scale
        found[joint] = float(np.mean(2.0 * (np.sqrt(1.0 + z * z) - 1.0))) if len(z) else 0.0
    return found


def compare(context: Context, joints: Sequence[int], before: Array, after: Array) -> tuple[float, float]:
    """Compare the losses of left-out motions, in pairs.

    Args:
        context: The context.
        joints: Joints to which the rows belong.
        before: Mean losses, (n_rows, n_motions), without a unit.
        after: Mean losses of another model, (n_rows, n_motions), without a unit.

    Returns:
        The mean improvement as a share of what can be explained, and over its standard error.
    """
    seen = ~np.isnan(before).all(axis=0)
    better = np.nanmean(before[:, seen], axis=0) - np.nanmean(after[:, seen], axis=0)
    mean = float(np.mean(better))
    error = float(np.std(better, ddof=1) / np.sqrt(len(better))) if len(better) > 1 else np.inf
    explainable = float(np.nanmean(before) - np.mean(context.noise_loss[list(joints)]))
    return mean / max(explainable, abs(mean), 1e-12), mean / error if error > 0.0 else 0.0


def leave_out(context: Context, present: Present, effect: Effect) -> Present:
    """Refit the model without one of its effects.

    Args:
        context: The context.
        present: The model.
        effect: Effect to leave out.

    Returns:
        The model without it.
    """
    rest = tuple(one for one in present.effects if one.key != effect.key)
    sizes = present.sizes.copy()
    sizes[context.union.columns([effect])] = 0.0
    fits = fit_joints(context, rest, sizes)
    sizes = merge_sizes(context, sizes, fits)
    return Present(rest, sizes, fits, cross_validate(context, rest, sizes))
