"""Measure which joints effects move, to choose what shares simulations and what is judged at all joints."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Integers
from diagnosis.context import Context, recall, simulate
from diagnosis.effects.effect import Effect
from diagnosis.screening import Trial
from diagnosis.sharing import ALL_JOINTS, find_sharing, measure_reach, relative_reach

MAX_LOCAL: Final = 0.5
"""Largest change at another joint over that at its own for which an effect is judged at its joint alone."""


def share_simulations(context: Context, sizes: Array, residuals: Array, effects: Sequence[Effect]) -> Context:
    """Measure which joints effects move, and choose what shares simulations and what is judged at all joints.

    Args:
        context: The context, with scales.
        sizes: Present sizes, (n_sizes,), in their own units.
        residuals: Their residuals, (n,), in the unit of the model.
        effects: Effects to measure. Those of the base decide which joints share; all do where no base is.

    Returns:
        The context with its sharing, its wide effects and their reach.
    """
    union, model = context.union, context.model
    base = {effect.key for effect in context.base}
    placed = [one for one in effects if one.place in model.joints]
    moved = {one.place for one in context.base}
    columns = [union.columns([effect]) for effect in placed]
    typical = [np.array([np.clip(one.typical, one.low, one.high) for one in e.sizes]) for e in placed]
    reach = recall(_measure_reach, context, (sizes, residuals), list(zip(columns, typical, strict=True)))
    places = [model.joints.index(one.place) for one in placed]
    decides = np.array([one.key in base or one.place not in moved for one in placed], bool)
    wide = {
        one.key
        for one, joint, row in zip(placed, places, reach, strict=True)
        if one.key not in base and relative_reach(joint, row).max(initial=0.0) > MAX_LOCAL
    }
    is_local = np.array([one.key not in wide for one in placed], bool)
    sharing = find_sharing(places, columns, decides & is_local, reach)
    own = {one.key: float(row[joint]) for one, joint, row in zip(placed, places, reach, strict=True)}
    return replace(context, sharing=sharing, wide=frozenset(wide), reach=own)


def _measure_reach(
    context: Context, now: tuple[Array, Array], columns: Sequence[tuple[Integers, Array]]
) -> Array:
    return measure_reach(
        lambda points: simulate(context, [(ALL_JOINTS, point) for point in points], "fit"),
        context.model.joint_of,
        context.scales,
        now,
        columns,
    )


def expected_change(context: Context, lane: int, trial: Trial) -> float:
    """Return the change that a trial should make at its joint, from that of typical sizes.

    Args:
        context: The context.
        lane: Index of the joint, or ALL_JOINTS.
        trial: The trial.

    Returns:
        RMS change over the scale of the joint, without a unit.
    """
    if lane == ALL_JOINTS:
        return 0.0
    typical = np.array([size.typical for size in trial.effect.sizes])
    ratios = np.array(trial.points)[:, context.union.columns([trial.effect])] / typical
    return context.reach.get(trial.effect.key, 0.0) * float(np.max(np.abs(ratios)))
