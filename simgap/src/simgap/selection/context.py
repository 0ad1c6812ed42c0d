"""Inputs of a selection, its present model, and how both reach the residual model."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Concatenate, Final, ParamSpec, TypeVar

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.residuals.noise import Blocks
from simgap.residuals.residuals import ResidualModel
from simgap.selection.checkpoint import Checkpoint, Meter
from simgap.selection.fit import Hypothesis, JointFit, Union
from simgap.selection.fitting import Fitting, evaluate_points
from simgap.selection.sharing import ALL_JOINTS, Point, Sharing, share_nothing

P = ParamSpec("P")
T = TypeVar("T")
FOLDS: Final = 20
"""Most folds: up to this number of motions, each is left out alone."""


@dataclass(frozen=True, slots=True)
class Context:
    """Inputs that stay the same while effects are selected."""

    model: ResidualModel
    union: Union
    base: tuple[Effect, ...]
    catalogue: tuple[Effect, ...]
    scales: Array
    """(n_joints,)."""
    noise_loss: Array
    """Mean loss of the noise of each joint, (n_joints,); 0 where it is unknown."""
    base_sizes: Array
    """`FittedModel.sizes` with base parameters alone; empty before they are fitted."""
    base_left_out: Array
    """`FittedModel.left_out` with base parameters alone."""
    sharing: Sharing
    """Joints whose hypotheses share simulations."""
    reach: dict[str, float]
    """Change that an effect of typical size makes at its joint, over the scale of the residuals, by key."""
    n_distinct: float
    """Number of tests that share the probability of chance: distinct effects, by `chance.count_distinct`, or
    all where the noise is known, times the kinds of residual."""
    folds: tuple[frozenset[int], ...]
    seed: int
    meter: Meter
    checkpoint: Checkpoint

    def joint_of(self, effect: Effect) -> int:
        """Return the index of the joint at which an effect is judged, or ALL_JOINTS."""
        return int(self.sharing.joint_of_column[self.union.columns([effect])[0]])


@dataclass(frozen=True, slots=True)
class FittedModel:
    """A model: its effects, its fit at each joint, its errors on motions that were left out."""

    effects: tuple[Effect, ...]
    """Accepted effects, without base parameters."""
    sizes: Array
    """(n_sizes,)."""
    fits: tuple[JointFit, ...]
    """One a joint; a single one of all joints if an effect is judged at all."""
    left_out: Array
    """Each residual when its motion was left out, over the scale of its joint, (n_rows,)."""


LeftOut = tuple[tuple[tuple[Effect, ...], FittedModel], ...]
"""Effects that are left out together, and the model without them; each effect once."""


@dataclass(frozen=True, slots=True)
class Score:
    """Share of a residual that an effect explains."""

    effect: Effect
    start: Array
    """Sizes of the union from which a fit should begin, (n_sizes,)."""
    gain: float
    """Share of the weighted sum of squares that it removes; after a refit, that of left-out motions."""
    left: tuple[tuple[Integers, Array], ...] = ()
    """For each joint: rows of the residual model, and what the effect leaves there, without a unit; empty
    where motions are not cut into blocks."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Models before and after, and what the findings were held against."""

    context: Context
    base: FittedModel
    chosen: FittedModel
    left_out: LeftOut
    """Of the findings."""
    competitors: dict[str, tuple[Score, ...]]
    """For each finding, by key, the effects that were refitted before it was accepted."""
    kept: frozenset[str] = frozenset()
    """Keys of effects that are needed only together with others, which were dropped."""


def start_context(
    model: ResidualModel,
    base: Sequence[Effect],
    catalogue: Sequence[Effect],
    seed: int,
    meter: Meter,
    checkpoint: Checkpoint | None = None,
) -> Context:
    """Make a context with scales of 1, no folds and nothing shared; what is in the base does not compete."""
    known = {effect.key for effect in base}
    others = tuple(effect for effect in catalogue if effect.key not in known)
    union = Union((*base, *others))
    joint_of_column = list_joints(model, union, ())
    ones = np.ones(len(model.joints))
    return Context(
        model=model,
        union=union,
        base=tuple(base),
        catalogue=others,
        scales=ones,
        noise_loss=0.0 * ones,
        base_sizes=np.empty(0),
        base_left_out=np.empty(0),
        sharing=share_nothing(len(model.joints), joint_of_column),
        reach={},
        n_distinct=float(len(others)),
        folds=(),
        seed=seed,
        meter=meter,
        checkpoint=checkpoint or Checkpoint(),
    )


def list_joints(model: ResidualModel, union: Union, everywhere: Collection[str]) -> Integers:
    """List the joint, or ALL_JOINTS, at which each size is judged, (n_sizes,).

    Where a robot has one joint, effects at bodies are fitted with it. Effects whose keys are in `everywhere`
    are judged at all joints, because they move others than their own too.
    """
    places = [
        0
        if len(model.joints) == 1
        else ALL_JOINTS
        if effect.place not in model.joints or effect.key in everywhere
        else model.joints.index(effect.place)
        for effect in union.effects
    ]
    return np.repeat(np.array(places, np.int64), [len(effect.sizes) for effect in union.effects])


def draw_folds(model: ResidualModel, seed: int) -> tuple[frozenset[int], ...]:
    """Divide motions at random into folds of about equal numbers; blocks, those of each joint apart."""
    random, n = np.random.default_rng(seed), len(model.motions)
    joint = model.joint_of_block if isinstance(model, Blocks) else np.zeros(n, dtype=np.int64)
    order = [int(m) for j in np.unique(joint) for m in random.permutation(np.flatnonzero(joint == j))]
    return tuple(frozenset(order[k::FOLDS]) for k in range(min(FOLDS, len(order))))


def resume_step(
    step: Callable[Concatenate[Context, P], T], context: Context, *args: P.args, **kwargs: P.kwargs
) -> T:
    """Return what an earlier run with the same inputs found in a step; else carry it out and `pack` it."""
    return context.checkpoint.step(context.meter, step.__name__, lambda: step(context, *args, **kwargs))


def start_fitting(context: Context, hypotheses: Iterable[Hypothesis], text: str) -> Fitting:
    """Prepare to fit hypotheses in this context."""
    return Fitting(
        context.model,
        context.union,
        hypotheses,
        context.scales,
        sharing=context.sharing,
        report=lambda count: context.meter.advance(text, count),
    )


def fit_together(context: Context, hypotheses: Sequence[Hypothesis], text: str) -> list[JointFit]:
    """Fit hypotheses in this context."""
    return start_fitting(context, hypotheses, text).finish()


def simulate(context: Context, points: Sequence[Point], text: str) -> list[Array]:
    """Simulate points, as `evaluate_points` takes them; return residuals of the joint of each, (n_rows,)."""
    return evaluate_points(
        context.model,
        context.union,
        points,
        sharing=context.sharing,
        report=lambda count: context.meter.advance(text, count),
    )


def simulate_models(context: Context, model: ResidualModel, sizes: Sequence[Array]) -> Array:
    """Return the residuals of some motions, (n_models, n), with models that were found on others.

    Args:
        sizes: Those of the union in their units, (n_sizes,) for each model.
    """
    union, points = context.union, np.array(sizes)
    part = [one for one in union.effects if np.any(points[:, union.columns([one])])]
    return model.residuals(part, points[:, union.columns(part)])
