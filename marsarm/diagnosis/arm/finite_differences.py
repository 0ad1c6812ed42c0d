"""Finite differences of the arm's simulator: columns, adaptive steps, and simultaneous simulation.

Under a recorded drive, an effect at one joint changes only that joint (sim/loop.py). So effects of one
kind are simulated at several joints at once, and each takes the motions of its own joint.
"""

import math
from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.case_simulator import simulate_change
from marsarm.diagnosis.arm.feature_set import changes_readings_only, rests_moved_by, simulate_touches
from marsarm.diagnosis.arm.rest_poses import is_stepped
from marsarm.diagnosis.arm.simulator import ArmSimulator
from marsarm.diagnosis.problem import LOG_UNIT
from sim.effects.effect import Effect

TARGET_SIGMAS: Final = 15.0
"""Target size of a step in standard errors beside the nuisances: 4.6 times the detection limit."""
MAX_STEP_RATIO: Final = 2.0
"""A step is adapted if it misses the target by more than this factor."""
MIN_STEP_SHARE: Final = 1e-3
MAX_STEP_SHARE: Final = 2.0
"""Greatest step, as a share of a typical size."""
MAX_ROUNDS: Final = 3
"""Greatest number of rounds in which steps are adapted."""


def step_error(seen: float) -> float:
    """Return the absolute logarithm of a step over its target, both in standard errors; infinite for 0."""
    return abs(math.log(seen / TARGET_SIGMAS)) if seen else math.inf


def adapt_step(share: float, seen: float) -> float | None:
    """Return a better share for a step of so many standard errors; None if it is good enough."""
    if not seen or 1.0 / MAX_STEP_RATIO <= seen / TARGET_SIGMAS <= MAX_STEP_RATIO:
        return None
    better = min(max(share * TARGET_SIGMAS / seen, MIN_STEP_SHARE), MAX_STEP_SHARE)
    return None if 1.0 / MAX_STEP_RATIO < better / share < MAX_STEP_RATIO else better


@dataclass(frozen=True, slots=True)
class JacobianColumn:
    """Column of the sensitivities: a parameter of a hypothesis, or a nuisance."""

    hypothesis: int | None
    index: int
    """Index among the hypothesis' parameters, or among the nuisances."""


@dataclass(frozen=True, slots=True, eq=False)
class OneSidedStep:
    """Simulated step on one side of nominal."""

    share: float
    """Step as a share of the typical size; 1 means one sigma of a nuisance."""
    size: float
    """Step within the bounds, in typical sizes, or in the unit of the nuisance."""
    change: Array
    """Change of the features, shape (m,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Perturbation:
    """Effects of a step, and its size."""

    effects: tuple[Effect, ...]
    size: float


def list_columns(simulator: ArmSimulator) -> list[JacobianColumn]:
    """List every parameter of every hypothesis in order, then the nuisances."""
    sized = [
        JacobianColumn(k, at)
        for k, hypothesis in enumerate(simulator.hypotheses)
        for at in range(len(hypothesis.parameters))
    ]
    return sized + [JacobianColumn(None, k) for k in range(len(simulator.nuisances))]


def find_borrowed_slopes(
    simulator: ArmSimulator, columns: Sequence[JacobianColumn]
) -> dict[int, tuple[int, float]]:
    """Find the columns that have the slope of another: of each, the other and the factor.

    A nuisance has that of an equal hypothesis, or of an equal nuisance, and is not simulated. A hypothesis
    that is a factor has that of its nuisance: its own step is many sigmas of it, where the response is not
    linear and backlash changes sides. The nuisance could not explain the difference of the slopes.
    """
    known: dict[str, tuple[int, float]] = {}
    found: dict[int, tuple[int, float]] = {}
    own: dict[str, int] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is not None:
            hypothesis = simulator.hypotheses[column.hypothesis]
            parameter = hypothesis.parameters[column.index]
            if parameter.unit != LOG_UNIT:
                known.setdefault(hypothesis.name, (k, 1.0 / parameter.typical))
        elif (name := simulator.nuisance_effects[column.index].same_as) in known:
            found[k] = known[name]
        else:
            known[name], own[name] = (k, 1.0), k
    for k, column in enumerate(columns):
        hypothesis = simulator.hypotheses[column.hypothesis or 0]
        if column.hypothesis is not None and hypothesis.name in own:
            found[k] = own[hypothesis.name], hypothesis.parameters[column.index].typical
    return found


def group_columns(
    simulator: ArmSimulator, columns: Sequence[JacobianColumn], wanted: Sequence[int]
) -> list[tuple[int, ...]]:
    """Group columns that are simulated at once, one at each joint; slow groups come first."""
    count: Counter[Hashable] = Counter()
    groups: dict[Hashable, list[int]] = {}
    slow = set()
    for k in wanted:
        effects = perturb_both_sides(simulator, columns[k], 1.0)[0].effects
        key = _group_key(effects, columns[k])
        # effects of one kind at one joint, such as friction in two directions, would add up
        at_joint = key, _joint(effects)
        groups.setdefault(k if key is None else (key, count[at_joint]), []).append(k)
        count[at_joint] += 1
        slow |= {k} if any(map(is_stepped, effects)) else set()
    return [tuple(of) for of in sorted(groups.values(), key=lambda of: (of[0] not in slow, -len(of)))]


def _group_key(effects: tuple[Effect, ...], column: JacobianColumn) -> tuple[str, int | None] | None:
    """Return kind and parameter of an effect at a joint; None if it must be simulated alone."""
    if _joint(effects) is None:
        return None
    return type(effects[0]).__name__, None if column.hypothesis is None else column.index


def simulate_side(
    simulator: ArmSimulator,
    columns: Sequence[JacobianColumn],
    nominal: Array,
    number: int,
    shares: Sequence[float],
) -> list[OneSidedStep]:
    """Simulate one side of columns that are simulated at once. Repeats of a motion are not simulated.

    Args:
        nominal: Prediction without effects in the units of the channels, shape (m,).
        number: 0 for the first side, 1 for the second.
        shares: Step of each column as a share of its typical size.
    """
    ends = [
        perturb_both_sides(simulator, column, by)[number] for column, by in zip(columns, shares, strict=True)
    ]
    every = tuple(effect for end in ends for effect in end.effects)
    changes = [simulate_change(simulator, every, nominal)]
    if _joint(every[:1]) is not None:
        changes = [_change_at_joint(simulator, changes[0], end.effects) for end in ends]
    return [OneSidedStep(by, end.size, change) for by, end, change in zip(shares, ends, changes, strict=True)]


def _change_at_joint(simulator: ArmSimulator, moved: Array, effects: tuple[Effect, ...]) -> Array:
    """Return the part of a change (m,) in the motions and the rests that the joint of an effect changes."""
    joint = _joint(effects)
    assert joint is not None, "only effects at joints are simulated together"
    moving = np.arange(moved.size) < sum(len(one.features) for one in simulator.feature_set.motions)
    places, name = simulator.layout.places, joint.name.lower()
    own = moving & np.array([place == name for place in places])[simulator.layout.place]
    turns = not all(map(changes_readings_only, effects))
    found = np.where(own, moved, rests_moved_by(simulator.feature_set, moved, joint, turns))
    nominal, touched = (
        simulate_touches(simulator.feature_set, (*simulator.patch, *some)) for some in ((), effects)
    )
    found[found.size - nominal.size :] = touched - nominal
    return found


def _joint(effects: tuple[Effect, ...]) -> Joint | None:
    """Return the joint of an effect; None if it has none."""
    (effect,) = effects
    joint = getattr(effect, "joint", None)
    return None if joint is None else Joint(joint)


def perturb_both_sides(
    simulator: ArmSimulator, column: JacobianColumn, share: float
) -> tuple[Perturbation, ...]:
    """Return steps up and down by a share of the typical size, within the bounds: one or two."""
    found = (_perturb(simulator, column, sign * share) for sign in (1.0, -1.0))
    return tuple(end for end in found if end is not None)


def _perturb(simulator: ArmSimulator, column: JacobianColumn, share: float) -> Perturbation | None:
    """Return the step of a share of the typical size; None if the bounds leave no room."""
    if column.hypothesis is None:
        one = simulator.nuisance_effects[column.index]
        if share < 0.0 and one.one_sided:
            return None
        departure = 1.0 if one.one_sided else float(np.sign(share)) * one.nuisance.sigma
        return Perturbation((one.effect(departure),), departure)
    hypothesis = simulator.hypotheses[column.hypothesis]
    parameter = hypothesis.parameters[column.index]
    values = np.array([one.neutral for one in hypothesis.parameters])
    value = float(np.clip(parameter.neutral + share * parameter.typical, parameter.least, parameter.most))
    if value == parameter.neutral:
        return None
    values[column.index] = value
    size = (value - parameter.neutral) / parameter.typical
    return Perturbation(tuple(simulator.effects({hypothesis: values})), size)
