"""Fit the base parameters and the accepted effects of every joint, with all motions and without some."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Integers
from diagnosis.blocks import Blocks, cut_into_blocks
from diagnosis.context import Context, Present, Score, draw_folds, recall, run, simulate
from diagnosis.effects.effect import Effect
from diagnosis.errors import RobotError
from diagnosis.fit import (
    STEP,
    Fit,
    Hypothesis,
    gather_residuals,
    half_loss_derivatives,
    pseudo_huber,
    scale_residuals,
    select_rows,
)
from diagnosis.noise import noise_losses, whiten_noise
from diagnosis.reach import share_simulations
from diagnosis.residuals import ResidualModel
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
    context = share_simulations(context, sizes, [*context.base, *others])
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
    context = share_simulations(context, sizes, union.effects)
    sizes, residuals, fits = fit_all_joints(context, sizes)
    context = replace(context, noise_loss=noise_losses(model, residuals, context.scales))
    scores = cross_validate(context, fits)
    return replace(context, base_scores=scores), Present((), sizes, fits, scores)


def _count_motions(model: ResidualModel) -> int:
    """Return the number of motions; of blocks, those of the joint that has the fewest."""
    if not isinstance(model, Blocks):
        return len(model.motions)
    counts = np.bincount(model.joint_of_block)
    return int(np.min(counts[counts > 0], initial=len(model.motions)))


def add_effects(
    context: Context, base: Present, present: Present, effects: Sequence[Effect], found: Sequence[Fit]
) -> tuple[Context, Present]:
    """Add effects to the present model, and refit it in the scales of its new residuals.

    A scale from before an effect was found is so wide that the loss is a sum of squares. Blocks are cut anew.

    Args:
        context: The context.
        base: The base model.
        present: The present model.
        effects: Effects to add.
        found: The fit with each of them.

    Returns:
        The context with new scales, and the model refitted in them.
    """
    sizes, model = merge_sizes(context, present.sizes, found), context.model
    (together,) = simulate(context, [(ALL_JOINTS, sizes)], "fit")
    if isinstance(model, Blocks):  # what was explained is no memory of the noise
        model = cut_into_blocks(model.whole, together)
        context = replace(context, model=model, folds=draw_folds(model, context.seed))
    scales = scale_residuals(model, together)
    context = replace(context, scales=scales, noise_loss=noise_losses(model, together, scales))
    context = replace(context, base_scores=cross_validate(context, base.fits))
    more = (*present.effects, *effects)
    fits = recall(fit_joints, context, more, sizes, (*present.fits, *found))
    return context, Present(more, fits[0].sizes, fits, cross_validate(context, fits))


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
    return context, replace(present, scores=cross_validate(context, present.fits))


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
        joint: Index of the joint; ALL_JOINTS: all columns.

    Returns:
        Indices, (p,).
    """
    wanted = [one for one in (*context.base, *effects) if joint in (ALL_JOINTS, context.joint_of(one))]
    return context.union.columns(wanted)


def start_fit(
    context: Context, effects: Sequence[Effect], joint: int, sizes: Array, known: Sequence[Fit] = ()
) -> Hypothesis:
    """Return the hypothesis of base and effects at a joint, with the derivatives that are known.

    Args:
        context: The context.
        effects: Accepted effects.
        joint: Index of the joint, or ALL_JOINTS.
        sizes: Sizes from which the fit starts, (n_sizes,), in their own units.
        known: Fits of the same residual model at sizes that are near.

    Returns:
        The hypothesis.
    """
    columns = free_columns(context, effects, joint)
    slopes = np.full((len(context.model.joint_of), len(columns)), np.nan)
    for fit in known:
        here = np.flatnonzero(np.isin(columns, fit.columns))
        there = [int(np.flatnonzero(fit.columns == columns[k])[0]) for k in here]
        slopes[:, here] = 0.0  # a size at a joint moves no other
        slopes[np.ix_(fit.rows, here)] = fit.jacobian[:, there]
    return Hypothesis(columns, sizes, joint, slopes[select_rows(context.model, joint)])


def fit_joints(
    context: Context, effects: Sequence[Effect], sizes: Array, known: Sequence[Fit] = ()
) -> tuple[Fit, ...]:
    """Fit base and effects of every joint; all joints together if an effect is judged at all of them.

    The residuals are those with the new sizes of all joints: a joint was fitted with the others as they were.

    Args:
        context: The context.
        effects: Accepted effects.
        sizes: Sizes from which the fits start, (n_sizes,), in their own units.
        known: Fits of the same residual model at sizes that are near.

    Returns:
        One fit a joint, or one of all joints, each with the sizes of all.
    """
    joints = [*range(len(context.model.joints))]
    if any(context.joint_of(one) == ALL_JOINTS for one in effects):
        joints = [ALL_JOINTS]
    fits = run(context, [start_fit(context, effects, j, sizes, known) for j in joints], "fit")
    if len(fits) == 1:
        return tuple(fits)
    sizes = merge_sizes(context, sizes, fits)
    (rows,) = simulate(context, [(ALL_JOINTS, sizes)], "fit")
    return tuple(replace(fit, sizes=sizes, residuals=rows[fit.rows]) for fit in fits)


def fits_at(context: Context, present: Present, joint: int) -> tuple[Fit, ...]:
    """Return the fits of the residuals of a joint.

    Args:
        context: The context.
        present: The model.
        joint: Index of the joint; ALL_JOINTS: all fits.

    Returns:
        The fit of the joint; of a fit of all joints, the part at this one.
    """
    if joint == ALL_JOINTS or len(present.fits) == len(context.model.joints):
        return present.fits if joint == ALL_JOINTS else (present.fits[joint],)
    (whole,) = present.fits
    rows = select_rows(context.model, joint)
    moves = np.flatnonzero(whole.jacobian[rows].any(axis=0))
    part = replace(
        whole,
        columns=whole.columns[moves],
        joint=joint,
        residuals=whole.residuals[rows],
        rows=rows,
        jacobian=whole.jacobian[np.ix_(rows, moves)],
    )
    return (part,)


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


def cross_validate(context: Context, fits: Sequence[Fit]) -> Array:
    """Leave out each fold of motions, and measure the loss on the fold.

    Args:
        context: The context.
        fits: Fits of different joints.

    Returns:
        Mean losses of left-out motions of each joint, (n_joints, n_motions), without a unit; NaN without
        data, and for joints without a fit.
    """
    found = np.full((len(context.model.joints), len(context.model.motions)), np.nan)
    for losses in cross_validate_each(context, fits):
        found = np.fmax(found, losses)
    return found


def cross_validate_each(context: Context, fits: Sequence[Fit]) -> list[Array]:
    """Leave out each fold of motions, and measure the loss on the fold, for each fit by itself.

    A fit without a fold begins at the optimum of all motions and takes one Newton step, with the
    Jacobian of that optimum. It is then simulated, so that nothing of its loss is linearised.

    Args:
        context: The context.
        fits: Fits.

    Returns:
        Mean losses of left-out motions for each fit, (n_joints, n_motions) each, without a unit; NaN without
        data.
    """
    points = [(fit.joint, step_without(context, fit, fold)) for fit in fits for fold in context.folds]
    rows = iter(simulate(context, points, "cross-validation"))
    found = []
    for fit in fits:
        losses = np.full((len(context.model.joints), len(context.model.motions)), np.nan)
        for fold in context.folds:
            left_out = sorted(fold)
            losses[:, left_out] = motion_losses(context, fit.rows, next(rows))[:, left_out]
        found.append(losses)
    return found


def step_without(context: Context, fit: Fit, fold: frozenset[int]) -> Array:
    """Return the sizes of a fit after one step without a fold of motions.

    A size at a bound stays there if the step would lead beyond it. Derivatives are known to about STEP: what
    changes in sizes together do to the residual is not known where it is STEP times less than what they do
    alone, and the step does not go there.

    Args:
        context: The context.
        fit: Fit of all motions.
        fold: Indices of motions that take no part.

    Returns:
        (n_sizes,), in their own units.
    """
    model, free = context.model, fit.columns
    low = np.array([context.union.sizes[c].low for c in free])
    high = np.array([context.union.sizes[c].high for c in free])
    prior = np.array([context.union.sizes[c].prior_std for c in free]) ** -2.0
    weight = np.where(np.isin(model.motion_of[fit.rows], sorted(fold)), 0.0, 1.0)
    weight /= context.scales[model.joint_of[fit.rows]]
    a, at = fit.jacobian * weight[:, None], fit.sizes[free]
    slope, curvature = half_loss_derivatives(fit.residuals * weight)
    gradient = a.T @ slope + prior * at
    go = ~(((at <= low) & (gradient > 0.0)) | ((at >= high) & (gradient < 0.0)))
    normal = (a.T @ (a * curvature[:, None]) + np.diag(prior))[np.ix_(go, go)]
    unit = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(unit, unit), rcond=STEP**2, hermitian=True)
    at[go] -= inverse @ (gradient[go] / unit) / unit
    found = fit.sizes.copy()
    found[free] = np.clip(at, low, high)
    return found


def motion_losses(context: Context, rows: Integers, residuals: Array) -> Array:
    """Return the mean pseudo-Huber loss of each joint in each motion.

    It is the loss that a fit minimises: square of small residuals, absolute value of large ones.

    Args:
        context: The context.
        rows: Rows of the residual model, (n_rows,) indices.
        residuals: Residuals in these rows, (n_rows,), in the unit of the model.

    Returns:
        (n_joints, n_motions), without a unit: residuals count in the scale of their joint; NaN without data.
    """
    model = context.model
    joint, shape = model.joint_of[rows], (len(model.joints), len(model.motions))
    cell = joint * shape[1] + model.motion_of[rows]
    loss = pseudo_huber(residuals / context.scales[joint])
    count = np.bincount(cell, minlength=shape[0] * shape[1])
    total = np.bincount(cell, weights=loss, minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count).reshape(shape)


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
    fits = recall(fit_joints, context, rest, sizes, present.fits)
    return Present(rest, fits[0].sizes, fits, cross_validate(context, fits))


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
