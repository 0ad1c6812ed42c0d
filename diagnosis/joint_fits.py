"""Fit the base parameters and the accepted effects of every joint, with all motions and without some."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Integers
from diagnosis.blocks import Blocks, cut_into_blocks
from diagnosis.context import Context, Present, draw_folds, recall, run, simulate
from diagnosis.effects.effect import Effect
from diagnosis.errors import RobotError
from diagnosis.fit import (
    Fit,
    Hypothesis,
    gather_residuals,
    half_loss_derivatives,
    pseudo_huber,
    scale_residuals,
)
from diagnosis.noise import noise_losses, whiten_noise
from diagnosis.reach import share_simulations
from diagnosis.residuals import ResidualModel
from diagnosis.screening import Score
from diagnosis.sharing import ALL_JOINTS

MIN_MOTIONS: Final = 4
"""Least motions of a fit: with fewer, no error of a left-out motion has a standard error worth the name."""


def fit_base(context: Context) -> tuple[Context, Present]:
    """Fit the base parameters of each joint twice: scales and noise follow from the first fit.

    Args:
        context: The context.

    Returns:
        The context with scales and noise, residuals whitened where the noise is known; and the base model.
    """
    raw, union = context.model, context.union
    sizes = np.zeros(len(union.sizes))
    known = {one.place for one in context.base}
    others = [one for one in context.catalogue if one.place in raw.joints and one.place not in known]
    (residuals,) = raw.residuals([], np.zeros((1, 0)))
    context = replace(context, scales=scale_residuals(raw, residuals))
    context = share_simulations(context, sizes, residuals, [*context.base, *others])
    sizes, residuals, _ = fit_all_joints(context, sizes)
    if len(raw.motions) < MIN_MOTIONS:
        raw = cut_into_blocks(raw, residuals)
    n_parts = _count_motions(raw)
    if n_parts < MIN_MOTIONS:
        raise RobotError(
            f"{n_parts} motions or independent parts of them are fitted; a diagnosis needs "
            f"{MIN_MOTIONS} at least, because it judges effects by motions that it leaves out"
        )
    context = replace(context, folds=draw_folds(raw, context.seed))
    model = whiten_noise(raw, residuals)
    (residuals,) = model.residuals(context.base, sizes[None, union.columns(context.base)])
    context = replace(context, model=model, scales=scale_residuals(model, residuals))
    context = share_simulations(context, sizes, residuals, union.effects)
    sizes, residuals, fits = fit_all_joints(context, sizes)
    context = replace(context, noise_loss=noise_losses(model, residuals, context.scales))
    scores = np.array(cross_validate(context, list(enumerate(fits))))
    return replace(context, base_scores=scores), Present((), sizes, fits, scores)


def _count_motions(model: ResidualModel) -> int:
    """Return the number of motions; of blocks, those of the joint that has the fewest."""
    if not isinstance(model, Blocks):
        return len(model.motions)
    counts = np.bincount(model.joint_of_block)
    return int(np.min(counts[counts > 0], initial=len(model.motions)))


def rescale(context: Context, base: Present, present: Present) -> tuple[Context, Present]:
    """Take scales and noise from the residuals of the present model, and refit it.

    A scale from before an effect was found is so wide that the loss is a sum of squares. Blocks are cut anew.

    Args:
        context: The context.
        base: The base model.
        present: The present model.

    Returns:
        The context with new scales, and the model refitted in them.
    """
    model = context.model
    together = gather_residuals(present.fits, len(model.joint_of))
    if isinstance(model, Blocks):  # what was explained is no memory of the noise
        model = cut_into_blocks(model.whole, together)
        context = replace(context, model=model, folds=draw_folds(model, context.seed))
    scales = scale_residuals(model, together)
    context = replace(context, scales=scales, noise_loss=noise_losses(model, together, scales))
    before = np.array(cross_validate(context, list(enumerate(base.fits))))
    effects = [one for one in present.effects if context.joint_of(one) == ALL_JOINTS]
    columns = [context.union.columns([one]) for one in effects]
    bodies = tuple(run(context, [Hypothesis(free, present.sizes) for free in columns], "refit"))
    fits = recall(fit_joints, context, present.effects, merge_sizes(context, present.sizes, bodies))
    scores = np.array(cross_validate(context, list(enumerate(fits))))
    sizes = fits[0].sizes
    found = replace(present, sizes=sizes, fits=fits, scores=scores, bodies=bodies)
    return replace(context, base_scores=before), found


def cut_anew(context: Context, present: Present, shortlist: Sequence[Score]) -> tuple[Context, Present]:
    """Cut the blocks of each joint by the memory of what its best effect leaves.

    Without the effect that memory is the noise's. With it, what it explains is no noise: blocks as long as
    the misfit would be so few that a fit without one of them extrapolates.

    Args:
        context: The context.
        present: The present model.
        shortlist: Scores of the effects that will be judged.

    Returns:
        The context with new blocks and folds, and the model judged by them; the same where motions are whole.
    """
    if not isinstance(context.model, Blocks) or not shortlist:
        return context, present
    left = gather_residuals(present.fits, len(context.model.joint_of))
    for score in sorted(shortlist, key=lambda one: one.gain):  # the best comes last and stays
        for rows, values in score.left:
            left[rows] = values
    model = cut_into_blocks(context.model.whole, left)
    context = replace(context, model=model, folds=draw_folds(model, context.seed))
    scores = np.array(cross_validate(context, list(enumerate(present.fits))))
    return context, replace(present, scores=scores)


def fit_all_joints(context: Context, sizes: Array) -> tuple[Array, Array, tuple[Fit, ...]]:
    """Fit the base parameters of all joints.

    Args:
        context: The context.
        sizes: Sizes from which the fits start, (n_sizes,), in their own units.

    Returns:
        Sizes, (n_sizes,), residuals of all joints, (n,), and the fits.
    """
    fits = recall(fit_joints, context, (), sizes)
    return fits[0].sizes, gather_residuals(fits, len(context.model.joint_of)), fits


def free_columns(context: Context, effects: Sequence[Effect], joint: int) -> Integers:
    """Return the columns of the base and of these effects that are fitted at a joint.

    Args:
        context: The context.
        effects: Accepted effects.
        joint: Index of the joint.

    Returns:
        Indices, (p,).
    """
    return context.union.columns([one for one in (*context.base, *effects) if context.joint_of(one) == joint])


def fit_joints(context: Context, effects: Sequence[Effect], sizes: Array) -> tuple[Fit, ...]:
    """Fit base and effects of every joint; sizes at other places stay.

    The residuals are those with the new sizes of all joints: a joint was fitted with the others as they were.

    Args:
        context: The context.
        effects: Accepted effects.
        sizes: Sizes from which the fits start, (n_sizes,), in their own units.

    Returns:
        One fit a joint, each with the sizes of all.
    """
    joints = range(len(context.model.joints))
    free = [Hypothesis(free_columns(context, effects, j), sizes, j) for j in joints]
    fits = run(context, free, "fit")
    sizes = merge_sizes(context, sizes, fits)
    (rows,) = simulate(context, [(ALL_JOINTS, sizes)], "fit")
    return tuple(replace(fit, sizes=sizes, residuals=rows[fit.rows]) for fit in fits)


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


def cross_validate(context: Context, fits: Sequence[tuple[int, Fit]]) -> list[Array]:
    """Leave out each fold of motions, and measure the loss on the fold.

    A fit without a fold begins at the optimum of all motions and takes one Newton step, with the
    Jacobian of that optimum. It is then simulated, so that nothing of its loss is linearised.

    Args:
        context: The context.
        fits: Index of the joint, or ALL_JOINTS, and the fit.

    Returns:
        Mean losses of left-out motions of each fit, (n_motions,) each, without a unit.
    """
    points = [(joint, step_without(context, fit, fold)) for joint, fit in fits for fold in context.folds]
    rows = simulate(context, points, "cross-validation")
    n = len(context.folds)
    return [left_out_losses(context, fit.rows, rows[k * n : (k + 1) * n]) for k, (_, fit) in enumerate(fits)]


def left_out_losses(context: Context, rows: Integers, residuals: Sequence[Array]) -> Array:
    """Return the mean loss of each motion when it was left out.

    Args:
        context: The context.
        rows: Rows of the residual model, (n_rows,) indices.
        residuals: Residuals in these rows without each fold, (n_rows,) each, in the unit of the model.

    Returns:
        (n_motions,), without a unit; NaN without data.
    """
    scores = np.full(len(context.model.motions), np.nan)
    for fold, moved in zip(context.folds, residuals, strict=True):
        left_out = sorted(fold)
        scores[left_out] = motion_losses(context, rows, moved)[left_out]
    return scores


def step_without(context: Context, fit: Fit, fold: frozenset[int]) -> Array:
    """Return the sizes of a fit after one step without a fold of motions.

    A size at a bound stays there if the step would lead beyond it.

    Args:
        context: The context.
        fit: Fit of all motions.
        fold: Indices of motions that take no part.

    Returns:
        (n_sizes,), in their own units.
    """
    model, free = context.model, fit.columns
    sizes = [context.union.sizes[c] for c in free]
    unit = np.array([size.typical for size in sizes])  # sizes of very different units in one matrix
    low = np.array([size.low for size in sizes]) / unit
    high = np.array([size.high for size in sizes]) / unit
    prior = (unit / np.array([size.prior_std for size in sizes])) ** 2
    weight = np.where(np.isin(model.motion_of[fit.rows], sorted(fold)), 0.0, 1.0)
    weight /= context.scales[model.joint_of[fit.rows]]
    z = fit.residuals * weight
    a = fit.jacobian * weight[:, None] * unit
    slope, curvature = half_loss_derivatives(z)
    at = fit.sizes[free] / unit
    gradient = a.T @ slope + prior * at
    go = ~(((at <= low) & (gradient > 0.0)) | ((at >= high) & (gradient < 0.0)))
    normal = (a.T @ (a * curvature[:, None]) + np.diag(prior))[np.ix_(go, go)]
    at[go] -= np.linalg.pinv(normal, rcond=1e-10, hermitian=True) @ gradient[go]
    found = fit.sizes.copy()
    found[free] = np.clip(at, low, high) * unit
    return found


def motion_losses(context: Context, rows: Integers, residuals: Array) -> Array:
    """Return the mean pseudo-Huber loss of each motion.

    It is the loss that a fit minimises: square of small residuals, absolute value of large ones.

    Args:
        context: The context.
        rows: Rows of the residual model, (n_rows,) indices.
        residuals: Residuals in these rows, (n_rows,), in the unit of the model.

    Returns:
        (n_motions,), without a unit: residuals count in the scale of their joint; NaN if it has none.
    """
    model = context.model
    z = residuals / context.scales[model.joint_of[rows]]
    loss = pseudo_huber(z)
    count = np.bincount(model.motion_of[rows], minlength=len(model.motions))
    total = np.bincount(model.motion_of[rows], weights=loss, minlength=len(model.motions))
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count)


def leave_out(context: Context, present: Present, effects: Sequence[Effect]) -> Present:
    """Refit the model without some of its effects.

    Args:
        context: The context.
        present: The model.
        effects: Effects to leave out.

    Returns:
        The model without them.
    """
    gone = {effect.key for effect in effects}
    rest = tuple(one for one in present.effects if one.key not in gone)
    sizes = present.sizes.copy()
    sizes[context.union.columns(effects)] = 0.0
    fits = recall(fit_joints, context, rest, sizes)
    scores = np.array(cross_validate(context, list(enumerate(fits))))
    gone_columns = set(context.union.columns(effects).tolist())
    bodies = tuple(fit for fit in present.bodies if not gone_columns & set(fit.columns.tolist()))
    return Present(rest, fits[0].sizes, fits, scores, bodies)


def list_layers(context: Context, effects: Sequence[Effect]) -> list[tuple[Effect, ...]]:
    """Divide effects into groups that can be left out together: one effect of each joint, or one at a body.

    Args:
        context: The context.
        effects: Effects.

    Returns:
        Groups in which joints do not repeat.
    """
    bodies = [(one,) for one in effects if context.joint_of(one) == ALL_JOINTS]
    layers: list[list[Effect]] = []
    for effect in effects:
        if context.joint_of(effect) != ALL_JOINTS:
            joint = context.joint_of(effect)
            free = [layer for layer in layers if all(context.joint_of(one) != joint for one in layer)]
            if not free:
                layers.append([])
            (free or layers[-1:])[0].append(effect)
    return [*(tuple(layer) for layer in layers), *bodies]


def joints_of(context: Context, effect: Effect) -> tuple[int, ...]:
    """Return the joints at which an effect is judged.

    Args:
        context: The context.
        effect: The effect.

    Returns:
        Indices of joints.
    """
    joint = context.joint_of(effect)
    return tuple(range(len(context.model.joints))) if joint == ALL_JOINTS else (joint,)
