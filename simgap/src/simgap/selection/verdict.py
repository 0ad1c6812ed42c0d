"""Say how sure each finding is: intervals of its sizes, and what cannot be excluded in its place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain
from typing import Final

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from simgap.arrays import Array, Integers, orthonormal
from simgap.effects.effect import Effect
from simgap.residuals.noise import cut_rows
from simgap.residuals.residuals import ResidualModel, half_loss_derivatives, root_weight
from simgap.selection.acceptance import (
    improvement_share,
    improvement_z,
    invert,
    linearise,
    measure_distance,
    predict_each,
    size_units,
)
from simgap.selection.chance import alternative_p
from simgap.selection.context import (
    Context,
    FittedModel,
    Score,
    Selection,
    resume_step,
    simulate_models,
    start_fitting,
)
from simgap.selection.elimination import list_together
from simgap.selection.fit import Hypothesis, JointFit, gather_residuals
from simgap.selection.joint_fits import fits_at, joints_of
from simgap.selection.selection import (
    explain_loss,
    is_at_bound,
    start_refit,
)
from simgap.selection.sharing import ALL_JOINTS

EXCLUDED: Final = 0.05
"""Probability below which an alternative is excluded."""
COVERED: Final = 0.90
"""Probability that an interval holds the size, if the model is right."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """Effect that may be the cause instead of a finding."""

    effect: Effect
    sizes: Array
    """(n_sizes,) of the union."""
    p: float
    """Probability that the finding fits so much better, or more, if this is the cause; where that is at most
    EXCLUDED, that of so much better predictions of left-out motions if larger; a half if it came back."""
    fits_as_well: bool
    """True if the first probability exceeds EXCLUDED."""
    columns: Integers
    """Columns of the union that were fitted with it, (n_free,)."""
    intervals: Array
    """Their `size_intervals`, (n_free, 2)."""


@dataclass(frozen=True, slots=True)
class ConfidenceSet:
    """A finding with the effects that cannot be excluded in its place, itself first."""

    effect: Effect
    alternatives: tuple[Alternative, ...]
    share: float
    """Share of what can be explained in left-out motions that the finding removes."""
    excluded: tuple[Alternative, ...] = ()
    """Effects that were fitted in its place and are excluded, the one that explains most first."""


def find_confidence_sets(selection: Selection, known: Sequence[ConfidenceSet] = ()) -> list[ConfidenceSet]:
    """Refit competitors in place of each finding, and exclude those that fit too badly to be the cause.

    Args:
        known: Sets of some findings, which stay as they are.
    """
    found = {one.effect.key: one for one in known}
    for layer, without in selection.left_out:
        wanted = [effect for effect in layer if effect.key not in found]
        if wanted:
            sets = resume_step(find_layer_sets, selection.context, selection, without, layer, wanted)
            found |= {one.effect.key: one for one in sets}
    return [found[effect.key] for effect in selection.chosen.effects]


def keep_sets(selection: Selection, sets: Sequence[ConfidenceSet], effect: Effect) -> list[ConfidenceSet]:
    """Keep the sets of findings that one which goes does not touch, and that have no rival at all joints."""
    context = selection.context
    near = list_together(context, effect, selection.chosen.effects)
    gone = context.union.columns([effect])

    def leave_out(one: Alternative) -> Alternative:
        sizes = one.sizes.copy()
        sizes[gone] = 0.0
        return replace(one, sizes=sizes)

    return [
        replace(
            one,
            alternatives=tuple(map(leave_out, one.alternatives)),
            excluded=tuple(map(leave_out, one.excluded)),
        )
        for one in sets
        if one.effect not in near
        and all(context.joint_of(other.effect) != ALL_JOINTS for other in (*one.alternatives, *one.excluded))
    ]


def find_layer_sets(
    context: Context,
    selection: Selection,
    without: FittedModel,
    layer: Sequence[Effect],
    wanted: Sequence[Effect],
) -> list[ConfidenceSet]:
    """Refit the competitors of wanted findings of a layer that is left out; findings are fitted already.

    Those that soon explain less than RIVAL_SHARE of a finding of the layer are excluded.
    """
    known = {effect.key for effect in (*layer, *without.effects)}
    every = [one for effect in wanted for one in selection.competitors[effect.key]]
    scores = [*{one.effect.key: one for one in every if one.effect.key not in known}.values()]
    fitting = start_fitting(
        context, (start_competitor(context, without, layer, score) for score in scores), "refit"
    )
    residuals = gather_residuals(without.fits, context.model.joint_of.size)
    findings = [fits_at(context, selection.chosen, context.joint_of(effect))[0] for effect in layer]
    needed = min(explain_loss(context, fit, residuals) for fit in findings)

    def list_hopeful(share: float) -> list[int]:
        explained = [explain_loss(context, one, residuals) for one in fitting.descents]
        return [k for k, one in enumerate(explained) if one > share * needed]

    fitting.compete(list_hopeful, findings)
    effects = [scores[k].effect for k in fitting.places]
    rivals = list(zip(effects, fitting.finish(), strict=True))
    rivals.sort(key=lambda one: -explain_loss(context, one[1], residuals))
    return [
        find_set(context, selection, without, effect, fit, rivals)
        for effect, fit in zip(layer, findings, strict=True)
        if effect in wanted
    ]


def find_set(
    context: Context,
    selection: Selection,
    without: FittedModel,
    effect: Effect,
    own: JointFit,
    rivals: Sequence[tuple[Effect, JointFit]],
) -> ConfidenceSet:
    """Exclude effects that fit too badly to be the cause of a finding, whose fit is `own`, and predict worse.

    A test of fits also excludes the cause where the model lacks something else. Left-out motions then do not
    tell the two apart (Vuong 1989). Rivals were fitted in place of the findings that are left out; the one
    that explains most comes first.
    """
    joints = list(joints_of(context, effect))
    rows = np.flatnonzero(np.isin(context.model.joint_of, joints))
    share = improvement_share(context, rows, without.left_out[rows], selection.chosen.left_out[rows])
    others = [
        (one, fit)
        for one, fit in rivals
        if set(joints) & set(joints_of(context, one)) and not is_at_bound(context, without.effects, one, fit)
    ]
    chances = _cause_p(context, without, joints, [own, *(fit for _, fit in others)])
    first, *rest = (
        Alternative(one, fit.sizes, p, p > EXCLUDED, fit.columns, size_intervals(context, fit))
        for (one, fit), p in zip(((effect, own), *others), (1.0, *chances), strict=True)
    )
    unfit = [k for k, one in enumerate(rest) if not one.fits_as_well]
    fits = [others[k][1] for k in unfit]
    for k, p in zip(unfit, prediction_chances(context, selection, without, rows, fits), strict=True):
        rest[k] = replace(rest[k], p=max(rest[k].p, p))
    members = sorted((one for one in rest if one.p > EXCLUDED), key=lambda one: -one.p)
    excluded = tuple(one for one in rest if one.p <= EXCLUDED)
    return ConfidenceSet(effect, (first, *members), share, excluded)


def prediction_chances(
    context: Context, selection: Selection, without: FittedModel, rows: Integers, fits: Sequence[JointFit]
) -> list[float]:
    """Return the probability, for the fit of each rival, that a finding predicts so much better by chance.

    It is 0 where no motion is left out.

    Args:
        rows: Residuals of the joints of the finding, (n,) indices.
    """
    if context.model.noise_std or not fits:
        return [0.0] * len(fits)
    mine, before = (predict_each(context, one.fits) for one in (selection.chosen, without))
    chances = []
    for fit in fits:
        theirs = before.copy()
        theirs[fit.rows] = predict_each(context, [fit])[fit.rows]
        chances.append(float(norm.sf(improvement_z(context, rows, theirs[rows], mine[rows]))))
    return chances


def start_competitor(
    context: Context, without: FittedModel, layer: Sequence[Effect], score: Score
) -> Hypothesis:
    """Return the hypothesis of an effect in place of findings, with the sizes at which it was refitted.

    Beside it, the other sizes of its joint are those without the findings, or those of that refit.
    """
    union = context.union
    is_mine = context.sharing.list_fitted(context.joint_of(score.effect))
    own, gone = union.columns([score.effect]), union.columns(layer)
    starts = [without.sizes.copy(), np.where(is_mine & (score.start != 0.0), score.start, without.sizes)]
    for start in starts:
        start[gone], start[own] = 0.0, score.start[own]
    first = start_refit(context, without, replace(score, start=starts[0]))
    return replace(first, other_starts=(starts[1],))


def readmit_rivals(context: Context, found: ConfidenceSet, held_out: ResidualModel) -> ConfidenceSet:
    """Take effects back that were excluded, but predict motions that took no part as well as the set.

    A test of fits excludes the cause where the model lacks something else. It then predicts no worse than the
    best of the set, and not by chance.
    """
    rows = np.flatnonzero(np.isin(held_out.joint_of, joints_of(context, found.effect)))
    if not found.excluded or not rows.size:
        return found
    n = len(found.alternatives)
    sizes = [one.sizes for one in (*found.alternatives, *found.excluded)]
    residuals = simulate_models(context, held_out, sizes)
    errors = np.mean(np.abs(residuals[:, rows]), axis=1)
    best = int(np.argmin(errors[:n]))
    is_back = [
        error <= errors[best]
        and norm.sf(0.5 * measure_distance(context, held_out, rows, one, residuals[best])) <= EXCLUDED
        for error, one in zip(errors[n:], residuals[n:], strict=True)
    ]
    back, excluded = (
        tuple(one for one, flag in zip(found.excluded, is_back, strict=True) if flag == wanted)
        for wanted in (True, False)
    )
    back = tuple(replace(one, p=0.5) for one in back)  # chance has such an error as often as a larger one
    return replace(found, alternatives=(*found.alternatives, *back), excluded=excluded)


def _cause_p(
    context: Context, without: FittedModel, joints: Sequence[int], tested: Sequence[JointFit]
) -> list[float]:
    """Return for each alternative the probability that a finding fits so much better if it is the cause.

    Only the joints of the finding count: findings that were left out at others are no part of the comparison.
    The first of the fits is that of the finding.
    """
    model = context.model
    rows = np.flatnonzero(np.isin(model.joint_of, joints))

    def join_at_joints(fit: JointFit) -> tuple[Array, Array]:
        rest = [] if fit.joint == ALL_JOINTS else [j for j in joints if j != fit.joint]
        together = [fit, *(one for j in rest for one in fits_at(context, without, j))]
        residuals, jacobian = _join(together, len(model.joint_of))
        return residuals[rows], jacobian[rows]

    scale = context.scales[model.joint_of[rows]]
    joined = (join_at_joints(fit) for fit in tested)  # the derivatives of all would fill the memory
    own = next(joined)
    weight = root_weight(own[0] / scale) / scale
    models = [(r * weight, orthonormal(j * weight[:, None])) for r, j in chain([own], joined)]
    # what the finding explains is no noise, and would make blocks so long that nothing is excluded
    cluster = cut_rows(model, rows, models[0][0])
    std = model.noise_std / float(np.max(context.scales[joints]))
    return [
        alternative_p(models[k], [*models[:k], *models[k + 1 :]], cluster, context.seed, std)
        for k in range(1, len(models))
    ]


def _join(fits: Sequence[JointFit], n_rows: int) -> tuple[Array, Array]:
    """Return residuals, (n_rows,), and derivatives, (n_rows, n_free), of several fits together."""
    jacobian, first = np.zeros((n_rows, sum(len(fit.columns) for fit in fits))), 0
    for fit in fits:
        last = first + len(fit.columns)
        jacobian[fit.rows, first:last] = fit.jacobian
        first = last
    return gather_residuals(fits, n_rows), jacobian


def size_intervals(context: Context, fit: JointFit) -> Array:
    """Return intervals of free sizes, (n_free, 2) in their units, that hold for autocorrelated residuals.

    The covariance is the sandwich with motions as clusters: residuals of one motion may depend on one another
    in any way (Liang and Zeger 1986). The quantile is that of Student's t with one degree less than motions.
    Where the noise is known, it is that of least squares, and the quantile is normal.
    """
    _, half = _estimate(context, fit)
    at = fit.sizes[fit.columns]
    return np.column_stack([at - half, at + half])


def find_pushed(context: Context, fit: JointFit) -> Integers:
    """Return the columns of base parameters whose bound the residuals contradict, (n,).

    Such a parameter ends at a bound, and without bounds its interval would lie beyond. A parameter that is
    really 0 ends at its bound too, but then the interval holds the bound.
    """
    at, (step, half) = fit.sizes[fit.columns], _estimate(context, fit)
    sizes = context.union.sizes_at(fit.columns)
    low, high = np.array([(size.low, size.high) for size in sizes]).reshape(-1, 2).T
    is_pushed = ((at <= low) & (at + step + half < low)) | ((at >= high) & (at + step - half > high))
    pushed: Integers = fit.columns[is_pushed & np.isin(fit.columns, context.union.columns(context.base))]
    return pushed


def _estimate(context: Context, fit: JointFit) -> tuple[Array, Array]:
    """Return the step to the optimum without bounds, and half of each interval, (n_free,) in their units."""
    (unit, prior), (z, a, normal) = size_units(context, fit), linearise(context, fit)
    slope, _ = half_loss_derivatives(z)
    inverse = invert(normal)
    n = len(np.unique(context.model.motion_of[fit.rows]))
    quantile = student.ppf(0.5 + 0.5 * COVERED, max(n - 1, 1))
    if context.model.noise_std:
        quantile = norm.ppf(0.5 + 0.5 * COVERED)
        covariance = inverse * (context.model.noise_std / float(np.max(context.scales))) ** 2
    else:
        covariance = inverse @ (_scatter_of_motions(context, fit, a, slope) + np.diag(prior)) @ inverse
    half = quantile * unit * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    step = -unit * (inverse @ (a.T @ slope + prior * fit.sizes[fit.columns] / unit))
    return step, half


def _scatter_of_motions(context: Context, fit: JointFit, a: Array, slope: Array) -> Array:
    """Return the covariance of the gradient from its sums over motions, (n_free, n_free)."""
    motion = context.model.motion_of[fit.rows]
    sums = np.array([a[motion == k].T @ slope[motion == k] for k in np.unique(motion)])
    n = len(sums)
    return np.asarray(sums.T @ sums * (n / max(n - 1, 1)))


def unexplained_dependence(residual: Array, variable: Array, group: Integers, n_bins: int = 10) -> float:
    """Measure the share of a residual that follows a variable.

    Means of the residual in bins of the variable predict each group from the others, and are held against the
    mean of the others. A bin that no other group reaches has that mean. The share is that of the sum of
    squares about the mean, at most 1; it is not positive if the variable predicts nothing.

    Args:
        residual: Residuals, (n,), in any unit.
        variable: Variable at each of them, (n,), in any unit.
        group: Motion, or block of a motion, of each of them, (n,), index from 0.
        n_bins: Bins with equal counts.
    """
    if len(residual) < n_bins or np.ptp(variable) == 0.0 or np.ptp(group) == 0:
        return 0.0
    edges = np.unique(np.quantile(variable, np.linspace(0.0, 1.0, n_bins + 1)[1:-1]))
    place, shape = np.searchsorted(edges, variable), (int(group.max()) + 1, len(edges) + 1)
    cell = group * shape[1] + place
    sums, counts = (
        np.bincount(cell, weights=weights, minlength=shape[0] * shape[1]).reshape(shape)
        for weights in (residual, np.ones_like(residual))
    )
    other_sums, other_counts = sums.sum(axis=0) - sums, counts.sum(axis=0) - counts
    mean = other_sums.sum(axis=1, keepdims=True) / np.maximum(other_counts.sum(axis=1, keepdims=True), 1.0)
    predicted = np.where(other_counts > 0.0, other_sums / np.maximum(other_counts, 1.0), mean)
    total = float(np.sum((residual - mean[group, 0]) ** 2))
    return 1.0 - float(np.sum((residual - predicted[group, place]) ** 2)) / total if total > 0.0 else 0.0


def list_members(found: ConfidenceSet) -> tuple[tuple[str, ...], tuple[StrEnum, ...], tuple[str, ...]]:
    """List places, families and effects that cannot be excluded, the best first, without repetition."""
    effects = [one.effect for one in found.alternatives]
    places, families = (
        dict.fromkeys(one.place for one in effects),
        dict.fromkeys(one.family for one in effects),
    )
    return tuple(places), tuple(families), tuple(dict.fromkeys(one.key for one in effects))
