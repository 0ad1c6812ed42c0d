"""Say how sure each finding is: intervals of its sizes, and what cannot be excluded in its place."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import t as student

from diagnosis.acceptance import Candidate
from diagnosis.arrays import Array, Integers
from diagnosis.comparison import one_sided_p
from diagnosis.context import Context, Present, Score, Selection, recall, simulate
from diagnosis.effects.effect import Effect, Family
from diagnosis.fit import Fit, half_loss_derivatives
from diagnosis.selection import judge
from diagnosis.sharing import ALL_JOINTS

EXCLUDED: Final = 0.05
"""Probability below which an alternative is excluded."""
COVERED: Final = 0.90
"""Probability that an interval holds the size, if the model is right."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """Effect that does as well as a finding on motions that took no part."""

    effect: Effect
    sizes: Array
    """(n_sizes,) of the union."""
    p: float
    """Probability of its disadvantage, or a larger one, if it were as good."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """A finding with the effects that cannot be excluded in its place, itself first."""

    effect: Effect
    alternatives: tuple[Alternative, ...]
    share: float
    """Share of what can be explained in left-out motions that the finding removes."""


def doubt_findings(selection: Selection) -> list[Doubt]:
    """Refit alternatives in the place of each finding, and exclude those that predict worse.

    The test is a paired one-sided t test of the losses of left-out motions.

    Args:
        selection: The selected effects.

    Returns:
        One doubt a finding, in their order.
    """
    found: dict[str, Doubt] = {}
    for layer, without in selection.left_out:
        doubts = recall(doubt_layer, selection.context, selection, without, layer)
        found |= {doubt.effect.key: doubt for doubt in doubts}
    return [found[effect.key] for effect in selection.chosen.effects]


def doubt_layer(
    context: Context, selection: Selection, without: Present, layer: Sequence[Effect]
) -> list[Doubt]:
    """Refit alternatives in the place of findings that are left out together.

    Args:
        context: The context.
        selection: The selected effects.
        without: The model without these.
        layer: The findings that are left out.

    Returns:
        One doubt a finding of the layer.
    """
    # each begins at its own sizes, without the others that are left out
    starts = {effect.key: (effect, selection.chosen.sizes) for effect in layer}
    present = {effect.key for effect in without.effects}
    for effect in layer:
        for one in selection.competitors[effect.key]:
            if one.effect.key not in present:
                starts.setdefault(one.effect.key, (one.effect, one.start))
    scores = []
    for effect, sizes in starts.values():
        start, own = without.sizes.copy(), context.union.columns([effect])
        start[own] = sizes[own]
        scores.append(Score(effect, start, 0.0))
    candidates = judge(context, without, scores)
    return [doubt_finding(context, without, effect, candidates) for effect in layer]


def doubt_finding(
    context: Context, without: Present, effect: Effect, candidates: Sequence[Candidate]
) -> Doubt:
    """Compare a finding with the alternatives at its joint and at bodies.

    Args:
        context: The context.
        without: The model without the finding.
        effect: The finding.
        candidates: Refitted effects, among them the finding.

    Returns:
        The finding with the alternatives that cannot be excluded.
    """
    finding = next(one for one in candidates if one.effect.key == effect.key)
    own = _errors(without, finding, finding.joints)
    members = [Alternative(effect, finding.fit.sizes, 1.0)]
    for one in candidates:
        if one.effect.key == effect.key or not set(one.joints) & set(finding.joints) or one.at_bound:
            continue
        worse = _errors(without, one, finding.joints) - own
        p = one_sided_p(worse[~np.isnan(worse)])
        if p > EXCLUDED:
            members.append(Alternative(one.effect, one.fit.sizes, p))
    ranked = (members[0], *sorted(members[1:], key=lambda one: -one.p))
    return Doubt(effect, ranked, finding.gain)


def _errors(without: Present, candidate: Candidate, joints: Sequence[int]) -> Array:
    """Return the loss of each motion, summed over all joints, (n_motions,).

    A candidate gets no credit for joints other than these: findings that were left out there are no part of
    the comparison.
    """
    scores, judged = without.scores.copy(), list(candidate.joints)
    elsewhere = ~np.isin(judged, joints)
    scores[judged] = np.where(elsewhere[:, None], np.fmax(candidate.scores, scores[judged]), candidate.scores)
    total: Array = np.nansum(scores, axis=0)
    return np.where(np.isnan(scores).all(axis=0), np.nan, total)


def size_intervals(context: Context, fit: Fit) -> Array:
    """Return intervals of the free sizes of a fit that hold for residuals with autocorrelation.

    The covariance is the sandwich with motions as clusters: residuals of one motion may depend on one another
    in any way (Liang and Zeger 1986). The quantile is that of Student's t with one degree less than motions.

    Args:
        context: The context.
        fit: A fit of one joint or of all.

    Returns:
        Low and high ends, (n_free, 2), in the units of the sizes.
    """
    weight = 1.0 / context.scales[context.model.joint_of[fit.rows]]
    z = fit.residuals * weight
    sizes = [context.union.sizes[c] for c in fit.columns]
    unit = np.array([size.typical for size in sizes])  # sizes of very different units in one matrix
    a = fit.jacobian * weight[:, None] * unit
    slope, curvature = half_loss_derivatives(z)
    prior = (unit / np.array([size.prior_std for size in sizes])) ** 2
    inverse = np.linalg.pinv(a.T @ (a * curvature[:, None]) + np.diag(prior), rcond=1e-12, hermitian=True)
    motion = context.model.motion_of[fit.rows]
    n = len(np.unique(motion))
    slopes = np.array([a[motion == k].T @ slope[motion == k] for k in np.unique(motion)]).reshape(
        n, len(sizes)
    )
    middle = slopes.T @ slopes * (n / max(n - 1, 1)) + np.diag(prior)
    covariance = inverse @ middle @ inverse
    sigma = unit * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    half = student.ppf(0.5 + 0.5 * COVERED, max(n - 1, 1)) * sigma
    at = fit.sizes[fit.columns]
    return np.column_stack([at - half, at + half])


def separating_motion(context: Context, doubt: Doubt) -> str:
    """Find the recorded motion in which the first two members of a set differ most.

    Args:
        context: The context.
        doubt: A finding with its alternatives.

    Returns:
        A sentence; empty if one member is left.
    """
    if len(doubt.alternatives) < 2:
        return ""
    first, second = doubt.alternatives[:2]
    rows = simulate(context, [(ALL_JOINTS, first.sizes), (ALL_JOINTS, second.sizes)], "comparison")
    model = context.model
    difference = (rows[0] - rows[1]) / context.scales[model.joint_of]
    motion = _strongest(difference, model.motion_of, len(model.motions))
    joint = _strongest(difference, model.joint_of, len(model.joints))
    inside = (model.motion_of == motion) & (model.joint_of == joint)
    change = np.sqrt(np.mean((rows[0] - rows[1])[inside] ** 2))
    return (
        f'more motions like "{model.motions[motion]}": there "{first.effect.name}" and '
        f'"{second.effect.name}" differ by {change:.2g} {model.unit} (RMS)'
    )


def _strongest(values: Array, group: Integers, n_groups: int) -> int:
    """Return the group with the largest mean square."""
    squares = np.bincount(group, weights=values**2, minlength=n_groups)
    return int(np.argmax(squares / np.maximum(np.bincount(group, minlength=n_groups), 1)))


def unexplained_dependence(
    fitted: tuple[Array, Array], held_out: tuple[Array, Array], n_bins: int = 10
) -> float:
    """Measure the share of the variance of a residual that follows a variable.

    Bin means are taken from motions that were fitted, and predict motions that were not.

    Args:
        fitted: Residuals and variable, (n,) each, in the unit of the model, of fitted motions.
        held_out: Residuals and variable, (n,) each, in the unit of the model, of motions that took no part.
        n_bins: Bins with equal counts.

    Returns:
        Share, at most 1; not positive if it predicts nothing.
    """
    residual, variable = fitted
    if len(residual) < n_bins or len(held_out[0]) < n_bins or np.ptp(variable) == 0.0:
        return 0.0
    edges = np.unique(np.quantile(variable, np.linspace(0.0, 1.0, n_bins + 1)[1:-1]))
    place, other = np.searchsorted(edges, variable), np.searchsorted(edges, held_out[1])
    count = np.maximum(np.bincount(place, minlength=len(edges) + 1), 1)
    means = np.bincount(place, weights=residual, minlength=len(edges) + 1) / count
    total = float(np.mean(held_out[0] ** 2))
    left = float(np.mean((held_out[0] - means[other]) ** 2))
    return 1.0 - left / total if total > 0.0 else 0.0


def list_members(doubt: Doubt) -> tuple[tuple[str, ...], tuple[Family, ...], tuple[str, ...]]:
    """List the places, families and effects that cannot be excluded, the best first.

    Args:
        doubt: A finding with its alternatives.

    Returns:
        Names without repetition.
    """
    effects = [one.effect for one in doubt.alternatives]
    places, families = (
        dict.fromkeys(one.place for one in effects),
        dict.fromkeys(one.family for one in effects),
    )
    return tuple(places), tuple(families), tuple(dict.fromkeys(one.key for one in effects))
