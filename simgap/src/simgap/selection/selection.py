"""Select the effects that the motions need: screen, refit a shortlist, accept by motions that were left out.

Effects at different joints are selected side by side. An effect at a body competes with them for all joints.

`without` has the residuals of a model without an effect, (n,), in the unit of the residual model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.effects.variation import steady_effect
from simgap.residuals.conditioned import Change
from simgap.residuals.noise import count_independent
from simgap.residuals.residuals import ResidualModel
from simgap.selection.acceptance import (
    MIN_SHARE,
    Candidate,
    choose,
    cross_validate_each,
    explainable_loss,
    improvement_share,
    robust_loss,
)
from simgap.selection.chance import count_distinct
from simgap.selection.checkpoint import Checkpoint, Meter
from simgap.selection.context import (
    Context,
    FittedModel,
    Score,
    Selection,
    resume_step,
    simulate,
    start_context,
    start_fitting,
)
from simgap.selection.descent import Descent
from simgap.selection.elimination import drop_needless, find_log_chance
from simgap.selection.fit import Hypothesis, JointFit, gather_residuals
from simgap.selection.joint_fits import (
    add_effects,
    fit_base,
    fits_at,
    joints_of,
    merge_findings,
    recut_blocks,
    start_fit,
)
from simgap.selection.screening import (
    SHORTLIST,
    Trial,
    Whitened,
    adjust,
    expect_round,
    expected_change,
    group_effects,
    list_points,
    list_typical,
    score_effect,
    try_next,
    whiten,
)
from simgap.selection.sharing import ALL_JOINTS

FINALISTS: Final = 4
"""Effects of a joint that are refitted to the end and judged. In 20 sealed cases of robots, the accepted one
was the fourth at worst."""
ROUNDING: Final = 1e-12
"""Change over the largest residual below which it is rounding."""


def select_effects(
    model: ResidualModel,
    base: Sequence[Effect],
    catalogue: Sequence[Effect],
    *,
    seed: int,
    n_kinds: int = 1,
    meter: Meter | None = None,
    checkpoint: Checkpoint | None = None,
) -> Selection:
    """Find the effects that motions need beyond the base: nuisance parameters with priors, in every model.

    All `n_kinds` kinds of residual in which effects are looked for share the probability of chance.
    """
    context, first = fit_base(start_context(model, base, catalogue, seed, meter or Meter(), checkpoint))
    if not context.catalogue:
        return Selection(context, first, first, (), {})
    present = first
    finalists: list[Score] = []
    refitted: dict[str, Score] = {}
    competitors: dict[str, tuple[Score, ...]] = {}
    open_joints = {int(j) for j in np.unique(model.joint_of)}
    while open_joints:
        # a first finding is expected, a round without another, and half of one to leave findings out
        after = 1.5 if present is first else 0.5
        shortlist, n_distinct = resume_step(screen, context, present, open_joints, rounds_after=after)
        if present is first:  # later rounds screen fewer effects, but all have competed
            context = replace(context, n_distinct=n_kinds * n_distinct)
        context, present = recut_blocks(context, present, shortlist)
        again = list_again(context, present, open_joints, shortlist, finalists)
        winners, finalists = resume_step(find_winners, context, present, [*shortlist, *again])
        refitted |= {score.effect.key: score for score in finalists}
        competitors |= {one.effect.key: _list_competitors(context, one, refitted) for one in winners}
        open_joints &= {j for winner in winners for j in winner.joints}
        if winners:
            effects, fits = [one.effect for one in winners], [one.fit for one in winners]
            context, present = add_effects(context, first, present, effects, fits)
            if merged := merge_findings(context, present):
                present, others = merged
                competitors[present.effects[-1].key] = others
    context.meter.end_rounds()
    chosen, left_out, kept = drop_needless(context, present)
    return Selection(context, first, chosen, left_out, competitors, kept)


def list_again(
    context: Context,
    present: FittedModel,
    open_joints: set[int],
    shortlist: Sequence[Score],
    finalists: Sequence[Score],
) -> list[Score]:
    """List effects of open joints that helped in the round before, but that the screen has not found again.

    Where the present model is far from the motions, the screen ranks worse than a refit. Finalists have the
    sizes of that round, at which each starts, and the share that they removed. None is in the present model.
    """
    known = {one.effect.key for one in shortlist} | {effect.key for effect in present.effects}
    again = []
    for one in finalists:
        is_open = context.joint_of(one.effect) in {*open_joints, ALL_JOINTS}
        if one.gain >= MIN_SHARE and is_open and one.effect.key not in known:
            # its base parameters were fitted with it, and go with it
            is_own = context.sharing.list_fitted(context.joint_of(one.effect)) & (one.start != 0.0)
            again.append(replace(one, start=np.where(is_own, one.start, present.sizes)))
    return again


def _list_competitors(context: Context, winner: Candidate, refitted: dict[str, Score]) -> tuple[Score, ...]:
    """List the effects, refitted so far, that are judged at a joint of the winner."""
    joints = {*winner.joints, ALL_JOINTS}
    everywhere = len(winner.joints) > 1
    return tuple(one for one in refitted.values() if everywhere or context.joint_of(one.effect) in joints)


def screen(
    context: Context, present: FittedModel, open_joints: set[int], rounds_after: float
) -> tuple[list[Score], float]:
    """Simulate every effect at a few sizes, and keep the SHORTLIST best of each joint, and of all bodies.

    Return also how many effects are distinct.
    """
    groups, at = group_effects(context, open_joints, {one.key for one in present.effects}), present.sizes
    context.meter.begin_round(expect_round(context, groups, at), rounds_after)
    fits = {joint: fits_at(context, present, joint) for joint in groups}
    white = {joint: whiten(of_joint, context.model, context.scales) for joint, of_joint in fits.items()}
    tried = try_sizes(context, fits, white, list_typical(context, groups, at), at)
    scores: dict[int, list[tuple[Score, Array, Array]]] = {joint: [] for joint in groups}
    for joint, trials, changes in tried:
        scores[joint].append(score_effect(white[joint], trials, changes, at))
    shortlist = [
        one
        for joint, of_joint in scores.items()
        for one in list_best(rank_effects(context, white[joint].rows, of_joint))
    ]
    count = len if context.model.noise_std else count_distinct  # probabilities are exact then
    n_distinct = sum(count([direction for _, direction, _ in of_joint]) for of_joint in scores.values())
    return shortlist, float(n_distinct)


def rank_effects(
    context: Context, rows: Integers, scores: Sequence[tuple[Score, Array, Array]]
) -> list[Score]:
    """Rank effects of a joint by the share that each explains, less what its sizes explain of noise.

    Each has a score, its largest change, and what it leaves in the rows, as `score_effect` returns them.
    """
    if not scores:
        return []
    # a misfit that the best effect explains is no memory of the noise
    _, _, rest = max(scores, key=lambda one: one[0].gain)
    n = count_independent(context.model, rows, rest)
    return sorted((one for one, *_ in scores), key=lambda one: -adjust(one.gain, len(one.effect.sizes), n))


def list_best(ranked: Sequence[Score]) -> list[Score]:
    """List the first SHORTLIST effects of a ranking with their variations: a refit tells them apart."""
    steady = [steady_effect(one.effect) for one in ranked]
    first = [*dict.fromkeys(one.key for one in steady)][:SHORTLIST]
    return [score for score, one in zip(ranked, steady, strict=True) if one.key in first]


def try_sizes(
    context: Context,
    fits: Mapping[int, Sequence[JointFit]],
    white: Mapping[int, Whitened],
    first: Sequence[tuple[int, Trial]],
    at: Array,
) -> list[tuple[int, list[Trial], list[Array]]]:
    """Simulate effects at sizes that follow from what smaller or larger ones have changed.

    Return for each first trial its joint, all trials of its effect, and what they change in the residuals.
    """
    tried: list[tuple[int, list[Trial], list[Array]]] = [(joint, [], []) for joint, _ in first]
    wanted: dict[int, Trial | None] = {k: trial for k, (_, trial) in enumerate(first)}
    while following := {k: trial for k, trial in wanted.items() if trial is not None}:
        found = simulate_trials(context, fits, [(first[k][0], trial) for k, trial in following.items()])
        wanted = {}
        for (k, trial), change in zip(following.items(), found, strict=True):
            joint, trials, changes = tried[k]
            trials.append(trial)
            changes.append(change)
            wanted[k] = try_next(context.union, white[joint], at, trials, changes)
    return tried


def simulate_trials(
    context: Context, fits: Mapping[int, Sequence[JointFit]], trials: Sequence[tuple[int, Trial]]
) -> list[Array]:
    """Simulate trials, each at its joint; return what each changes in the residuals, (n_rows, n_points)."""
    # a large change at one joint would hide a small one at another in the same candidate
    order = sorted(range(len(trials)), key=lambda k: -expected_change(context, *trials[k]))
    moved = iter(simulate(context, list_points([trials[k] for k in order]), "screening"))
    changes: dict[int, Array] = {}
    for k in order:
        joint, trial = trials[k]
        now = np.concatenate([fit.residuals for fit in fits[joint]])
        simulated = [next(moved) for _ in trial.points]
        change = np.column_stack([rows - now for rows in _order(simulated, fits[joint])])
        # another batch may change the last bit
        changes[k] = np.where(np.abs(change) > ROUNDING * np.max(np.abs(now)), change, 0.0)
    return [changes[k] for k in range(len(trials))]


def _order(simulated: Sequence[Array], fits: Sequence[JointFit]) -> Sequence[Array]:
    """Bring residuals of all joints into the order of the fits of several joints."""
    if len(fits) == 1:
        return simulated
    rows = np.concatenate([fit.rows for fit in fits])
    return [moved[rows] for moved in simulated]


def find_winners(
    context: Context, present: FittedModel, shortlist: Sequence[Score]
) -> tuple[list[Candidate], list[Score]]:
    """Refit the shortlist, and choose what is accepted; return also what competes with it, with its sizes.

    This is all that was refitted to the end and, with a gain of 0, the others that are hopeful.
    """
    # one by one, as the derivatives of all would fill the memory
    hypotheses = (start_refit(context, present, score) for score in shortlist)
    fitting = start_fitting(context, hypotheses, "refit")

    def list_effects() -> list[Effect]:
        return [shortlist[k].effect for k in fitting.places]

    fitting.compete(lambda share: list_hopeful(context, present, list_effects(), fitting.descents, share))
    effects = list_effects()
    joints = [fit.joint for fit in fitting.descents]
    kept = [k for k, joint in enumerate(joints) if joints[:k].count(joint) < FINALISTS]
    others = [Score(effects[k], fit.sizes, 0.0) for k, fit in enumerate(fitting.descents) if k not in kept]
    fitting.keep(kept)
    candidates = judge(context, present, [effects[k] for k in kept], fitting.finish())
    finalists = [Score(one.effect, one.fit.sizes, one.gain) for one in candidates]
    return choose_alone(context, present, candidates), [*finalists, *others]


def choose_alone(context: Context, present: FittedModel, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Choose effects that are still the best when each is simulated alone.

    Effects at several joints were fitted in shared candidates: what one does may have been another's.
    """
    alone = replace(context, sharing=context.sharing.alone())
    shared = {joint for group in context.sharing.groups if len(group) > 1 for joint in group}
    judged: dict[str, Candidate] = {}
    while True:
        chosen = choose(context, present, [judged.get(one.effect.key, one) for one in candidates])
        new = [one for one in chosen if one.fit.joint in shared and one.effect.key not in judged]
        if not new:
            return chosen
        residuals = simulate(alone, [(one.fit.joint, one.fit.sizes) for one in new], "refit")
        fits = [replace(one.fit, residuals=rows) for one, rows in zip(new, residuals, strict=True)]
        judged |= {one.effect.key: one for one in judge(alone, present, [one.effect for one in new], fits)}


def list_hopeful(
    context: Context, present: FittedModel, effects: Sequence[Effect], fits: Sequence[Descent], share: float
) -> list[int]:
    """List places, best first, of fits that explain a share of what is needed and of their joint's best."""
    without, rows_of = (
        gather_residuals(present.fits, context.model.joint_of.size),
        {one.joint: one.rows for one in fits},
    )
    explained = [explain_loss(context, fit, without) for fit in fits]
    needed = {
        joint: MIN_SHARE * explainable_loss(context, rows, present.left_out[rows])
        for joint, rows in rows_of.items()
    }
    for fit, effect, own in zip(fits, effects, explained, strict=True):
        if own > needed[fit.joint] and not is_at_bound(context, present.effects, effect, fit):
            needed[fit.joint] = own
    hopeful = [k for k, fit in enumerate(fits) if explained[k] > share * max(needed[fit.joint], 0.0)]
    return sorted(hopeful, key=lambda k: -explained[k])


def explain_loss(context: Context, fit: JointFit | Descent, without: Array) -> float:
    """Return by how much a fit decreases the loss of its joints."""
    before = robust_loss(context, fit.rows, without[fit.rows])
    return before - robust_loss(context, fit.rows, fit.residuals)


def start_refit(context: Context, present: FittedModel, score: Score) -> Hypothesis:
    """Return the hypothesis of an effect with the base parameters and the accepted effects of its joint."""
    effects, joint = (*present.effects, score.effect), context.joint_of(score.effect)
    return start_fit(context, effects, joint, score.start, present.fits)


def judge(
    context: Context, present: FittedModel, effects: Sequence[Effect], fits: Sequence[JointFit]
) -> list[Candidate]:
    """Judge effects by refits without each fold."""
    candidates, without = [], gather_residuals(present.fits, context.model.joint_of.size)
    for effect, fit, left_out in zip(effects, fits, cross_validate_each(context, fits), strict=True):
        gain = improvement_share(context, fit.rows, present.left_out[fit.rows], left_out)
        log_chance = find_log_chance(context, [fit], [effect], without)
        at_bound = is_at_bound(context, present.effects, effect, fit)
        candidates.append(
            Candidate(effect, joints_of(context, effect), fit, left_out, at_bound, gain, log_chance)
        )
    return candidates


def is_at_bound(context: Context, others: Sequence[Effect], effect: Effect, fit: JointFit | Descent) -> bool:
    """Check whether a size of an effect ends at a bound, is not plausible, or is too small to be simulated.

    A simulation works in steps: a delay of less than half a step is none in it. That a known effect is gone
    is no bound of its change.
    """
    own = fit.sizes[context.union.columns([effect])]
    beside = {
        one.name: fit.sizes[context.union.columns([one])]
        for one in (*context.base, *others)
        if one.place == effect.place
    }
    half_step = [0.5 * context.model.step_s if size.name == "delay_s" else 0.0 for size in effect.sizes]
    if np.any(np.abs(own) < half_step) or not effect.is_plausible(own, beside):
        return True
    low, high = np.array([(size.low, size.high) for size in effect.sizes]).T
    room = 1e-3 * (high - low)
    is_gone = np.abs(own + effect.known) <= room if isinstance(effect, Change) else own == 0.0
    return bool(np.any(~is_gone & (np.minimum(own - low, high - own) < room)))
