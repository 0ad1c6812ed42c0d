"""Rank effects by the share of the residual that they would explain, from a few simulations without a fit.

Each effect is simulated at several sizes: the derivative at size 0 says nothing of a velocity limit. Its
change, cleared of what the base parameters can do, is held against the residual motion by motion.

Sizes, and `at`, are those of the union in the present model, each in its own unit, (n_sizes,). Residuals are
(n,) in the unit of the model, and scales (n_joints,).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers, orthonormal
from simgap.effects.effect import Effect
from simgap.effects.variation import steady_effect
from simgap.residuals.noise import Blocks, cut_rows
from simgap.residuals.residuals import ResidualModel, root_weight
from simgap.selection.chance import stationary_p, wald_p
from simgap.selection.context import Context, Score, list_joints, resume_step, simulate
from simgap.selection.fit import JointFit, Union
from simgap.selection.sharing import ALL_JOINTS, Point, find_sharing, relative_reach

WIDEST: Final = 3.0
"""Largest factor, up or down, from the typical size of an effect to the second size that is tried."""
MOST_TRIALS: Final = 4
"""Most sizes of an effect that are tried. Two halvings of the logarithm of WIDEST find the onset of a limit
within a third."""
LEAST_SHARE: Final = 0.3
"""Least share of a tried size from which a fit starts: one over WIDEST, rounded."""
SHORTLIST: Final = 8
"""Effects of a joint that are refitted in a round: a third of its catalogue. In 20 sealed cases of robots,
what was then accepted was sixth in the screen at worst."""
REFIT_COST: Final = 7
"""Candidates that an effect of the shortlist takes, as measured; for the progress alone."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Sizes at which an effect is simulated, and the columns that they stand for."""

    effect: Effect
    points: tuple[Array, ...]
    """One size vector of the union for each direction, (n_sizes,) each."""


def try_typical(union: Union, effect: Effect, at: Array) -> Trial | None:
    """Return the trial of an effect at its typical sizes, one direction each; None if bounds forbid them."""
    amounts = []
    for size in effect.sizes:
        is_free = size.high >= min(size.typical, -size.low)
        amounts.append(size.typical if is_free else -size.typical)
    return _try_sizes(union, effect, at, amounts)


def try_next(
    union: Union, white: "Whitened", at: Array, trials: Sequence[Trial], changes: Sequence[Array]
) -> Trial | None:
    """Return the next trial of an effect; None if those that were made tell enough.

    The second is at the sizes that the first asks for, or at larger ones if the first changed nothing. A
    limit acts from some size on, and soon too much: further ones are between one that changed nothing and
    one that changed too much.
    """
    if len(trials) == MOST_TRIALS:
        return None
    if len(trials) == 1:
        return _try_wanted(union, at, trials[0], find_share(white, white.clear(changes[0])))
    return _try_between(union, white, at, trials, changes)


def _try_wanted(union: Union, at: Array, trial: Trial, share: Array) -> Trial | None:
    effect, columns = trial.effect, union.columns([trial.effect])
    amounts = [point[c] for point, c in zip(trial.points, columns, strict=False)]
    for k, one in enumerate(share):
        factor = np.clip(abs(one), 1.0 / WIDEST, WIDEST) if one else WIDEST
        is_turned = one < 0.0 and effect.sizes[k].low < 0.0
        amounts[k] *= -factor if is_turned else factor
    amounts += [trial.points[0][c] for c in columns[len(amounts) :]]  # of a shape
    second = _try_sizes(union, effect, at, amounts)
    is_same = second is not None and np.array_equal(second.points, trial.points)
    return None if is_same else second


def _try_between(
    union: Union, white: "Whitened", at: Array, trials: Sequence[Trial], changes: Sequence[Array]
) -> Trial | None:
    effect, (column, *more) = trials[0].effect, union.columns([trials[0].effect])
    sizes = [abs(one.points[0][column]) for one in trials]
    acting = [k for k, change in enumerate(changes) if np.any(change)]
    silent = [size for k, size in enumerate(sizes) if k not in acting]
    if more or not acting or not silent:
        return None
    too_much, none = min(acting, key=lambda k: sizes[k]), max(silent)
    (share,) = find_share(white, white.clear(changes[too_much]))
    if share > 1.0 / WIDEST or none >= sizes[too_much]:
        return None
    between = np.sqrt(none * sizes[too_much])
    return _try_sizes(union, effect, at, [np.copysign(between, trials[0].points[0][column])])


def _try_sizes(union: Union, effect: Effect, at: Array, amounts: Sequence[float]) -> Trial | None:
    columns, points = union.columns([effect]), []
    inside = [np.clip(one, size.low, size.high) for one, size in zip(amounts, effect.sizes, strict=True)]
    for column, amount in zip(columns, inside, strict=True):
        point = at.copy()
        point[column] = amount
        points.append(point)
    if effect.has_shape:  # the other sizes say nothing while the first is 0
        points[0][columns[1:]] = inside[1:]
        points = points[:1]
    return Trial(effect, tuple(points)) if any(np.any(point != at) for point in points) else None


def group_effects(
    context: Context, joints: Collection[int], taken: Collection[str]
) -> dict[int, list[Effect]]:
    """Group the effects that compete by the joint where they are judged, without those with taken keys."""
    groups: dict[int, list[Effect]] = {joint: [] for joint in (*sorted(joints), ALL_JOINTS)}
    for effect in context.catalogue:
        is_open = effect.key not in taken and context.joint_of(effect) in groups
        if is_open and len(effect.parts) == 1:
            groups[context.joint_of(effect)].append(effect)
    return groups


def list_typical(
    context: Context, groups: Mapping[int, Sequence[Effect]], at: Array
) -> list[tuple[int, Trial]]:
    """List the trials of all effects at their typical sizes, each with its joint."""
    tried = [
        (joint, try_typical(context.union, one, at)) for joint, effects in groups.items() for one in effects
    ]
    return [(joint, trial) for joint, trial in tried if trial is not None]


def list_points(trials: Sequence[tuple[int, Trial]]) -> list[Point]:
    """List the points of trials, each with its joint."""
    return [(joint, point) for joint, trial in trials for point in trial.points]


def expect_round(context: Context, groups: Mapping[int, Sequence[Effect]], at: Array) -> int:
    """Count the candidates that a round of screening and refits is expected to take, for the progress."""
    points = list_points(list_typical(context, groups, at))
    refits = [(joint, at) for joint, effects in groups.items() for _ in effects[:SHORTLIST]]
    return 2 * len(context.sharing.plan(points)) + REFIT_COST * len(context.sharing.plan(refits))


@dataclass(frozen=True, slots=True)
class Whitened:
    """Residuals with the weights of a robust loss, cleared of what the free sizes of their joint can do."""

    rows: Integers
    residual: Array
    """(n_rows,)."""
    is_cut: bool
    """True if motions are blocks of a few whole ones."""
    joints: tuple[Integers, ...]
    """Indices of the rows of each joint, (n,) each."""
    parts: tuple[tuple[slice, Array, Array], ...]
    """For each fit: its rows, their weights (n,), an orthonormal basis of its base changes (n, p)."""

    @property
    def basis(self) -> Array:
        """Base changes of all joints, orthonormal, (n_rows, n_base)."""
        if len(self.parts) == 1:
            return self.parts[0][2]
        together = np.zeros((self.residual.size, sum(basis.shape[1] for *_, basis in self.parts)))
        first = 0
        for rows, _, basis in self.parts:
            together[rows, first : first + basis.shape[1]] = basis
            first += basis.shape[1]
        return together

    def clear(self, change: Array) -> Array:
        """Weight a change of the residuals and clear it like the residuals, (n_rows, n_points)."""
        cleared = np.empty_like(change)
        for rows, weight, basis in self.parts:
            part = np.where(np.isfinite(change[rows]), change[rows], 0.0) * weight[:, None]
            cleared[rows] = part - basis @ (basis.T @ part)
        return cleared


def whiten(fits: Sequence[JointFit], model: ResidualModel, scales: Array) -> Whitened:
    """Weight the residuals of some joints and clear them of what their free sizes can do."""
    parts, residuals, begin = [], [], 0
    for fit in fits:
        scale = scales[model.joint_of[fit.rows]]
        weight = root_weight(fit.residuals / scale) / scale
        basis = orthonormal(fit.jacobian * weight[:, None])
        residual = fit.residuals * weight
        residuals.append(residual - basis @ (basis.T @ residual))
        parts.append((slice(begin, begin + len(residual)), weight, basis))
        begin += len(residual)
    rows = np.concatenate([fit.rows for fit in fits])
    is_cut = isinstance(model, Blocks)
    return Whitened(
        rows,
        np.concatenate(residuals),
        is_cut,
        tuple(np.flatnonzero(model.joint_of[rows] == j) for j in np.unique(model.joint_of[rows])),
        tuple(parts),
    )


def find_share(white: Whitened, cleared: Array) -> Array:
    """Return the shares of cleared changes, (n_points,), whose sum explains most of the residual."""
    solution, *_ = np.linalg.lstsq(cleared, -white.residual, rcond=1e-8)
    return np.asarray(solution)


def score_effect(
    white: Whitened, trials: Sequence[Trial], changes: Sequence[Array], at: Array
) -> tuple[Score, Array, Array]:
    """Hold the changes that an effect makes against the residual of the present model.

    Each trial has the changes of the residuals at its points, (n_rows, n_points), in the unit of the fit.
    Return the score of the best trial, the largest change, and what the best one leaves. Both are (n_rows,)
    without a unit. With several points, all are those of their best linear combination.
    """
    energy = float(white.residual @ white.residual)
    best: tuple[float, Array, Array] | None = None
    direction = np.zeros(white.residual.size)
    for trial, change in zip(trials, changes, strict=True):
        cleared = white.clear(change)
        solution = find_share(white, cleared)
        change = cleared @ solution
        if change @ change > direction @ direction:
            direction = change
        is_signed = all(size.low < 0.0 for size in trial.effect.sizes[: len(trial.points)])
        if len(trial.points) == 1 and solution[0] <= 0.0 and not is_signed:
            solution = np.zeros(1)
        rest = white.residual + cleared @ solution
        gain = 1.0 - float(rest @ rest) / energy if energy > 0.0 else 0.0
        if best is None or gain > best[0]:
            start = trial.points[0]
            if len(trial.points) > 1:
                start = at + (np.array(trial.points) - at).T @ solution
            else:
                (own, *_) = np.flatnonzero(start != at)  # sizes after it give a form
                tried = np.abs([one.points[0][own] - at[own] for one in trials])
                least = _least_share(tried, abs(start[own] - at[own]), changes)
                share = np.sign(solution[0]) * np.clip(abs(solution[0]), least, 1.0)
                start = start.copy()
                start[own] = at[own] + share * (start[own] - at[own])
            best = (gain, start, rest)
    assert best is not None, "an effect without a trial"
    gain, start, rest = best
    kept = tuple((white.rows[rows], rest[rows]) for rows in white.joints) if white.is_cut else ()
    return Score(trials[0].effect, start, gain, kept), direction, rest


def _least_share(tried: Array, size: float, changes: Sequence[Array]) -> float:
    """Return the least share of a size from which a fit may start.

    A limit changes nothing while nothing reaches it, and a fit that starts there has no derivative. If a size
    that was tried changes nothing, the fit starts at the smallest one that does, or above.
    """
    acts = np.array([bool(np.any(change)) for change in changes])
    if acts.all() or not acts.any():
        return LEAST_SHARE
    return max(LEAST_SHARE, float(tried[acts].min()) / size)


def adjust(share: float, n_sizes: int, n_independent: int) -> float:
    """Clear a share of a residual of what so many sizes explain of noise (Theil's adjusted R squared).

    Independent samples are blocks as long as the correlation time. The result is minus infinity if sizes are
    as many as these.
    """
    free = n_independent - 1 - n_sizes
    return 1.0 - (1.0 - share) * (n_independent - 1) / free if free > 0 else -np.inf


def refit_p(
    fits: Sequence[JointFit],
    own: Integers,
    without: Array,
    model: ResidualModel,
    scales: Array,
    is_stationary: bool,
) -> float:
    """Return the p-value of a fit without effect: `stationary_p` if repeats show the noise, else `wald_p`."""
    base = []
    for fit in fits:
        rest = ~np.isin(fit.columns, own)
        columns, jacobian = fit.columns[rest], fit.jacobian[:, rest]
        base.append(replace(fit, columns=columns, jacobian=jacobian, residuals=without[fit.rows]))
    white = whiten(base, model, scales)
    change = np.concatenate([fit.residuals - without[fit.rows] for fit in fits])
    (cleared,) = white.clear(change[:, None]).T
    # a misfit that the effect explains is no noise, and would make blocks so long that nothing is rejected
    cluster = cut_rows(model, white.rows, white.residual + cleared)
    if is_stationary:
        return stationary_p(white.basis.shape[1], cleared, white.residual, cluster, len(own))
    return wald_p(white.basis, cleared, white.residual, cluster, len(own))


MAX_LOCAL: Final = 0.5
"""Largest change at another joint over that at its own for which an effect is judged at its joint alone."""
AT_ONCE: Final = 32
"""Candidates whose residuals are kept at once: those of long logs are large."""


def share_simulations(context: Context, sizes: Array, effects: Sequence[Effect]) -> Context:
    """Measure which joints effects move, and choose what shares simulations and what is judged at all joints.

    Effects of the base decide which joints share; all do where no base is.
    """
    union, model = context.union, context.model
    base = {effect.key for effect in context.base}
    placed = [one for one in effects if one.place in model.joints]
    moved = {one.place for one in context.base}
    columns = [union.columns([effect]) for effect in placed]
    # an effect that varies does not act in all motions
    steady = [steady_effect(one) for one in placed]
    distinct = {one.key: one for one in steady}
    typical = [np.array([np.clip(s.typical, s.low, s.high) for s in e.sizes]) for e in distinct.values()]
    of_distinct = [union.columns([effect]) for effect in distinct.values()]
    reach = resume_step(measure_reach, context, sizes, list(zip(of_distinct, typical, strict=True)))
    reach = reach[[[*distinct].index(one.key) for one in steady]]
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
    """Measure RMS changes of joints by effects of typical size, over the scales, (n_effects, n_joints).

    They count in motions in which joints move most. Each effect has the columns of its sizes and its typical
    sizes, (n_own,), in their units.
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
    """List, for each joint, the motion in which it moves fastest, without repetition."""
    square = np.nan_to_num(model.explain("velocity") ** 2)
    shape = len(model.joints), len(model.motions)
    cell = model.joint_of * shape[1] + model.motion_of
    total = np.bincount(cell, weights=square, minlength=shape[0] * shape[1])
    count = np.bincount(cell, minlength=shape[0] * shape[1])
    speed = (total / np.maximum(count, 1)).reshape(shape)
    return [model.motions[k] for k in np.unique(np.argmax(speed, axis=1))]


def expected_change(context: Context, joint: int, trial: Trial) -> float:
    """Return the RMS change over the scale of its joint that a trial should make there, by typical sizes."""
    if joint == ALL_JOINTS:
        return 0.0
    typical = np.array([size.typical for size in trial.effect.sizes])
    ratios = np.array(trial.points)[:, context.union.columns([trial.effect])] / typical
    return context.reach.get(trial.effect.key, 0.0) * float(np.max(np.abs(ratios)))
