"""Assemble a diagnosis from what was selected, and judge it by motions that took no part.

Residuals are arrays (n,) in the unit of their model, of several (n_models, n); rows are indices, (n_rows,).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers, orthonormal
from simgap.effects.actuation import CurrentScale, GainError
from simgap.effects.effect import READING_HOOKS, Effect
from simgap.next_motion.rivals import NEXT_MOTION, can_be_settled, list_rivals
from simgap.residuals.noise import cut_rows, noise_residuals
from simgap.residuals.residuals import SECOND_ENCODER, ResidualModel, root_weight
from simgap.result import MIN_REMAINDER, Base, Diagnosis, Finding, JointError, Rejected, Remainder
from simgap.robot import Robot
from simgap.selection.acceptance import MAX_WORSE, knows_noise, measure_distance
from simgap.selection.context import Context, FittedModel, Selection, simulate_models
from simgap.selection.elimination import drop_needless, left_out_gain
from simgap.selection.fitting import evaluate_points
from simgap.selection.joint_fits import MIN_MOTIONS, joints_of
from simgap.selection.verdict import (
    ConfidenceSet,
    find_confidence_sets,
    find_pushed,
    keep_sets,
    list_members,
    readmit_rivals,
    size_intervals,
    unexplained_dependence,
)
from simgap.units import quantity

MIN_CLOSURE: Final = 0.5
"""Least share of what can be explained that a finding removes to be called a cause: with less, more remains
than it explains. Of effects named alone in 120 sealed cases of servos, 56 of 58 above it were right, and 7 of
9 below it."""
MAX_INFLATION: Final = 10.0
"""Largest variance inflation of a finding by others for which its name is told: the usual bound of
regressors that can be separated (Marquardt 1970)."""
MIN_DEPENDENCE: Final = 0.1
"""Least share of the variance of a remainder that a variable explains to be named."""
VARIABLES: Final = ("position", "velocity", "load", "time", "temperature")
"""The simplest first: it is named where another explains no more. The command of a servo is its position."""
CLEARLY_MORE: Final = 0.1
"""Share of variance by which a later variable has to be better."""
SLOW: Final = 0.1
"""Largest share of the highest usual speed that is slow."""


def assemble(
    robot: Robot,
    raw: ResidualModel,
    selection: Selection,
    sets: Sequence[ConfidenceSet],
    held_out: ResidualModel,
) -> Diagnosis:
    """Put the parts of a diagnosis together, but for seed, refusals and held-out motions.

    Args:
        raw: Residuals of the motions that were fitted.
        held_out: Residuals of motions that took no part; those of the fit where there are none.
    """
    context, chosen = selection.context, selection.chosen
    effects = tuple(
        one for one in context.union.effects if np.any(chosen.sizes[context.union.columns([one])])
    )
    sizes = tuple(tuple(chosen.sizes[context.union.columns([one])].tolist()) for one in effects)
    rows = simulate_models(context, held_out, [0.0 * chosen.sizes, selection.base.sizes, chosen.sizes])
    fitted = rows[2] if held_out is raw else simulate_models(context, raw, [chosen.sizes])[0]
    findings = tuple(doubt_names([describe_finding(context, chosen, one, sets) for one in sets]))
    return Diagnosis(
        robot=robot.name,
        kind=context.model.kind,
        seed=0,
        findings=findings,
        base=tuple(add_shares(context, chosen, held_out, list_base(robot, context, chosen, sets))),
        errors=tuple(list_errors(raw, fitted, held_out, rows)),
        remaining=tuple(list_remainders(raw, fitted, held_out, rows[2])),
        refused=(),
        fitted_motions=context.model.motions,
        judged_motions=(),
        effects=effects,
        sizes=sizes,
        method=context.model.method,
        effect_kinds=(context.model.kind,) * len(effects),
        rivals=list_rivals(context, chosen, sets, findings),
    )


def select_sure(
    selection: Selection, held_out: ResidualModel | None
) -> tuple[Selection, list[ConfidenceSet], list[Rejected]]:
    """Withdraw findings that harm a joint of motions that took no part, or whose intervals all hold 0.

    Such motions also take effects back into the sets, which then are as sure as they say.

    Args:
        held_out: Residuals of motions that took no part; None if there are none.

    Returns:
        The selection without them, the confidence sets of the others, and what was withdrawn.
    """
    rejected: list[Rejected] = []
    known: list[ConfidenceSet] = []
    while True:
        if held_out is not None and (harm := find_harmful(selection, held_out)):
            effect, reason = harm
        else:
            sets = known = find_confidence_sets(selection, known)
            idle = next((one.effect for one in sets if may_be_none(selection, one.effect, sets)), None)
            if idle is None:
                if held_out is not None:
                    sets = [readmit_rivals(selection.context, one, held_out) for one in sets]
                return selection, sets, rejected
            effect, reason = idle, "its 90 % interval holds 0"
        rejected.append(Rejected(effect.place, effect.name, reason))
        known = keep_sets(selection, known, effect)
        selection = drop_finding(selection, effect)


def drop_finding(selection: Selection, effect: Effect) -> Selection:
    """Refit without a finding, and without those that were needed beside it alone."""
    context, known = selection.context, selection.left_out
    chosen, left_out, kept = drop_needless(context, selection.chosen, selection.kept, known, gone=effect)
    return replace(selection, chosen=chosen, left_out=left_out, kept=kept)


def may_be_none(selection: Selection, effect: Effect, sets: Sequence[ConfidenceSet]) -> bool:
    """Check whether the intervals of all sizes of a finding hold 0, which is no effect; a form is no size."""
    context = selection.context
    columns = context.union.columns([effect])[: 1 if effect.has_shape else None]
    ends = [find_interval(context, selection.chosen, sets, int(column)) for column in columns]
    return all(low <= 0.0 <= high for low, high in ends)


def find_harmful(selection: Selection, held_out: ResidualModel) -> tuple[Effect, str] | None:
    """Find the finding that makes a joint of held-out motions worse, and why.

    With it, its own joint is worse than without it, and differs by more than a standard deviation of noise,
    or another is worse by more than MAX_WORSE. These motions took no part in the selection: they decide.
    Where several make one that much worse than base parameters alone, it is the one that is needed least.
    """
    context, chosen = selection.context, selection.chosen
    if not chosen.effects:
        return None
    models = [chosen, selection.base, *(model for _, model in selection.left_out)]
    residuals = simulate_models(context, held_out, [model.sizes for model in models])
    rows, joints = np.abs(residuals), np.unique(held_out.joint_of)
    after, base, *without = np.array([np.mean(rows[:, held_out.joint_of == j], axis=1) for j in joints]).T

    def find_worst(before: Array, own: Sequence[int] = ()) -> tuple[float, int, float]:
        ratios, is_own = after / np.maximum(before, 1e-300), np.isin(joints, own)
        elsewhere = float(np.max(ratios)) / (1.0 + MAX_WORSE)
        here = float(np.mean(ratios[is_own])) if is_own.any() else 0.0
        j = int(np.argmax(np.where(is_own | (here <= elsewhere), ratios, 0.0)))
        return max(here, elsewhere), j, float(before[j])

    harms = []
    for (layer, _), before, left in zip(selection.left_out, without, residuals[2:], strict=True):
        for effect in layer:
            others = [j for one in layer if one is not effect for j in joints_of(context, one)]
            before_it, mine = np.where(np.isin(joints, others), after, before), joints_of(context, effect)
            rows_of_it = np.flatnonzero(np.isin(held_out.joint_of, mine))
            distance = measure_distance(context, held_out, rows_of_it, left, residuals[0])
            harms.append((effect, *find_worst(before_it, mine if distance > 1.0 else ())))
    effect, ratio, j, error = max(harms, key=lambda one: one[1])
    if ratio <= 1.0:  # a joint without an effect differs from base parameters by these alone
        acted = np.isin(joints, [j for one in chosen.effects for j in joints_of(context, one)])
        ratio, j, error = find_worst(np.where(acted, base, after))
        if ratio <= 1.0:
            return None
        own = (one for one in chosen.effects if joints[j] in joints_of(context, one))
        effect = min(own, key=lambda one: left_out_gain(selection, one))
    name, unit = held_out.joints[joints[j]], held_out.units[joints[j]]
    words = f"{quantity(error, unit)} to {quantity(float(after[j]), unit)}"
    return effect, f"it makes {name} worse on motions that took no part: {words}"


def describe_finding(
    context: Context, chosen: FittedModel, found: ConfidenceSet, sets: Sequence[ConfidenceSet]
) -> Finding:
    """Describe a finding with its sets.

    Where more remains than it explains, it is found only beside another that it resembles, or a base
    parameter of the joint is pushed against its bound, the sets of families and effects are empty: none of
    the catalogue is known to be the cause of what is at the place.
    """
    effect, own = found.effect, context.union.columns([found.effect])
    places, families, effects = list_members(found)
    is_unsure = explains_too_little(context, found) or any(
        is_pushed(context, chosen, one) for one in context.base if one.place == effect.place
    )
    if is_unsure or find_inflation(context, chosen, effect) > MAX_INFLATION:
        families, effects = (), ()
    size = chosen.sizes[own]
    is_second = context.model.kind == SECOND_ENCODER and effect.overrides(*READING_HOOKS)
    return Finding(
        place=effect.place,
        family=effect.family,
        effect=effect.name,
        size=tuple(size.tolist()),
        size_names=tuple(one.name for one in effect.sizes),
        interval=tuple(find_interval(context, chosen, sets, int(column)) for column in own),
        text=effect.describe(size) + (", of the second encoder" if is_second else ""),
        share=found.share,
        places=places,
        families=families,
        effects=effects,
        next_motion=NEXT_MOTION if len(effects) != 1 and can_be_settled(found, chosen.effects) else "",
    )


def doubt_names(findings: Sequence[Finding]) -> list[Finding]:
    """Take the names of effects from findings beside one at the same place whose cause is not known.

    Other effects were excluded beside that one, so with a model that is known to be wrong. One that explains
    little there does not make the others doubtful.
    """
    unknown = {one.place for one in findings if not one.families and one.share >= MIN_CLOSURE}
    return [replace(one, effects=()) if one.place in unknown else one for one in findings]


def explains_too_little(context: Context, found: ConfidenceSet) -> bool:
    """Check whether more remains at the joints of a finding than it explains; False if noise is unknown."""
    rows = np.flatnonzero(np.isin(context.model.joint_of, list(joints_of(context, found.effect))))
    return found.share < MIN_CLOSURE and knows_noise(context, rows)


def is_pushed(context: Context, chosen: FittedModel, effect: Effect) -> bool:
    """Check whether a base parameter ends at a bound that the motions contradict."""
    own = context.union.columns([effect])
    return any(np.isin(own, find_pushed(context, fit)).any() for fit in chosen.fits)


def find_inflation(context: Context, chosen: FittedModel, effect: Effect) -> float:
    """Compute the variance inflation of a finding by those that were fitted with it; 1 without others.

    Several effects that nearly cancel one another can imitate one that the catalogue lacks. With the largest
    canonical correlation r of their changes with those of the finding, beside the base parameters, the
    inflation is 1 / (1 - r^2) (Belsley, Kuh and Welsch 1980).
    """
    fit = next(fit for fit in chosen.fits if np.isin(context.union.columns([effect]), fit.columns).all())
    scale = context.scales[context.model.joint_of[fit.rows]]
    changes = fit.jacobian * (root_weight(fit.residuals / scale) / scale)[:, None]
    own = np.isin(fit.columns, context.union.columns([effect]))
    others = np.isin(fit.columns, context.union.columns(chosen.effects)) & ~own
    if not others.any():
        return 1.0
    base = orthonormal(changes[:, ~own & ~others])
    mine, theirs = (
        orthonormal(changes[:, part] - base @ (base.T @ changes[:, part])) for part in (own, others)
    )
    largest = float(np.linalg.norm(mine.T @ theirs, 2))
    return 1.0 / max(1.0 - largest**2, 1e-12)


def find_interval(
    context: Context, chosen: FittedModel, sets: Sequence[ConfidenceSet], column: int
) -> tuple[float, float]:
    """Return the interval of a size; that of an effect at a body allows for the sizes of all joints.

    It also holds the intervals that the size has where a member that fits as well stands for another finding.
    """
    fit = next(fit for fit in chosen.fits if column in fit.columns)
    pairs = [(fit.columns, size_intervals(context, fit))]
    others = [one for found in sets for one in found.alternatives[1:] if one.fits_as_well]
    pairs += [(one.columns, one.intervals) for one in others]
    ends = np.concatenate([intervals[columns == column] for columns, intervals in pairs])
    return float(ends[:, 0].min()), float(ends[:, 1].max())


def list_base(
    robot: Robot, context: Context, chosen: FittedModel, sets: Sequence[ConfidenceSet]
) -> list[Base]:
    """List the base parameters as fitted.

    A number counts as unidentifiable if its interval is as wide as the prior allows, or if the gain of its
    joint is fitted too and gravity gives it no scale.
    """
    found = []
    with_gain = {one.place for one in context.base if isinstance(one, GainError | CurrentScale)}
    for effect in _base_of_joints(context):
        for column, size in zip(context.union.columns([effect]), effect.sizes, strict=True):
            low, high = find_interval(context, chosen, sets, int(column))
            known = high - low < min(2.0 * size.prior_std, size.high - size.low)
            has_scale = robot.joint(effect.place).is_loaded_by_gravity or effect.place not in with_gain
            nominal = effect.nominal
            found.append(
                Base(
                    place=effect.place,
                    name=size.name,
                    nominal=nominal,
                    value=nominal + float(chosen.sizes[column]),
                    interval=(nominal + low, nominal + high),
                    is_identifiable=bool(known and has_scale),
                    is_pushed=is_pushed(context, chosen, effect),
                )
            )
    return found


def _base_of_joints(context: Context) -> list[Effect]:
    return [one for one in context.base if one.place in context.model.joints]


def add_shares(
    context: Context, chosen: FittedModel, held_out: ResidualModel, base: Sequence[Base]
) -> list[Base]:
    """Add the share of the error that comes back without them to base parameters that differ."""
    columns = context.union.columns(_base_of_joints(context))
    differing = [k for k, one in enumerate(base) if one.differs]
    joints = [held_out.joints.index(base[k].place) for k in differing]
    points = [(joint, chosen.sizes) for joint in joints]
    for k, joint in zip(differing, joints, strict=True):
        without = chosen.sizes.copy()
        without[columns[k]] = 0.0
        points.append((joint, without))
    rows = evaluate_points(held_out, context.union, points, sharing=context.sharing)
    errors = [float(np.mean(np.abs(one))) if one.size else 0.0 for one in rows]
    found = list(base)
    for k, after, before in zip(differing, errors[: len(joints)], errors[len(joints) :], strict=True):
        found[k] = replace(base[k], share=1.0 - after / before if before > 0.0 else 0.0)
    return found


def list_errors(raw: ResidualModel, fitted: Array, held_out: ResidualModel, rows: Array) -> list[JointError]:
    """List the mean absolute residual of each joint, with nominal, base and chosen model."""
    found = []
    for j, name in enumerate(held_out.joints):
        if not np.any(held_out.joint_of == j):
            continue
        here = np.abs(rows[:, held_out.joint_of == j])
        nominal, base, chosen = np.mean(here, axis=1).tolist()
        noise = _find_noise(raw, fitted, held_out, rows[2], j)
        level = float(np.mean(np.abs(noise))) if len(noise) else float("nan")
        found.append(JointError(name, held_out.units[j], nominal, base, chosen, level, held_out.kind))
    return found


def _find_noise(raw: ResidualModel, fitted: Array, held_out: ResidualModel, judged: Array, j: int) -> Array:
    """Return what noise alone leaves at a joint, (n_noise,): by repeats that were fitted, else by others."""
    found = noise_residuals(raw, fitted, j)
    return found if len(found) else noise_residuals(held_out, judged, j)


def list_remainders(
    raw: ResidualModel, fitted: Array, held_out: ResidualModel, residuals: Array
) -> list[Remainder]:
    """Say what no effect explains: joint, regime of speed, variable on which it depends.

    Returns:
        A record for each joint whose error is above its noise, or follows a variable where noise is unknown.
    """
    found = []
    for j, name in enumerate(held_out.joints):
        rows = np.flatnonzero(held_out.joint_of == j)
        if not np.any(raw.joint_of == j) or not rows.size:
            continue
        error = float(np.mean(np.abs(residuals[rows])))
        variable, share = find_dependence(held_out, rows, residuals[rows])
        noise = _find_noise(raw, fitted, held_out, residuals, j)
        above = len(noise) and error > MIN_REMAINDER * float(np.mean(np.abs(noise)))
        if above or (not len(noise) and variable):
            regime = find_regime(held_out.explain("velocity")[rows], residuals[rows])
            found.append(Remainder(name, regime, error, held_out.units[j], variable, share))
    return found


def find_dependence(model: ResidualModel, rows: Integers, residuals: Array) -> tuple[str, float]:
    """Find the variable that a residual follows most from motion to motion, and the share that it explains.

    Of few motions, blocks as long as the correlation time of the residual count. The variable is empty if
    none explains MIN_DEPENDENCE.
    """
    group = model.motion_of[rows]
    if len(np.unique(group)) < MIN_MOTIONS:
        group = cut_rows(model, rows, residuals)
    shares = {}
    for name in VARIABLES:
        variable = model.explain(name)[rows]
        if np.isfinite(variable).all():
            shares[name] = unexplained_dependence(residuals, variable, group)
    most = max(shares.values(), default=0.0)
    best = next((name for name in shares if shares[name] >= most - CLEARLY_MORE), "")
    if not best or shares[best] < MIN_DEPENDENCE:
        return "", 0.0
    return best, shares[best]


def find_regime(speed_rad_s: Array, residuals: Array) -> str:
    """Return "slow" or "fast" if over two thirds of the sum of squares lie there, else "all motion"."""
    slow = np.abs(speed_rad_s) < SLOW * np.quantile(np.abs(speed_rad_s), 0.99)
    total, part = float(np.sum(residuals**2)), float(np.sum(residuals[slow] ** 2))
    if total == 0.0 or 1.0 < 3.0 * part / total < 2.0:
        return "all motion"
    return "slow" if part > total / 2.0 else "fast"
