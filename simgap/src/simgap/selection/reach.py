"""Measure which joints effects move, to choose what shares simulations and what is judged at all joints."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.residuals.residuals import ResidualModel
from simgap.selection.context import Context, list_joints, resume_step, simulate
from simgap.selection.screening import Trial
from simgap.selection.sharing import ALL_JOINTS, find_sharing, relative_reach

MAX_LOCAL: Final = 0.5
"""Largest change at another joint over that at its own for which an effect is judged at its joint alone."""
AT_ONCE: Final = 32
"""Candidates whose residuals are kept at once: those of long logs are large."""


def share_simulations(context: Context, sizes: Array, effects: Sequence[Effect]) -> Context:
    """Measure which joints effects move, and choose what shares simulations and what is judged at all joints.

    Args:
        context: The context, with scales.
        sizes: Present sizes, (n_sizes,), in their own units.
        effects: Effects to measure. Those of the base decide which joints share; all do where no base is.

    Returns:
        The context with its sharing, and the reach of the effects.
    """
    union, model = context.union, context.model
    base = {effect.key for effect in context.base}
    placed = [one for one in effects if one.place in model.joints]
    moved = {one.place for one in context.base}
    columns = [union.columns([effect]) for effect in placed]
    typical = [np.array([np.clip(one.typical, one.low, one.high) for one in e.sizes]) for e in placed]
    reach = resume_step(measure_reach, context, sizes, list(zip(columns, typical, strict=True)))
    joints = [model.joints.index(one.place) for one in placed]
    decides = np.array([one.key in base or one.place not in moved for one in placed], bool)
    everywhere = {
        one.key
        for one, joint, row in zip(placed, joints, reach, strict=True)
        if one.key not in base and relative_reach(joint, row).max(initial=0.0) > MAX_LOCAL
    }
    is_local = np.array([one.key not in everywhere for one in placed], bool)
    sharing = find_sharing(joints, columns, decides & is_local, reach, list_joints(model, union, everywhere))
    own = {one.key: float(row[joint]) for one, joint, row in zip(placed, joints, reach, strict=True)}
    return replace(context, sharing=sharing, reach=own)


def measure_reach(context: Context, sizes: Array, columns: Sequence[tuple[Integers, Array]]) -> Array:
    """Measure how much effects of typical size move each joint, in the motions in which joints move most.

    Args:
        context: The context, with scales.
        sizes: Present sizes, (n_sizes,), in their own units.
        columns: For each effect the columns of its sizes and its typical sizes, (n_own,), in their units.

    Returns:
        RMS changes over the scales, (n_effects, n_joints), without a unit.
    """
    model, n_joints = context.model.select(list_fastest_motions(context.model)), len(context.scales)
    count = np.maximum(np.bincount(model.joint_of, minlength=n_joints), 1)
    points = []
    for free, typical in columns:
        point = sizes.copy()
        point[free] = typical
        points.append((ALL_JOINTS, point))
    part = replace(context, model=model)
    (now,) = simulate(part, [(ALL_JOINTS, sizes)], "fit")
    reach = []
    for first in range(0, len(points), AT_ONCE):
        for moved in simulate(part, points[first : first + AT_ONCE], "fit"):
            square = np.bincount(model.joint_of, weights=(moved - now) ** 2, minlength=n_joints)
            reach.append(np.sqrt(square / count) / context.scales)
    return np.array(reach).reshape(-1, n_joints)


def list_fastest_motions(model: ResidualModel) -> list[str]:
    """List, for each joint, the motion in which it moves fastest.

    Returns:
        Names of motions, without repetition.
    """
    square = np.nan_to_num(model.explain("velocity") ** 2)
    shape = len(model.joints), len(model.motions)
    cell = model.joint_of * shape[1] + model.motion_of
    total = np.bincount(cell, weights=square, minlength=shape[0] * shape[1])
    count = np.bincount(cell, minlength=shape[0] * shape[1])
    speed = (total / np.maximum(count, 1)).reshape(shape)
    return [model.motions[k] for k in np.unique(np.argmax(speed, axis=1))]


def expected_change(context: Context, joint: int, trial: Trial) -> float:
    """Return the change that a trial should make at its joint, from that of typical sizes.

    Args:
        joint: Index of the joint, or ALL_JOINTS.

    Returns:
        RMS change over the scale of the joint, without a unit.
    """
    if joint == ALL_JOINTS:
        return 0.0
    typical = np.array([size.typical for size in trial.effect.sizes])
    ratios = np.array(trial.points)[:, context.union.columns([trial.effect])] / typical
    return context.reach.get(trial.effect.key, 0.0) * float(np.max(np.abs(ratios)))
