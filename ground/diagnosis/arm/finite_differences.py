"""Columns of the sensitivities: differences of the arm's simulator beside nominal.

Under a recorded drive a difference stays in the joint that it comes from (sim/open_loop.py). So one kind of
effect is simulated at several joints at once, and each has the motion of its own joint.
"""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.arm.case_simulator import simulate_change
from ground.diagnosis.arm.feature_set import no_motion
from ground.diagnosis.arm.rest_poses import STEPPED_EFFECTS
from ground.diagnosis.arm.simulator import ArmSimulator
from ground.diagnosis.problem import LOG_UNIT
from sim.effects.effect import Effect

TARGET_SIGMAS: Final = 15.0
"""Standard errors beside the nuisances that a step is to be: 4.6 times the limit of detection."""
MAX_STEP_RATIO: Final = 2.0
"""A step is mended if it is that many times too large or too small."""
MIN_STEP_SHARE: Final = 1e-3
MAX_STEP_SHARE: Final = 2.0
"""Of a typical size."""
MAX_ROUNDS: Final = 3
"""That steps are mended in."""


def step_error(seen: float) -> float:
    """How far a step that is so many standard errors is from what it should be; infinite if it is unseen."""
    return abs(math.log(seen / TARGET_SIGMAS)) if seen else math.inf


def adapt_step(share: float, seen: float) -> float | None:
    """Another share for a step that is so many standard errors; None if none would be better."""
    if not seen or 1.0 / MAX_STEP_RATIO <= seen / TARGET_SIGMAS <= MAX_STEP_RATIO:
        return None
    better = min(max(share * TARGET_SIGMAS / seen, MIN_STEP_SHARE), MAX_STEP_SHARE)
    return None if 1.0 / MAX_STEP_RATIO < better / share < MAX_STEP_RATIO else better


@dataclass(frozen=True, slots=True)
class JacobianColumn:
    """A number whose sensitivity is wanted: a size parameter of a hypothesis, or a nuisance."""

    hypothesis: int | None
    index: int
    """Which of the hypothesis' parameters; of a nuisance, which one."""


@dataclass(frozen=True, slots=True, eq=False)
class OneSidedStep:
    """What was simulated on one side of nominal."""

    share: float
    """Of a typical size, the step; 1 of a nuisance's sigma."""
    size: float
    """The step as bounds allow it, in typical sizes, or in units of the nuisance."""
    change: Array
    """Of the features, (m,)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Perturbation:
    """A state beside nominal."""

    effects: tuple[Effect, ...]
    size: float


def list_columns(simulator: ArmSimulator) -> list[JacobianColumn]:
    """Every size parameter of every hypothesis in order, then the nuisances."""
    sized = [
        JacobianColumn(k, at)
        for k, hypothesis in enumerate(simulator.hypotheses)
        for at, parameter in enumerate(hypothesis.parameters)
        if parameter.is_amplitude
    ]
    return sized + [JacobianColumn(None, k) for k in range(len(simulator.nuisances))]


def find_aliases(simulator: ArmSimulator, columns: Sequence[JacobianColumn]) -> dict[int, tuple[int, float]]:
    """Nuisances that are a hypothesis or another nuisance as well: that one's column, and what 1 is of it.

    Not a hypothesis that is a factor: its steps are many sigmas of the nuisance, there it is no straight
    line, and gaps change sides on the way.
    """
    known: dict[str, tuple[int, float]] = {}
    found: dict[int, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is not None:
            hypothesis = simulator.hypotheses[column.hypothesis]
            parameter = hypothesis.parameters[column.index]
            if parameter.unit != LOG_UNIT:
                known.setdefault(hypothesis.name, (k, parameter.typical))
        elif (name := simulator.nuisance_effects[column.index].same_as) in known:
            found[k] = known[name]
        else:
            known[name] = k, 1.0
    return found


def find_shared_slopes(
    simulator: ArmSimulator, columns: Sequence[JacobianColumn]
) -> dict[int, tuple[int, float]]:
    """Hypotheses that take their slope from a nuisance: its column, and how much of it a typical size is.

    Where they are small they are the same thing. With slopes from different steps, the difference would look
    like something that the nuisance cannot explain.
    """
    same = find_aliases(simulator, columns)
    own = {
        simulator.nuisance_effects[column.index].same_as: k
        for k, column in enumerate(columns)
        if column.hypothesis is None and k not in same
    }
    found: dict[int, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is None:
            continue
        hypothesis = simulator.hypotheses[column.hypothesis]
        if hypothesis.name in own:
            found[k] = own[hypothesis.name], hypothesis.parameters[column.index].typical
    return found


def count_sides(simulator: ArmSimulator, column: JacobianColumn) -> int:
    """On how many sides of nominal there is something to simulate: one if bounds leave one."""
    return len(_perturb_both_sides(simulator, column, 1.0))


def steps_to_rest(simulator: ArmSimulator, column: JacobianColumn) -> bool:
    """Whether the arm is stepped to its rests, too."""
    return any(isinstance(effect, STEPPED_EFFECTS) for effect in _typical_step(simulator, column).effects)


def group_columns(
    simulator: ArmSimulator, columns: Sequence[JacobianColumn], wanted: Sequence[int]
) -> list[tuple[int, ...]]:
    """Which of the columns that are wanted are simulated at once, what takes long first."""
    groups: dict[Hashable, list[int]] = {}
    for k in wanted:
        groups.setdefault(_group_key(simulator, columns[k]) or k, []).append(k)
    found = sorted(groups.values(), key=lambda of: (not steps_to_rest(simulator, columns[of[0]]), -len(of)))
    return [tuple(of) for of in found]


def _group_key(simulator: ArmSimulator, column: JacobianColumn) -> tuple[str, int | None] | None:
    """What it is, wherever it is; None if it does not stay in a joint, or the arm is stepped to its rests."""
    whole = _typical_step(simulator, column)
    if steps_to_rest(simulator, column) or _joint_name(whole) is None:
        return None
    return type(whole.effects[0]).__name__, None if column.hypothesis is None else column.index


def step_size(simulator: ArmSimulator, column: JacobianColumn, share: float) -> float:
    """What a share of a typical size is within bounds, upwards if there is room."""
    return _perturb_both_sides(simulator, column, share)[0].size


def simulate_side(
    simulator: ArmSimulator,
    columns: Sequence[JacobianColumn],
    nominal: Array,
    number: int,
    shares: Sequence[float],
) -> list[OneSidedStep]:
    """The changes on one side of columns that are simulated at once, each by a share of a typical size.

    Of repeats only the first is simulated: the others were given the same drive.
    """
    ends = [
        _perturb_both_sides(simulator, column, by)[number] for column, by in zip(columns, shares, strict=True)
    ]
    if _group_key(simulator, columns[0]) is None:
        changes = [_simulate_alone(simulator, columns[0], ends[0], nominal)]
    else:
        changes = _simulate_together(simulator, ends, nominal)
    return [OneSidedStep(by, end.size, change) for by, end, change in zip(shares, ends, changes, strict=True)]


def _simulate_alone(
    simulator: ArmSimulator, column: JacobianColumn, end: _Perturbation, nominal: Array
) -> Array:
    if column.hypothesis is None and (beside := simulator.nuisance_effects[column.index].baseline):
        simulator = simulator.with_patch(beside)
        nominal = simulator.predict_effects(())
    return simulate_change(simulator, end.effects, nominal)


def _simulate_together(simulator: ArmSimulator, ends: Sequence[_Perturbation], nominal: Array) -> list[Array]:
    """Motions simulated once, with all effects, and each joint's own of it; rests one by one."""
    every = tuple(effect for end in ends for effect in end.effects)
    moved = simulate_change(simulator, every, nominal)
    moving = np.arange(moved.size) < sum(len(one.features) for one in simulator.feature_set.motions)
    found = []
    for end in ends:
        own = moving & _features_at(simulator, _joint_name(end))
        found.append(np.where(own, moved, simulate_change(simulator, end.effects, nominal, no_motion)))
    return found


def _features_at(simulator: ArmSimulator, name: str | None) -> Flags:
    """Features at a place, (m,)."""
    return np.array([place == name for place in simulator.layout.places])[simulator.layout.place]


def _joint_name(end: _Perturbation) -> str | None:
    """The joint that it sits at, by name; None if it sits elsewhere."""
    (effect,) = end.effects
    joint = getattr(effect, "joint", None)
    return None if joint is None else Joint(joint).name.lower()


def _typical_step(simulator: ArmSimulator, column: JacobianColumn) -> _Perturbation:
    """A typical size, upwards if there is room."""
    return _perturb_both_sides(simulator, column, 1.0)[0]


def _perturb_both_sides(
    simulator: ArmSimulator, column: JacobianColumn, share: float
) -> tuple[_Perturbation, ...]:
    """Up and down, where bounds allow it."""
    found = (_perturb(simulator, column, sign * share) for sign in (1.0, -1.0))
    return tuple(end for end in found if end is not None)


def _perturb(simulator: ArmSimulator, column: JacobianColumn, share: float) -> _Perturbation | None:
    """None where there is nothing on that side."""
    zero = np.zeros(len(simulator.nuisances))
    if column.hypothesis is None:
        one = simulator.nuisance_effects[column.index]
        if share < 0.0 and one.one_sided:
            return None
        zero[column.index] = 1.0 if one.one_sided else np.sign(share) * one.nuisance.sigma
        return _Perturbation(tuple(simulator.effects({}, zero)), float(zero[column.index]))
    hypothesis = simulator.hypotheses[column.hypothesis]
    parameter, values = hypothesis.parameters[column.index], hypothesis.absent
    absent = values[column.index]
    values[column.index] = np.clip(absent + share * parameter.typical, parameter.least, parameter.most)
    if values[column.index] == absent:
        return None
    size = float((values[column.index] - absent) / parameter.typical)
    return _Perturbation(tuple(simulator.effects({hypothesis: values}, zero)), size)
