"""Accept an effect: it predicts motions that took no part better, and harms no other joint."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect
from simgap.residuals.loss import pseudo_huber
from simgap.selection.comparison import improvement_z
from simgap.selection.context import Context, FittedModel, simulate
from simgap.selection.fit import Fit, gather_residuals
from simgap.selection.sharing import ALL_JOINTS

MIN_SHARE: Final = 0.05
"""Least share of the error of left-out motions that an effect has to remove: less is not worth a name."""
MIN_Z: Final = 2.0
"""Least improvement of left-out motions over its scatter, beside all other effects, where no repeats show the
noise."""
FIRST_CHANCE: Final = 0.5
"""Largest probability of an effect that is taken before others are known, if none is present: it is rather
there than not. Of two effects that hide each other, one has to be first."""
MAX_WORSE: Final = 0.10
"""Largest share by which an effect may worsen another joint."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """Effect that was refitted and judged by motions that took no part."""

    effect: Effect
    joints: tuple[int, ...]
    """Joints at which it was judged."""
    fit: Fit
    left_out: Array
    """Residuals of the fit when their motion was left out, over the scale of their joint, (n_rows,)."""
    at_bound: bool
    """True if a size ends at a bound, or is not plausible beside the others."""
    gain: float
    """Share of what can be explained in left-out motions that it removes."""
    log_chance: float
    """Natural logarithm of the probability of so strong an effect if none is present."""


def choose(context: Context, present: FittedModel, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Choose the best effect of each joint, or one at a body if it does more than they do.

    Args:
        candidates: Effects that were judged.

    Returns:
        Effects to accept; no two for one joint.
    """
    good = [one for one in candidates if one.gain >= MIN_SHARE and one.log_chance <= np.log(FIRST_CHANCE)]
    good = [one for one in good if not one.at_bound]
    good = [one for one in good if not worsens_another(context, present, one)]
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


def choose_simplest(context: Context, candidates: Sequence[Candidate]) -> Candidate:
    """Choose the effect with the fewest sizes among those that do as well as the best.

    As well means within one standard error of the best, in pairs (Breiman and others 1984). Where the noise
    is known, the chance of an effect counts its sizes.

    Args:
        candidates: Effects for the same joints.

    Returns:
        The effect; of several with as few sizes the best.
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
    return min(alike, key=lambda one: (len(one.effect.sizes), -one.gain))


def _improvement(context: Context, present: FittedModel, candidate: Candidate) -> float:
    """Return the decrease of the mean loss, summed over the joints of a candidate."""
    rows = candidate.fit.rows
    change = pseudo_huber(present.left_out[rows]) - pseudo_huber(candidate.left_out)
    joint = context.model.joint_of[rows]
    return float(np.sum(np.bincount(joint, weights=change) / np.maximum(np.bincount(joint), 1)))


def worsens_another(context: Context, present: FittedModel, candidate: Candidate) -> bool:
    """Check whether an effect worsens a joint that is not its place.

    Args:
        candidate: The effect.

    Returns:
        True if the mean absolute residual of another joint grows by more than MAX_WORSE.
    """
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
