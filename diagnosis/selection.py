"""Select the effects that the motions need: screen, refit a shortlist, accept by motions that were left out.

Effects at different joints are selected side by side. An effect at a body competes with them for all joints.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from diagnosis.acceptance import MIN_SHARE, MIN_Z, Candidate, choose
from diagnosis.arrays import Array
from diagnosis.chance import FALSE_ALARM, count_distinct
from diagnosis.checkpoint import Checkpoint
from diagnosis.comparison import compare
from diagnosis.context import Context, Present, Selection, recall, run, simulate, start_context
from diagnosis.effects.effect import Effect
from diagnosis.fit import Fit, Hypothesis, gather_residuals, pseudo_huber
from diagnosis.joint_fits import (
    cross_validate,
    cut_anew,
    fit_base,
    fit_joints,
    free_columns,
    joints_of,
    leave_out,
    left_out_losses,
    list_layers,
    merge_sizes,
    rescale,
    step_without,
)
from diagnosis.meter import Meter
from diagnosis.reach import expected_change
from diagnosis.residuals import ResidualModel
from diagnosis.screening import (
    Score,
    Trial,
    Whitened,
    list_trials,
    refit_p,
    score_effect,
    whiten,
)
from diagnosis.sharing import ALL_JOINTS

MAX_EFFECTS: Final = 3
"""Most effects at one joint beside the base parameters: more describe a residual rather than explain it."""
SHORTLIST: Final = 8
"""Effects of a joint that are refitted in a round: a third of its catalogue."""
FINALISTS: Final = 4
"""Effects of a joint that are refitted to the end and judged: the best half after a few iterations."""
FEW_ITERATIONS: Final = 3
"""Iterations before the worse half is given up: less than half of what refits need, six to nine."""
ROUNDS: Final = 2
"""Turns between an effect at a body and the joints that it loads."""


def select_effects(
    model: ResidualModel,
    base: Sequence[Effect],
    catalogue: Sequence[Effect],
    *,
    seed: int,
    meter: Meter | None = None,
    checkpoint: Checkpoint | None = None,
) -> Selection:
    """Find the effects that motions need beyond the base parameters.

    Args:
        model: Residuals of the motions that are fitted.
        base: Effects that every model has: nuisance parameters with priors.
        catalogue: Effects that compete.
        seed: Seed of the folds.
        meter: Tells the progress; None: nobody is told.
        checkpoint: Keeps the results of steps; None: nothing is kept.

    Returns:
        The models before and after.
    """
    context, first = fit_base(start_context(model, base, catalogue, seed, meter or Meter(), checkpoint))
    present = first
    open_joints = {int(j) for j in np.unique(model.joint_of)}
    while open_joints:
        n_layers = len(list_layers(context, present.effects))
        # a first finding is expected, and a round without another; then each layer is left out once
        shortlist, n_distinct = recall(screen, context, present, open_joints, rounds_after=n_layers or 2)
        if present is first:  # later rounds screen fewer effects, but all have competed
            context = replace(context, n_distinct=n_distinct)
        context, present = cut_anew(context, present, shortlist)
        winners = recall(_find_winners, context, present, shortlist)
        open_joints &= {j for winner in winners for j in winner.joints}
        for winner in winners:
            present = accept(context, present, winner)
        if winners:
            context, present = rescale(context, first, present)
        open_joints -= {j for j in open_joints if count_effects(context, present, j) >= MAX_EFFECTS}
    return Selection(context, first, drop_needless(context, present))


def screen(
    context: Context, present: Present, open_joints: set[int], rounds_after: int
) -> tuple[list[Score], float]:
    """Simulate every effect at a few sizes, and keep the best of each place.

    Args:
        context: The context.
        present: The present model.
        open_joints: Joints at which effects are still looked for.
        rounds_after: Rounds that are expected after this one, for the progress.

    Returns:
        At most SHORTLIST scores of a joint, and as many of all bodies; and how many effects are distinct.
    """
    names = context.model.joints
    taken = {effect.key for effect in present.effects}
    rivals = [effect for effect in context.catalogue if effect.key not in taken]
    groups: list[tuple[tuple[int, ...], int, list[Effect]]] = [
        ((j,), j, [one for one in rivals if context.joint_of(one) == j]) for j in sorted(open_joints)
    ]
    bodies = [one for one in rivals if context.joint_of(one) == ALL_JOINTS]
    groups.append((tuple(range(len(names))), ALL_JOINTS, bodies))
    trials = [
        (lane, trial)
        for _, lane, effects in groups
        for effect in effects
        for trial in list_trials(context.union, effect, present.sizes)
    ]
    # a large change at one joint would hide a small one at another in the same candidate
    trials.sort(key=lambda pair: -expected_change(context, *pair))
    points = [(lane, point) for lane, trial in trials for point in trial.points]
    context.meter.begin_round(len(context.sharing.plan(points)), rounds_after)
    moved = iter(simulate(context, points, "screening"))
    tried: dict[tuple[int, str], list[tuple[Trial, list[Array]]]] = {}
    for lane, trial in trials:
        simulated = [next(moved) for _ in trial.points]
        tried.setdefault((lane, trial.effect.key), []).append((trial, simulated))
    best: dict[int, list[Score]] = {lane: [] for _, lane, _ in groups}
    directions: dict[int, list[Array]] = {lane: [] for _, lane, _ in groups}
    white = {lane: _whiten(context, present, joints) for joints, lane, _ in groups}
    for (lane, _), of_effect in tried.items():
        now = _residuals(context, present, lane)
        changes = [np.column_stack([rows - now for rows in simulated]) for _, simulated in of_effect]
        if lane == ALL_JOINTS:
            changes = [change[white[lane].rows] for change in changes]
        own = [trial for trial, _ in of_effect]
        score, direction = score_effect(white[lane], own, changes, present.sizes)
        best[lane].append(score)
        directions[lane].append(direction)
    # the order of the F statistic: an effect with many sizes has to explain more
    ranked = [sorted(group, key=lambda s: -s.gain / len(s.effect.sizes)) for group in best.values()]
    n_distinct = sum(count_distinct(group) for group in directions.values())
    return [score for group in ranked for score in group[:SHORTLIST]], n_distinct


def _find_winners(context: Context, present: Present, shortlist: Sequence[Score]) -> list[Candidate]:
    return choose(context, present, judge(context, present, shortlist))


def _whiten(context: Context, present: Present, joints: Sequence[int]) -> Whitened:
    fits = [present.fits[j] for j in joints]
    return whiten(fits, context.model, [float(context.scales[j]) for j in joints])


def _residuals(context: Context, present: Present, lane: int) -> Array:
    if lane != ALL_JOINTS:
        return present.fits[lane].residuals
    return gather_residuals(present.fits, len(context.model.joint_of))


def judge(
    context: Context, present: Present, shortlist: Sequence[Score], wanted: Sequence[str] = ()
) -> list[Candidate]:
    """Refit the shortlist with the base parameters, with all motions and without each fold.

    Args:
        context: The context.
        present: The present model.
        shortlist: Effects, and the sizes from which they start.
        wanted: Keys of effects that are refitted to the end, however they begin.

    Returns:
        The finalists, in the order of the shortlist, and the effects at bodies.
    """
    joints = [context.joint_of(score.effect) for score in shortlist]
    local = [score for score, joint in zip(shortlist, joints, strict=True) if joint != ALL_JOINTS]
    joints = [joint for joint in joints if joint != ALL_JOINTS]
    starts = [
        Hypothesis(free_columns(context, (*present.effects, score.effect), joint), score.start, joint)
        for score, joint in zip(local, joints, strict=True)
    ]
    keep = [score.effect.key in wanted for score in local]
    begun = run(context, starts, "refit", iterations=FEW_ITERATIONS)
    chosen = _choose_finalists(context, joints, begun, keep)
    local, joints = [local[k] for k in chosen], [joints[k] for k in chosen]
    again = [replace(starts[k], start=begun[k].sizes) for k in chosen]
    fits = run(context, again, "refit")
    scores = cross_validate(context, list(zip(joints, fits, strict=True)))
    candidates = [
        _candidate(context, present, one, (joint,), (fit,), losses[None])
        for one, joint, fit, losses in zip(local, joints, fits, scores, strict=True)
    ]
    bodies = [score for score in shortlist if context.joint_of(score.effect) == ALL_JOINTS]
    return candidates + [_judge_body(context, present, score) for score in bodies]


def _choose_finalists(
    context: Context, joints: Sequence[int], fits: Sequence[Fit], keep: Sequence[bool]
) -> list[int]:
    """Return the indices of the best FINALISTS of each joint, and of those to keep."""
    loss = [
        float(np.sum(pseudo_huber(fit.residuals / context.scales[j])))
        for j, fit in zip(joints, fits, strict=True)
    ]
    rank = [
        sum(loss[m] < loss[k] for m in range(len(loss)) if joints[m] == joints[k]) for k in range(len(loss))
    ]
    return [k for k in range(len(loss)) if rank[k] < FINALISTS or keep[k]]


def _judge_body(context: Context, present: Present, score: Score) -> Candidate:
    effects = (*present.effects, score.effect)
    whole, fits = fit_body(context, effects, score.effect, score.start)
    points = []
    for fold in context.folds:
        steps = [replace(fit, sizes=step_without(context, fit, fold)) for fit in fits]
        body = replace(whole, sizes=step_without(context, whole, fold))
        points.append((ALL_JOINTS, merge_sizes(context, whole.sizes, [*steps, body])))
    rows = simulate(context, points, "cross-validation")
    scores = np.array([left_out_losses(context, fit.rows, [row[fit.rows] for row in rows]) for fit in fits])
    return _candidate(context, present, score, tuple(range(len(fits))), fits, scores)


def fit_body(
    context: Context, effects: Sequence[Effect], body: Effect, sizes: Array
) -> tuple[Fit, tuple[Fit, ...]]:
    """Fit an effect at a body and the sizes of all joints by turns.

    Args:
        context: The context.
        effects: Accepted effects, with that of the body.
        body: Effect at a body.
        sizes: Sizes at the start, (n_sizes,), in their own units.

    Returns:
        The fit of the body, and one a joint, which have the sizes of the body too.
    """
    for _ in range(ROUNDS):
        (whole,) = run(context, [Hypothesis(context.union.columns([body]), sizes, ALL_JOINTS)], "refit")
        fits = fit_joints(context, effects, whole.sizes)
        sizes = merge_sizes(context, whole.sizes, fits)
    return whole, fits


def _candidate(
    context: Context,
    present: Present,
    score: Score,
    joints: tuple[int, ...],
    fits: tuple[Fit, ...],
    scores: Array,
) -> Candidate:
    effect = score.effect
    own = context.union.columns([effect])
    sizes = present.sizes.copy()
    sizes[own] = fits[0].sizes[own]
    sizes = merge_sizes(context, sizes, fits)
    gain, z = compare(context, joints, present.scores[list(joints)], scores)
    bounds = [(context.union.sizes[c].low, context.union.sizes[c].high) for c in own]
    others = {
        one.name: sizes[context.union.columns([one])]
        for one in (*context.base, *present.effects)
        if one.place == effect.place
    }
    at_bound = not effect.is_plausible(sizes[own], others) or any(
        sizes[c] != 0.0 and min(sizes[c] - low, high - sizes[c]) < 1e-3 * (high - low)
        for c, (low, high) in zip(own, bounds, strict=True)
    )
    return Candidate(effect, joints, sizes, fits, scores, at_bound, gain, z)


def accept(context: Context, present: Present, candidate: Candidate) -> Present:
    """Add an effect to the present model.

    Args:
        context: The context.
        present: The present model.
        candidate: The effect.

    Returns:
        The model with the effect, whose other fits `rescale` has to renew.
    """
    own = [*(int(c) for c in context.union.columns([candidate.effect]))]
    own += [int(c) for fit in candidate.fits for c in fit.columns]
    sizes, scores, fits = present.sizes.copy(), present.scores.copy(), list(present.fits)
    sizes[own] = candidate.sizes[own]
    for k, j in enumerate(candidate.joints):
        scores[j], fits[j] = candidate.scores[k], candidate.fits[k]
    return Present((*present.effects, candidate.effect), sizes, tuple(fits), scores, present.bodies)


def drop_needless(context: Context, present: Present) -> Present:
    """Drop effects, the weakest first, until left-out motions need each of them and none is due to chance.

    Args:
        context: The context.
        present: The model with all accepted effects.

    Returns:
        The model with those that it needs.
    """
    while True:
        weakest: dict[int, tuple[float, Effect]] = {}
        for layer in list_layers(context, present.effects):
            without = leave_out(context, present, layer)
            for effect in layer:
                joints = list(joints_of(context, effect))
                gain, z = compare(context, joints, without.scores[joints], present.scores[joints])
                joint = context.joint_of(effect)
                is_needed = (
                    gain >= MIN_SHARE and z > MIN_Z and find_chance(context, present, effect) <= FALSE_ALARM
                )
                if not is_needed and z < weakest.get(joint, (np.inf, effect))[0]:
                    weakest[joint] = z, effect
        if not weakest:
            return present
        present = leave_out(context, present, [effect for _, effect in weakest.values()])


def find_chance(context: Context, present: Present, effect: Effect) -> float:
    """Return the probability of so strong an effect, beside all others, if none is present.

    Args:
        context: The context.
        present: A model with the effect.
        effect: The effect.

    Returns:
        Probability by a Wald test, times the number of distinct effects that compete (Bonferroni).
    """
    own, joints = context.union.columns([effect]), joints_of(context, effect)
    body = next((fit for fit in present.bodies if own[0] in fit.columns), None)
    scales = [float(context.scales[j]) for j in joints]
    chance = refit_p([present.fits[j] for j in joints], body, own, context.model, scales)
    return min(1.0, context.n_distinct * chance)


def count_effects(context: Context, present: Present, joint: int) -> int:
    """Count the accepted effects that are judged at a joint alone.

    Args:
        context: The context.
        present: The present model.
        joint: Index of the joint.

    Returns:
        Number of effects.
    """
    return sum(context.joint_of(one) == joint for one in present.effects)
