"""Accept an effect: it predicts motions that took no part better, in pairs, and harms no other joint.

Rows are indices into the residual model, (n_rows,). `before` and `after` are residuals of two models in these
rows when their motion was left out, over their scales, without a unit, or the losses of these.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers, find_bounded_minimum
from simgap.effects.effect import Effect
from simgap.residuals.noise import cut_rows
from simgap.residuals.residuals import ResidualModel, half_loss_derivatives, pseudo_huber
from simgap.selection.context import Context, FittedModel, simulate
from simgap.selection.fit import STEP, JointFit, gather_residuals
from simgap.selection.sharing import ALL_JOINTS


def improvement_share(context: Context, rows: Integers, before: Array, after: Array) -> float:
    """Return the mean improvement of left-out losses as a share, -1 to 1, of what can be explained."""
    change = float(np.sum(pseudo_huber(before) - pseudo_huber(after)))
    return change / max(explainable_loss(context, rows, before), abs(change), 1e-12)


def explainable_loss(context: Context, rows: Integers, residuals: Array) -> float:
    """Return the loss of residuals over their scales, (n_rows,), beyond that of the noise."""
    return float(np.sum(pseudo_huber(residuals) - context.noise_loss[context.model.joint_of[rows]]))


def robust_loss(context: Context, rows: Integers, residuals: Array) -> float:
    """Return the loss of residuals in the unit of the model, (n_rows,)."""
    return float(np.sum(pseudo_huber(residuals / context.scales[context.model.joint_of[rows]])))


def measure_distance(
    context: Context, model: ResidualModel, rows: Integers, first: Array, other: Array
) -> float:
    """Measure how far apart two models predict motions, in standard deviations d of noise.

    Where predictions differ by a, the right model has a^2 - 2 e a less squares, with noise e. So it has more
    than the wrong one with the probability that a normal number exceeds d/2. What the first leaves is taken
    for the noise.

    Args:
        model: Residuals of the motions.
        rows: Those that are compared.
        first: Residuals with the model that is taken for right, (n,).
        other: Residuals with the other model, (n,).
    """
    scale = context.scales[model.joint_of[rows]]
    noise, apart = first[rows] / scale, (other - first)[rows] / scale
    return float(apart @ apart) / max(_sum_error(model, rows, noise, noise * apart), 1e-300)


def _sum_error(model: ResidualModel, rows: Integers, noise: Array, terms: Array) -> float:
    """Return the standard error of a sum over rows; blocks as long as the memory of noise are independent."""
    return float(np.linalg.norm(np.bincount(cut_rows(model, rows, noise), weights=terms)))


def improvement_z(context: Context, rows: Integers, before: Array, after: Array) -> float:
    """Return the improvement of the losses of left-out motions, over its standard error.

    Where repeats show the noise, the standard error is what that noise can do: an effect counts although it
    acts in few motions, such as a limit. Else it is the scatter from motion to motion, which counts a misfit.
    """
    if knows_noise(context, rows):
        return compare_with_noise(context, rows, before, after)
    return compare_motions(context.model.motion_of[rows], pseudo_huber(before), pseudo_huber(after))


def knows_noise(context: Context, rows: Integers) -> bool:
    """Return whether the noise of all joints is known, or shown by repeated motions."""
    return bool(context.model.noise_std) or bool(
        np.all(context.noise_loss[np.unique(context.model.joint_of[rows])] > 0.0)
    )


def compare_motions(motion: Integers, before: Array, after: Array) -> float:
    """Return the improvement of losses over its scatter between motions; 0 with fewer than two motions.

    The improvement is that of differences or of logarithms of ratios, whichever says more. Motions of very
    different strength scatter in differences; motions that an effect does not touch scatter in ratios.
    """
    _, motion = np.unique(motion, return_inverse=True)
    count = np.bincount(motion)
    old, new = np.bincount(motion, weights=before) / count, np.bincount(motion, weights=after) / count
    ratios = np.log(np.maximum(old, 1e-12) / np.maximum(new, 1e-12))
    return max(_mean_over_error(old - new), _mean_over_error(ratios))


def _mean_over_error(values: Array) -> float:
    """Return the mean of values, (n,), over its standard error; 0 of a mean of 0 or a single value."""
    if len(values) < 2 or not np.any(values):
        return 0.0
    error = float(np.std(values, ddof=1) / np.sqrt(len(values)))
    return float(np.mean(values) / error) if error > 0.0 else float(np.copysign(np.inf, values[0]))


def compare_with_noise(context: Context, rows: Integers, before: Array, after: Array) -> float:
    """Return the mean improvement of a loss over its error by noise; 0 where the models do not differ.

    Where two models differ, noise makes one of them the better by chance: to first order, by the slope of
    the loss times the difference.
    """
    slope, _ = half_loss_derivatives(after)
    error = _sum_error(context.model, rows, after, 2.0 * slope * (before - after))
    return float(np.sum(pseudo_huber(before) - pseudo_huber(after))) / error if error > 0.0 else 0.0


MIN_SHARE: Final = 0.05
"""Least share of the error of left-out motions that an effect has to remove: less is not worth a name. In 20
sealed cases, the candidates nearest to it that were otherwise good had 0.038 and 0.072."""
MIN_Z: Final = 2.0
"""Least improvement of left-out motions over its scatter, beside all other effects, where no repeats show the
noise."""
MAX_EFFECTS: Final = 3
"""Effects at one joint after which a further one has to improve left-out motions by MIN_Z times the scatter
between them: that counts a misfit too. Else many effects describe a residual, and none explains it."""
FIRST_CHANCE: Final = 0.5
"""Largest probability of an effect that is taken before others are known, if none is present: it is rather
there than not. Of two effects that hide each other, one has to be first."""
MAX_WORSE: Final = 0.10
"""Largest share by which an effect may worsen another joint. In 20 sealed cases none came to half of it."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """Effect that was refitted and judged by motions that took no part."""

    effect: Effect
    joints: tuple[int, ...]
    """Joints at which it was judged."""
    fit: JointFit
    left_out: Array
    """Residuals of the fit when their motion was left out, over the scale of their joint, (n_rows,)."""
    at_bound: bool
    """True if a size ends at a bound, or is not plausible beside the others."""
    gain: float
    """Share of what can be explained in left-out motions that it removes."""
    log_chance: float
    """Natural logarithm of the probability of so strong an effect if none is present."""


def choose(context: Context, present: FittedModel, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Choose the best effect of each joint, no two for one, or one at a body if it does more than they do."""
    good = [one for one in candidates if one.gain >= MIN_SHARE and one.log_chance <= np.log(FIRST_CHANCE)]
    good = [one for one in good if not one.at_bound]
    good = [one for one in good if not worsens_another(context, present, one)]
    good = [one for one in good if pays(context, present, one)]
    groups: dict[tuple[int, ...], list[Candidate]] = {}
    for one in good:
        groups.setdefault(one.joints if len(one.joints) == 1 else (ALL_JOINTS,), []).append(one)
    best = {joints: choose_simplest(context, group) for joints, group in groups.items()}
    body = best.pop((ALL_JOINTS,), None)
    local = list(best.values())
    if body is None:
        return local
    removed = sum(_improvement(context, present, one) for one in local)
    # one effect that does as much as several is the simpler explanation
    enough = (1.0 - MIN_SHARE) * removed if len(local) > 1 else removed
    return [body] if _improvement(context, present, body) > enough else local


def pays(context: Context, present: FittedModel, candidate: Candidate) -> bool:
    """Check whether left-out motions pay for one more effect where its joint has MAX_EFFECTS."""
    taken = [context.joint_of(one) for one in present.effects]
    if all(taken.count(joint) < MAX_EFFECTS for joint in candidate.joints):
        return True
    rows = candidate.fit.rows
    before, after = (pseudo_huber(left) for left in (present.left_out[rows], candidate.left_out))
    return compare_motions(context.model.motion_of[rows], before, after) > MIN_Z


def choose_simplest(context: Context, candidates: Sequence[Candidate]) -> Candidate:
    """Choose the effect with the fewest sizes, and then the likeliest, of those that do as well as the best.

    As well means within one standard error of the best, in pairs (Breiman and others 1984). Of effects with
    as many sizes, the likeliest leaves the least loss in all motions. Where the noise is known, the chance of
    an effect counts its sizes.
    """
    if context.model.noise_std:
        return min(candidates, key=lambda one: one.log_chance)
    best = max(candidates, key=lambda one: one.gain)
    rows = best.fit.rows
    alike = [
        one
        for one in candidates
        if one is best or improvement_z(context, rows, one.left_out, best.left_out) <= 1.0
    ]
    return min(
        alike, key=lambda one: (len(one.effect.sizes), robust_loss(context, one.fit.rows, one.fit.residuals))
    )


def _improvement(context: Context, present: FittedModel, candidate: Candidate) -> float:
    """Return the decrease of the mean loss, summed over the joints of a candidate."""
    rows = candidate.fit.rows
    change = pseudo_huber(present.left_out[rows]) - pseudo_huber(candidate.left_out)
    joint = context.model.joint_of[rows]
    return float(np.sum(np.bincount(joint, weights=change) / np.maximum(np.bincount(joint), 1)))


def worsens_another(context: Context, present: FittedModel, candidate: Candidate) -> bool:
    """Check whether an effect lets the mean absolute residual of another joint grow by over MAX_WORSE."""
    model = context.model
    others = [j for j in np.unique(model.joint_of) if model.joints[j] != candidate.effect.place]
    if not others:
        return False
    before = gather_residuals(present.fits, len(model.joint_of))
    after = candidate.fit.residuals
    if candidate.fit.joint != ALL_JOINTS:
        (after,) = simulate(context, [(ALL_JOINTS, candidate.fit.sizes)], "cross-validation")
    return any(
        float(np.mean(np.abs(after[rows]))) > (1.0 + MAX_WORSE) * float(np.mean(np.abs(before[rows])))
        for rows in (model.joint_of == j for j in others)
    )


def cross_validate(context: Context, fits: Sequence[JointFit]) -> Array:
    """Predict residuals without the fold of their motion, over their scales, (n_rows,); 0 without a fit."""
    found = np.zeros(context.model.joint_of.size)
    for fit, left_out in zip(fits, cross_validate_each(context, fits), strict=True):
        found[fit.rows] = left_out
    return found


def cross_validate_each(context: Context, fits: Sequence[JointFit]) -> list[Array]:
    """Predict residuals without the fold of their motion, (n_rows,) over their scales, for each fit.

    Where the noise is known, nothing is left out: the chance of an effect counts what its sizes explain of
    the noise.

    A fit without a fold begins at the optimum of all motions and takes one Newton step, with the
    Jacobian of that optimum. It is then simulated, so that nothing of its loss is linearised.
    """
    joint_of = context.model.joint_of
    if context.model.noise_std:
        return [fit.residuals / context.scales[joint_of[fit.rows]] for fit in fits]
    points = []
    for fit in fits:
        sizes = np.tile(fit.sizes, (len(context.model.motions), 1))
        for fold in context.folds:
            sizes[sorted(fold)] = step_without(context, fit, fold)
        points.append((fit.joint, sizes))
    rows = simulate(context, points, "cross-validation")
    return [row / context.scales[joint_of[fit.rows]] for fit, row in zip(fits, rows, strict=True)]


def step_without(context: Context, fit: JointFit, fold: frozenset[int]) -> Array:
    """Return the sizes of a fit, (n_sizes,), after one step without a fold of motions.

    At the optimum of all motions the gradient is 0, but for sizes that a bound holds: what else derivatives
    say there is their error. So the step follows from the fold. Derivatives are known to about STEP: what
    changes in sizes do to the other motions is not known where it is STEP times less than what each alone
    does to all motions, and the step does not go there.
    """
    model, free = context.model, fit.columns
    sizes = context.union.sizes_at(free)
    low, high = np.array([size.low for size in sizes]), np.array([size.high for size in sizes])
    prior = np.array([size.prior_std for size in sizes]) ** -2.0
    scale = context.scales[model.joint_of[fit.rows]]
    slope, curvature = half_loss_derivatives(fit.residuals / scale)
    a, at = fit.jacobian / scale[:, None], fit.sizes[free]
    unit = np.sqrt(np.maximum(curvature @ a**2 + prior, 1e-300))
    is_other = ~np.isin(model.motion_of[fit.rows], sorted(fold))
    every = a.T @ slope + prior * at
    is_held = ((at <= low) & (every > 0.0)) | ((at >= high) & (every < 0.0))
    gradient = np.where(is_held, every, 0.0) - a[~is_other].T @ slope[~is_other]
    a, curvature = a[is_other], curvature[is_other]
    normal = a.T @ (a * curvature[:, None]) + np.diag(prior)
    found = fit.sizes.copy()
    found[free] = find_bounded_minimum(normal, gradient, at, (low, high), unit, STEP**2)
    return found


def predict_each(context: Context, fits: Sequence[JointFit]) -> Array:
    """Predict the residuals of each motion without it, over their scales, (n_rows,), to first order.

    This is the infinitesimal jackknife (Jaeckel 1972): its step has the curvature of all motions. Where one
    motion alone shows a base parameter, as one without power may, the optimum of the others can be anywhere.
    """
    found = np.zeros(len(context.model.joint_of))
    for fit in fits:
        z, a, normal = linearise(context, fit)
        slope, _ = half_loss_derivatives(z)
        sizes, at = context.union.sizes_at(fit.columns), fit.sizes[fit.columns]
        free = np.flatnonzero([one.low < x < one.high for one, x in zip(sizes, at, strict=True)])
        a, inverse = a[:, free], invert(normal[np.ix_(free, free)])
        motion = context.model.motion_of[fit.rows]
        for own in (motion == k for k in np.unique(motion)):
            z[own] += a[own] @ (inverse @ (a[own].T @ slope[own]))
        found[fit.rows] = z
    return found


def linearise(context: Context, fit: JointFit) -> tuple[Array, Array, Array]:
    """Return residuals over their scales, (n,), derivatives by typical sizes, and curvature with priors."""
    weight, (unit, prior) = 1.0 / context.scales[context.model.joint_of[fit.rows]], size_units(context, fit)
    z, a = fit.residuals * weight, fit.jacobian * weight[:, None] * unit
    _, curvature = half_loss_derivatives(z)
    return z, a, a.T @ (a * curvature[:, None]) + np.diag(prior)


def size_units(context: Context, fit: JointFit) -> tuple[Array, Array]:
    """Return typical sizes, (n_free,), as units of one matrix, and the curvature of priors in these."""
    sizes = context.union.sizes_at(fit.columns)
    unit = np.array([size.typical for size in sizes])
    return unit, (unit / np.array([size.prior_std for size in sizes])) ** 2


def invert(curvature: Array) -> Array:
    """Return the inverse of a curvature, (n, n), and none of directions that nothing tells."""
    return np.asarray(np.linalg.pinv(curvature, rcond=1e-12, hermitian=True))
