"""Finite differences of the arm's simulator: columns, adaptive steps, and simultaneous simulation.

Under a recorded drive, an effect at one joint changes only that joint (sim/loop.py). So effects of one
kind are simulated at several joints at once, and each takes the motions of its own joint.
"""

import math
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.arm_effects import joint_at
from marsarm.diagnosis.arm.case_simulator import simulate_change
from marsarm.diagnosis.arm.feature_set import (
    FeatureSet,
    changes_readings_only,
    rests_moved_by,
    simulate_touches,
)
from marsarm.diagnosis.arm.rest_poses import is_stepped
from marsarm.diagnosis.problem import LOG_UNIT, Hypothesis, Nuisance
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


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Column of the sensitivities: a parameter of a hypothesis, or a nuisance."""

    source: Hypothesis | Nuisance
    index: int = 0
    """Index among the parameters of the hypothesis."""

    def sides(self, share: float) -> list[tuple[Effect, float]]:
        """Return steps up and down by a share of the typical size, within the bounds: one or two.

        Each is an effect and its size, in typical sizes, or in the unit of the nuisance, whose step is one
        sigma.
        """
        source = self.source
        if isinstance(source, Hypothesis):
            least, most = source.parameters[self.index].departure_range
            steps = [float(np.clip(by, least, most)) for by in (share, -share)]
            at = np.eye(len(source.parameters))[self.index]
            return [(source.switch_on(step * at), step) for step in steps if step]
        assert source.effect is not None
        steps = [1.0] if source.only_channel else [source.sigma, -source.sigma]
        return [(source.effect(step), step) for step in steps]


@dataclass(frozen=True, slots=True, eq=False)
class OneSidedStep:
    """Simulated step on one side of nominal."""

    share: float
    """Step as a share of the typical size; 1 means one sigma of a nuisance."""
    size: float
    """Step within the bounds, in typical sizes, or in the unit of the nuisance."""
    change: Array
    """Change of the features, shape (m,)."""


def list_columns(hypotheses: Sequence[Hypothesis], nuisances: Sequence[Nuisance]) -> list[Column]:
    """List every parameter of every hypothesis in order, then the nuisances."""
    sized = [Column(one, k) for one in hypotheses for k in range(len(one.parameters))]
    return [*sized, *map(Column, nuisances)]


def find_borrowed_slopes(columns: Sequence[Column]) -> dict[int, tuple[int, float]]:
    """Find the columns that have the slope of another: of each, the other and the factor.

    A nuisance has that of an equal hypothesis, or of an equal nuisance, and is not simulated. A hypothesis
    that is a factor has that of its nuisance: its own step is many sigmas of it, where the response is not
    linear and backlash changes sides. The nuisance could not explain the difference of the slopes.
    """
    known: dict[str, tuple[int, float]] = {}
    found: dict[int, tuple[int, float]] = {}
    own: dict[str, int] = {}
    for k, column in enumerate(columns):
        if isinstance(column.source, Hypothesis):
            parameter = column.source.parameters[column.index]
            if parameter.unit != LOG_UNIT:
                known.setdefault(column.source.key, (k, 1.0 / parameter.typical))
        elif (name := column.source.same_as) in known:
            found[k] = known[name]
        else:
            known[name], own[name] = (k, 1.0), k
    for k, column in enumerate(columns):
        if isinstance(column.source, Hypothesis) and column.source.key in own:
            found[k] = own[column.source.key], column.source.parameters[column.index].typical
    return found


def group_columns(columns: Sequence[Column], wanted: Sequence[int]) -> list[tuple[int, ...]]:
    """Group columns that are simulated at once, one at each joint; slow groups come first."""
    count: Counter[Hashable] = Counter()
    groups: dict[Hashable, list[int]] = {}
    slow = set()
    for k in wanted:
        effect, _ = columns[k].sides(1.0)[0]
        joint, is_nuisance = joint_at(effect), isinstance(columns[k].source, Nuisance)
        # effects of one kind at one joint, such as friction in two directions, would add up
        kind = type(effect).__name__, is_nuisance, columns[k].index
        alone = joint is None
        groups.setdefault(k if alone else (kind, count[kind, joint]), []).append(k)
        count[kind, joint] += 1
        slow |= {k} if is_stepped(effect) else set()
    return [tuple(of) for of in sorted(groups.values(), key=lambda of: (of[0] not in slow, -len(of)))]


def simulate_side(
    feature_set: FeatureSet,
    columns: Sequence[Column],
    nominal: Array,
    number: int,
    shares: Mapping[int, float],
) -> dict[int, OneSidedStep]:
    """Simulate one side of some of the columns at once. Repeats of a motion are not simulated.

    Args:
        nominal: Prediction without effects in the units of the channels, shape (m,).
        number: 0 for the first side, 1 for the second.
        shares: By the index of the column, its step as a share of its typical size.
    """
    ends = {k: columns[k].sides(by)[number] for k, by in shares.items()}
    effects = tuple(effect for effect, _ in ends.values())
    change = simulate_change(feature_set, effects, nominal)
    changes = [change]
    if joint_at(effects[0]) is not None:
        changes = [_change_at_joint(feature_set, change, effect) for effect in effects]
    rows = zip(ends.items(), changes, strict=True)
    return {k: OneSidedStep(shares[k], size, change) for (k, (_, size)), change in rows}


def _change_at_joint(feature_set: FeatureSet, moved: Array, effect: Effect) -> Array:
    """Return the part of a change (m,) in the motions and the rests that the joint of an effect changes."""
    joint = joint_at(effect)
    assert joint is not None, "only effects at joints are simulated together"
    moving = np.arange(moved.size) < feature_set.n_moving
    own = moving & [one.place == joint.name.lower() for one in feature_set.list_features()]
    turns = not changes_readings_only(effect)
    found = np.where(own, moved, rests_moved_by(feature_set, moved, joint, turns))
    nominal, touched = (simulate_touches(feature_set, some) for some in ((), (effect,)))
    found[found.size - nominal.size :] = touched - nominal
    return found
