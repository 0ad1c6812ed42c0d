"""Drop the effects that left-out motions do not need, one after the other, and together.

Residuals are arrays (n,) in the unit of the model, all of them in the order of the model.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect
from simgap.residuals.residuals import pseudo_huber
from simgap.selection.acceptance import MIN_SHARE, MIN_Z, improvement_share, improvement_z, knows_noise
from simgap.selection.chance import FALSE_ALARM, known_noise_log_p
from simgap.selection.context import Context, FittedModel, LeftOut, Selection, resume_step
from simgap.selection.fit import JointFit, gather_residuals, select_rows
from simgap.selection.joint_fits import (
    are_separate,
    fit_each,
    fits_at,
    leave_out,
    list_layers,
    list_rest,
    move_others,
    put_together,
)
from simgap.selection.screening import refit_p
from simgap.selection.sharing import ALL_JOINTS


def drop_needless(
    context: Context,
    present: FittedModel,
    kept: frozenset[str] = frozenset(),
    known: LeftOut = (),
    gone: Effect | None = None,
) -> tuple[FittedModel, LeftOut, frozenset[str]]:
    """Drop effects, the weakest first, until left-out motions need each of them and none is due to chance.

    Those that move what a dropped one moves are judged again. Others keep their judgement: beside a joint
    that lacks an effect, those of other joints seem to be needed less.

    What is dropped is also tested together, against the model at the start: losses that are too small one by
    one add up. If they are too large together, the effect that explains most comes back, and stays, as those
    whose keys are `kept` from before do.

    Return also each effect left out, and the keys of what is kept.

    Args:
        known: Each effect of the present model left out of it, if all were judged before.
        gone: Effect that is left out first, whatever motions say; then only what it moves is judged again.
    """
    without = {effect.key: model for layer, model in known for effect in layer}
    before, changed = present, present.effects
    if gone is not None:
        present, changed = leave_known_out(context, present, without, [gone]), (gone,)
    whole = present
    while changed:
        near = [one for effect in changed for one in list_together(context, effect, whole.effects)]
        judged = [one for one in present.effects if one in near]
        for layer in list_layers(context, judged):
            without |= dict.fromkeys((one.key for one in layer), leave_out(context, present, layer))
        needs = [(one, *find_need(context, present, without[one.key], [one])) for one in judged]
        failed = sorted((one for one in needs if not one[1]), key=lambda one: one[2])
        if weak := [effect for effect, *_ in failed if effect.key not in kept]:
            changed, *_ = list_layers(context, weak)
            present = leave_known_out(context, present, without, changed)
        elif back := find_needed_together(context, whole, present):
            effect, present = back
            changed, kept = (effect,), kept | {effect.key}
        else:
            changed = ()
    present, layers = refit_others(context, present, before), list_layers(context, present.effects)
    return present, tuple((one, leave_known_out(context, present, without, one)) for one in layers), kept


def leave_known_out(
    context: Context, present: FittedModel, without: Mapping[str, FittedModel], layer: Sequence[Effect]
) -> FittedModel:
    """Leave separate effects out together, with what is known of the model without each.

    Where other joints have changed since, the joint of each effect has the fit that it had without it.

    Args:
        without: Models without an effect, by its key; it may lack other, separate ones too.
    """
    models, rest = [without[one.key] for one in layer], list_rest(present, layer)
    joints = [context.joint_of(one) for one in layer]
    moves = move_others(context, present, joints)
    is_far = ~np.isin(context.sharing.joint_of_column, joints)
    if models[0].effects == rest and (
        moves or np.array_equal(models[0].sizes[is_far], present.sizes[is_far])
    ):
        return models[0]
    if moves:
        return leave_out(context, present, layer)
    fits = [model.fits[joint] for model, joint in zip(models, joints, strict=True)]
    return put_together(context, present, rest, fits)


def refit_others(context: Context, present: FittedModel, before: FittedModel) -> FittedModel:
    """Refit the joints whose sizes are those of a model with more effects: they were fitted beside these."""
    if present.effects == before.effects or len(present.fits) != len(before.fits):
        return present
    joints = [
        fit.joint
        for fit, old in zip(present.fits, before.fits, strict=True)
        if np.array_equal(fit.sizes[fit.columns], old.sizes[old.columns])
    ]
    if not joints:
        return present
    fits = resume_step(fit_each, context, present.effects, joints, present.sizes, present.fits)
    return put_together(context, present, present.effects, fits)


def find_needed_together(
    context: Context, whole: FittedModel, present: FittedModel
) -> tuple[Effect, FittedModel] | None:
    """Find the effect that explains most of dropped ones that are needed together; None if there is none.

    Return it with the present model and itself.
    """
    gone = rest = [one for one in whole.effects if one not in present.effects]
    while rest:
        together = list_together(context, rest[0], rest)
        rest = [one for one in rest if one not in together]
        if find_need(context, whole, present, together)[0]:
            tried = [
                (one, leave_out(context, whole, [other for other in gone if other is not one]))
                for one in together
            ]
            return min(tried, key=lambda pair: float(np.sum(pseudo_huber(pair[1].left_out))))
    return None


def list_together(context: Context, effect: Effect, others: Sequence[Effect]) -> list[Effect]:
    """List an effect with those of the others that move what it moves, or what one of these moves."""
    found, rest = [effect], [one for one in others if one is not effect]
    while near := [one for one in rest if not all(are_separate(context, one, known) for known in found)]:
        found, rest = [*found, *near], [one for one in rest if one not in near]
    return found


def find_need(
    context: Context, present: FittedModel, without: FittedModel, effects: Sequence[Effect]
) -> tuple[bool, float]:
    """Return whether left-out motions need effects together, and their improvement over its scatter."""
    joints = sorted({context.joint_of(one) for one in effects})
    joints = [ALL_JOINTS] if ALL_JOINTS in joints else joints
    rows = np.sort(np.concatenate([select_rows(context.model, joint) for joint in joints]))
    fits = [fit for joint in joints for fit in fits_at(context, present, joint)]
    pair = without.left_out[rows], present.left_out[rows]
    residuals = gather_residuals(without.fits, context.model.joint_of.size)
    is_no_chance = find_log_chance(context, fits, effects, residuals) <= np.log(FALSE_ALARM)
    z = improvement_z(context, rows, *pair)
    is_sure = z > MIN_Z or knows_noise(context, rows)
    return improvement_share(context, rows, *pair) >= MIN_SHARE and is_no_chance and is_sure, z


def left_out_gain(selection: Selection, effect: Effect) -> float:
    """Return the share of what can be explained that goes with a finding in left-out motions."""
    context = selection.context
    without = next(model for layer, model in selection.left_out if effect in layer)
    rows = select_rows(context.model, context.joint_of(effect))
    return improvement_share(context, rows, without.left_out[rows], selection.chosen.left_out[rows])


def find_log_chance(
    context: Context, fits: Sequence[JointFit], effects: Sequence[Effect], without: Array
) -> float:
    """Return the logarithm of the probability of effects so strong, beside all others, if none is present.

    It is that of a decrease of known noise, or of Wald tests. For each effect it is multiplied by the number
    of distinct ones that compete (Bonferroni). The noise counts as stationary where repeats show it. Several
    are not due to chance together if one of them is not (Roy 1953): few motions leave a test of all together
    no freedom.
    """
    union, std = context.union, context.model.noise_std
    log_choices = float(np.log(max(context.n_distinct, 1.0)))
    if std:
        rows, after = (np.concatenate([getattr(fit, of) for fit in fits]) for of in ("rows", "residuals"))
        log_p = known_noise_log_p(without[rows] / std, after / std, len(union.columns(effects)))
        return min(0.0, len(effects) * log_choices + log_p)
    is_stationary = all(knows_noise(context, fit.rows) for fit in fits)
    tests = [effects, *([one] for one in effects)] if len(effects) > 1 else [effects]
    least = 0.0
    for tested in tests:
        chance = refit_p(fits, union.columns(tested), without, context.model, context.scales, is_stationary)
        log_p = float(np.log(len(tests) * max(chance, np.finfo(float).tiny)))
        least = min(least, len(tested) * log_choices + log_p)
    return least
