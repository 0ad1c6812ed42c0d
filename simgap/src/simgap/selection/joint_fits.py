"""Fit the base parameters and the accepted effects of every joint, with all motions and without some.

Sizes are those of the union, each in its own unit, (n_sizes,); a fit starts from them.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.effects.actuation import DampingGain
from simgap.effects.effect import Effect
from simgap.effects.forces import ViscousFriction
from simgap.effects.inertia import Armature
from simgap.residuals.noise import Blocks, cut_into_blocks, noise_losses, whiten_noise
from simgap.residuals.residuals import ResidualModel, refer_to
from simgap.selection.acceptance import MIN_SHARE, cross_validate, improvement_share
from simgap.selection.context import (
    Context,
    FittedModel,
    Score,
    draw_folds,
    fit_together,
    resume_step,
    simulate,
    start_fitting,
)
from simgap.selection.fit import Hypothesis, JointFit, gather_residuals, scale_residuals, select_rows
from simgap.selection.fitting import MAX_ITERATIONS
from simgap.selection.screening import expect_round, group_effects, share_simulations
from simgap.selection.sharing import ALL_JOINTS

TOO_WIDE: Final = 2.0
"""Scale of a joint over that of its residuals for which a fit is repeated: the joint counts a quarter."""
MIN_MOTIONS: Final = 4
"""Least motions of a fit: with fewer, no error of a left-out motion has a standard error worth the name."""
STARTS: Final[dict[type[Effect], tuple[float, ...]]] = {
    ViscousFriction: (0.0, 0.02, 0.02, 0.05, 0.02, 0.5),
    DampingGain: (0.0, 0.02, 0.02, 0.05, 0.5, 0.1),
    Armature: (0.0, 0.0, 0.05, 0.05, 0.05, 0.05),
}
"""Base parameters of a joint in each of its starts, over the largest that is allowed: first as in the model.
Without damping a model rings, and without armature a fit may stay at none: from there fits go astray. In 12
sealed cases of servos, one of these reached the least loss of 42 random starts."""
STARTS_KEPT: Final = ((8, 2), (MAX_ITERATIONS, 1))
"""Iterations of the starts of a joint, and how many then go on. In 7 sealed cases of servos, one of the best
two after 8 had the least loss at the end."""
BASE_ROUNDS_AFTER: Final = 2.5
"""Rounds that are expected after the base parameters, for the progress: one, and what is expected after it.

The base parameters themselves took 0.65 to 1.16 of what a round is expected to, on four robots.
"""


def fit_base(context: Context) -> tuple[Context, FittedModel]:
    """Fit the base parameters of each joint: the reference, then scales and noise follow from earlier fits.

    Return also the context with scales and noise, its residuals whitened where the noise is known.
    """
    raw, union = context.model, context.union
    sizes = np.zeros(len(union.sizes))
    known = {one.place for one in context.base}
    others = [one for one in context.catalogue if one.place in raw.joints and one.place not in known]
    (residuals,) = raw.residuals([], np.zeros((1, 0)))
    context = replace(context, scales=scale_residuals(raw, residuals))
    context = share_simulations(context, sizes, [*context.base, *others])
    groups = group_effects(context, range(len(raw.joints)), ())
    context.meter.begin_base(expect_round(context, groups, sizes), BASE_ROUNDS_AFTER)
    sizes = resume_step(fit_starts, context)[0].sizes
    raw = refer_to(raw, context.base, sizes[union.columns(context.base)])
    context = replace(context, model=raw)
    sizes, residuals, _ = fit_all_joints(context, sizes)
    if len(raw.motions) < MIN_MOTIONS and not raw.noise_std:
        raw = cut_into_blocks(raw, residuals)
    n_parts = _count_motions(raw)
    if n_parts < MIN_MOTIONS and not raw.noise_std:
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
    left_out = cross_validate(context, fits)
    context = replace(context, base_sizes=sizes, base_left_out=left_out)
    return context, FittedModel((), sizes, fits, left_out)


def fit_starts(context: Context) -> tuple[JointFit, ...]:
    """Fit the base parameters of each joint from several starts, and return the best fits."""
    joints = range(len(context.model.joints))
    hypotheses = [start_fit(context, (), j, start) for j in joints for start in list_starts(context, j)]
    fitting = start_fitting(context, hypotheses, "fit")
    for iterations, count in STARTS_KEPT:
        fitting.advance(iterations)
        best = sorted(enumerate(fitting.descents), key=lambda pair: pair[1].loss)
        own = [[k for k, one in best if one.joint == joint] for joint in joints]
        fitting.keep([k for places in own for k in places[:count]])
    fits = fitting.finish()
    sizes = merge_sizes(context, np.zeros(len(context.union.sizes)), fits)
    return tuple(replace(fit, sizes=sizes) for fit in fits)


def list_starts(context: Context, joint: int) -> Array:
    """List the STARTS of a joint that differ, (n, n_sizes)."""
    union = context.union
    own = [one for one in context.base if type(one) in STARTS and context.joint_of(one) == joint]
    starts = np.zeros((max([1, *(len(STARTS[type(one)]) for one in own)]), len(union.sizes)))
    for effect in own:
        starts[:, union.columns([effect])[0]] = np.array(STARTS[type(effect)]) * effect.sizes[0].high
    return np.unique(starts, axis=0)


def _count_motions(model: ResidualModel) -> int:
    """Return the number of motions; of blocks, those of the joint that has the fewest."""
    if not isinstance(model, Blocks):
        return len(model.motions)
    counts = np.bincount(model.joint_of_block)
    return int(np.min(counts[counts > 0], initial=len(model.motions)))


def add_effects(
    context: Context,
    base: FittedModel,
    present: FittedModel,
    effects: Sequence[Effect],
    found: Sequence[JointFit],
) -> tuple[Context, FittedModel]:
    """Add effects to the present model, and refit it with itself as reference, in the scales of what is left.

    A reference from before an effect was found has starts and errors of the time step of another motion. A
    scale from then is so wide that the loss is a sum of squares, and a joint with it counts little beside
    others. So the fit is repeated while a scale is TOO_WIDE. Blocks are cut anew.
    """
    sizes, fits = merge_sizes(context, present.sizes, found), (*present.fits, *found)
    more = (*present.effects, *effects)
    while True:
        context, residuals = _refer_to_present(context, more, sizes)
        model, scales = context.model, scale_residuals(context.model, residuals)
        context = replace(context, scales=scales, noise_loss=noise_losses(model, residuals, scales))
        fits = resume_step(fit_joints, context, more, sizes, fits)
        sizes, residuals = fits[0].sizes, gather_residuals(fits, model.joint_of.size)
        if model.noise_std or np.all(scales < TOO_WIDE * scale_residuals(model, residuals)):
            break
    context = replace(context, base_left_out=cross_validate(context, base.fits))
    left_out = resume_step(cross_validate, context, fits)
    return context, FittedModel(more, fits[0].sizes, fits, left_out)


def _refer_to_present(context: Context, effects: Sequence[Effect], sizes: Array) -> tuple[Context, Array]:
    """Return the context with effects as reference, and their residuals, (n,); blocks follow from these."""
    every = (*context.base, *effects)
    own = sizes[context.union.columns(every)]
    model = context.model
    whole = refer_to(model.whole if isinstance(model, Blocks) else model, every, own)
    context = replace(context, model=whole)
    (residuals,) = simulate(context, [(ALL_JOINTS, sizes)], "fit")
    if isinstance(model, Blocks):  # what was explained is no memory of the noise
        blocks = cut_into_blocks(whole, residuals)
        context = replace(context, model=blocks, folds=draw_folds(blocks, context.seed))
    return context, residuals


def merge_findings(context: Context, present: FittedModel) -> tuple[FittedModel, tuple[Score, ...]] | None:
    """Replace findings at several joints by one that all joints have in common; None if none does as much.

    One effect that does as much as several is the simpler explanation. Each starts where the findings are.
    Those that are not the best are returned with their sizes.
    """
    common = [one for one in context.catalogue if len(one.parts) > 1]
    keys = {part.place + one.key.removeprefix(one.place) for one in common for part in one.parts}
    own = [one for one in present.effects if one.key in keys]
    if len(own) < 2:
        return None
    rest = tuple(one for one in present.effects if one not in own)
    columns, tried = context.union.columns, []
    for effect in common:
        sizes = present.sizes.copy()
        sizes[columns([effect])] = np.median([sizes[columns([one])] for one in own], axis=0)
        sizes[columns(own)] = 0.0
        fits = resume_step(fit_joints, context, (*rest, effect), sizes, present.fits)
        model = FittedModel((*rest, effect), fits[0].sizes, fits, cross_validate(context, fits))
        tried.append((effect, model))
    rows = np.arange(len(context.model.joint_of))

    def gain(model: FittedModel) -> float:
        return improvement_share(context, rows, context.base_left_out, model.left_out)

    tried.sort(key=lambda pair: -gain(pair[1]))
    (_, best), others = tried[0], tried[1:]
    if gain(best) < (1.0 - MIN_SHARE) * gain(present):
        return None
    return best, tuple(Score(effect, model.sizes, 0.0) for effect, model in others)


def recut_blocks(
    context: Context, present: FittedModel, shortlist: Sequence[Score]
) -> tuple[Context, FittedModel]:
    """Cut the blocks of each joint by the memory of what its best effect leaves.

    Without the effect that memory is the noise's. With it, what it explains is no noise: blocks as long as
    the misfit would be so few that a fit without one extrapolates. The model is judged by the new blocks and
    folds; nothing changes where motions are whole.
    """
    if not isinstance(context.model, Blocks) or not shortlist:
        return context, present
    left = gather_residuals(present.fits, len(context.model.joint_of))
    for score in sorted(shortlist, key=lambda one: one.gain):  # the best comes last and stays
        for rows, values in score.left:
            left[rows] = values
    model = cut_into_blocks(context.model.whole, left)
    context = replace(context, model=model, folds=draw_folds(model, context.seed))
    return context, replace(present, left_out=cross_validate(context, present.fits))


def fit_all_joints(context: Context, sizes: Array) -> tuple[Array, Array, tuple[JointFit, ...]]:
    """Fit the base parameters of all joints; return sizes (n_sizes,), all residuals (n,), and the fits."""
    fits = resume_step(fit_joints, context, (), sizes)
    return fits[0].sizes, gather_residuals(fits, len(context.model.joint_of)), fits


def start_fit(
    context: Context, effects: Sequence[Effect], joint: int, sizes: Array, known: Sequence[JointFit] = ()
) -> Hypothesis:
    """Return the hypothesis of base and effects at a joint, with derivatives of near fits of this model."""
    free = [one for one in (*context.base, *effects) if joint in (ALL_JOINTS, context.joint_of(one))]
    columns = context.union.columns(free)
    slopes = np.full((len(context.model.joint_of), len(columns)), np.nan, np.float32)
    for fit in known:
        here = np.flatnonzero(np.isin(columns, fit.columns))
        there = [int(np.flatnonzero(fit.columns == columns[k])[0]) for k in here]
        slopes[:, here] = 0.0  # a size at a joint moves no other
        slopes[np.ix_(fit.rows, here)] = fit.jacobian[:, there]
    return Hypothesis(columns, sizes, joint, slopes[select_rows(context.model, joint)])


def fit_joints(
    context: Context, effects: Sequence[Effect], sizes: Array, known: Sequence[JointFit] = ()
) -> tuple[JointFit, ...]:
    """Fit base and effects of every joint; all joints together if an effect is judged at all of them.

    The residuals are those with the new sizes of all joints: a joint was fitted with the others as they were.
    Known fits are of the same residual model, at sizes that are near.
    """
    joints = [*range(len(context.model.joints))]
    if any(context.joint_of(one) == ALL_JOINTS for one in effects):
        joints = [ALL_JOINTS]
    fits = fit_each(context, effects, joints, sizes, known)
    if len(fits) == 1:
        return fits
    return simulate_fits(context, merge_sizes(context, sizes, fits), fits)


def fit_each(
    context: Context,
    effects: Sequence[Effect],
    joints: Sequence[int],
    sizes: Array,
    known: Sequence[JointFit] = (),
) -> tuple[JointFit, ...]:
    """Fit base and effects of some joints, each with the others as they are.

    A joint without an effect may begin where its base parameters were fitted: else they may stay where they
    were fitted beside an effect that went.
    """
    taken, hypotheses = [context.joint_of(one) for one in effects], []
    for joint in joints:
        one = start_fit(context, effects, joint, sizes, known)
        if context.base_sizes.size and joint not in (ALL_JOINTS, *taken):
            start = np.where(context.sharing.list_fitted(joint), context.base_sizes, sizes)
            one = replace(one, other_starts=(start,))
        hypotheses.append(one)
    return tuple(fit_together(context, hypotheses, "fit"))


def simulate_fits(context: Context, sizes: Array, fits: Sequence[JointFit]) -> tuple[JointFit, ...]:
    """Return fits with these sizes, (n_sizes,), of all joints, and with the residuals that they leave."""
    (rows,) = simulate(context, [(ALL_JOINTS, sizes)], "fit")
    return tuple(replace(fit, sizes=sizes, residuals=rows[fit.rows]) for fit in fits)


def fits_at(context: Context, present: FittedModel, joint: int) -> tuple[JointFit, ...]:
    """Return the fits of the residuals of a joint or ALL_JOINTS; of a fit of all joints, its part there."""
    if joint == ALL_JOINTS or len(present.fits) == len(context.model.joints):
        return present.fits if joint == ALL_JOINTS else (present.fits[joint],)
    (whole,) = present.fits
    rows = select_rows(context.model, joint)
    moves = np.flatnonzero(np.isin(context.sharing.joint_of_column[whole.columns], (joint, ALL_JOINTS)))
    part = replace(
        whole,
        columns=whole.columns[moves],
        joint=joint,
        residuals=whole.residuals[rows],
        rows=rows,
        jacobian=whole.jacobian[np.ix_(rows, moves)],
    )
    return (part,)


def merge_sizes(context: Context, sizes: Array, fits: Sequence[JointFit]) -> Array:
    """Return the sizes, (n_sizes,), with those that each fit has found."""
    merged = sizes.copy()
    for fit in fits:
        merged[fit.columns] = fit.sizes[fit.columns]
    return merged


def leave_out(context: Context, present: FittedModel, effects: Sequence[Effect]) -> FittedModel:
    """Refit the model without some of its effects, at their joints; at all if a size there moves another."""
    sizes, rest = present.sizes.copy(), list_rest(present, effects)
    sizes[context.union.columns(effects)] = 0.0
    joints = sorted({context.joint_of(one) for one in effects})
    if len(joints) == len(context.model.joints) or move_others(context, present, joints):
        fits = resume_step(fit_joints, context, rest, sizes, present.fits)
        return FittedModel(rest, fits[0].sizes, fits, resume_step(cross_validate, context, fits))
    fits = resume_step(fit_each, context, rest, joints, sizes, present.fits)
    return put_together(context, present, rest, fits)


def move_others(context: Context, present: FittedModel, joints: Sequence[int]) -> bool:
    """Return whether a size of the present model that is fitted at some joints moves another joint."""
    columns = context.union.columns([*context.base, *present.effects])
    columns = columns[np.isin(context.sharing.joint_of_column[columns], joints)]
    is_one_fit = len(present.fits) < len(context.model.joints)
    return is_one_fit or bool(np.isin(columns, context.sharing.reaching).any())


def list_rest(present: FittedModel, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """List the effects of a model but for some."""
    gone = {effect.key for effect in effects}
    return tuple(one for one in present.effects if one.key not in gone)


def put_together(
    context: Context, present: FittedModel, effects: tuple[Effect, ...], fits: Sequence[JointFit]
) -> FittedModel:
    """Make a model with other effects from new fits of some joints; other joints keep their present fits.

    All joints are simulated with the sizes of all, and so are left-out motions. So a comparison with the
    present model shows what the new fits change.
    """
    sizes, new = present.sizes.copy(), {fit.joint: fit for fit in fits}
    for joint, fit in new.items():
        mine = context.sharing.list_fitted(joint)
        sizes[mine] = fit.sizes[mine]
    every = simulate_fits(context, sizes, [new.get(fit.joint, fit) for fit in present.fits])
    return FittedModel(effects, sizes, every, resume_step(cross_validate, context, every))


def list_layers(context: Context, effects: Sequence[Effect]) -> list[tuple[Effect, ...]]:
    """Divide effects into groups that can be left out together, because none moves the joint of another."""
    layers: list[list[Effect]] = []
    for effect in effects:
        free = [layer for layer in layers if all(are_separate(context, effect, one) for one in layer)]
        if free:
            free[0].append(effect)
        else:
            layers.append([effect])
    return [tuple(layer) for layer in layers]


def are_separate(context: Context, first: Effect, second: Effect) -> bool:
    """Return whether two effects can be left out together, because neither moves the joint of the other."""
    columns = [context.union.columns([one])[0] for one in (first, second)]
    return context.sharing.may_share(*columns)


def joints_of(context: Context, effect: Effect) -> tuple[int, ...]:
    """Return the joints at which an effect is judged."""
    joint = context.joint_of(effect)
    return tuple(range(len(context.model.joints))) if joint == ALL_JOINTS else (joint,)
