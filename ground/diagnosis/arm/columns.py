"""Columns of the sensitivities: differences of the arm's simulator beside nominal.

Under a recorded drive a difference stays in the joint that it comes from (sim/open_loop.py). So one kind of
effect is simulated at several joints at once, and each has the motion of its own joint.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.arm.bound import changed
from ground.diagnosis.arm.campaign import none_of
from ground.diagnosis.arm.poses import MOVES_ON
from ground.diagnosis.arm.simulator import ArmSimulator
from ground.diagnosis.hypothesis import FACTOR
from sim.effects.effect import Effect


@dataclass(frozen=True, slots=True)
class Column:
    """A number whose sensitivity is wanted: a size parameter of a hypothesis, or a nuisance."""

    hypothesis: int | None
    at: int
    """Which of the hypothesis' parameters; of a nuisance, which one."""


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """What was simulated on one side of nominal."""

    share: float
    """Of a typical size, the step; 1 of a nuisance's sigma."""
    size: float
    """The step as bounds allow it, in typical sizes, or in units of the nuisance."""
    change: Array
    """Of the features, (m,)."""


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """A state beside nominal."""

    effects: tuple[Effect, ...]
    size: float


def columns_of(simulator: ArmSimulator) -> list[Column]:
    """Every size parameter of every hypothesis in order, then the nuisances."""
    sized = [
        Column(k, at)
        for k, hypothesis in enumerate(simulator.hypotheses)
        for at, parameter in enumerate(hypothesis.parameters)
        if parameter.sizes
    ]
    return sized + [Column(None, k) for k in range(len(simulator.nuisances))]


def alike(simulator: ArmSimulator, columns: Sequence[Column]) -> dict[int, tuple[int, float]]:
    """Nuisances that are a hypothesis or another nuisance as well: that one's column, and what 1 is of it.

    Not a hypothesis that is a factor: its steps are many sigmas of the nuisance, there it is no straight
    line, and gaps change sides on the way.
    """
    known: dict[str, tuple[int, float]] = {}
    found: dict[int, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is not None:
            hypothesis = simulator.hypotheses[column.hypothesis]
            parameter = hypothesis.parameters[column.at]
            if parameter.unit != FACTOR:
                known.setdefault(hypothesis.name, (k, parameter.typical))
        elif (name := simulator.uncertain[column.at].like) in known:
            found[k] = known[name]
        else:
            known[name] = k, 1.0
    return found


def slopes_from(simulator: ArmSimulator, columns: Sequence[Column]) -> dict[int, tuple[int, float]]:
    """Hypotheses that take their slope from a nuisance: its column, and how much of it a typical size is.

    Where they are small they are the same thing. With slopes from different steps, the difference would look
    like something that the nuisance cannot explain.
    """
    same = alike(simulator, columns)
    own = {
        simulator.uncertain[column.at].like: k
        for k, column in enumerate(columns)
        if column.hypothesis is None and k not in same
    }
    found: dict[int, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is None:
            continue
        hypothesis = simulator.hypotheses[column.hypothesis]
        if hypothesis.name in own:
            found[k] = own[hypothesis.name], hypothesis.parameters[column.at].typical
    return found


def sides_of(simulator: ArmSimulator, column: Column) -> int:
    """On how many sides of nominal there is something to simulate: one if bounds leave one."""
    return len(_ends(simulator, column, 1.0))


def takes_long(simulator: ArmSimulator, column: Column) -> bool:
    """Whether the arm is stepped to its rests, too."""
    return any(isinstance(effect, MOVES_ON) for effect in _whole(simulator, column).effects)


def together(
    simulator: ArmSimulator, columns: Sequence[Column], wanted: Sequence[int]
) -> list[tuple[int, ...]]:
    """Which of the columns that are wanted are simulated at once, what takes long first."""
    groups: dict[Hashable, list[int]] = {}
    for k in wanted:
        groups.setdefault(_kind(simulator, columns[k]) or k, []).append(k)
    found = sorted(groups.values(), key=lambda of: (not takes_long(simulator, columns[of[0]]), -len(of)))
    return [tuple(of) for of in found]


def _kind(simulator: ArmSimulator, column: Column) -> tuple[str, int | None] | None:
    """What it is, wherever it is; None if it does not stay in a joint, or the arm is stepped to its rests."""
    whole = _whole(simulator, column)
    if takes_long(simulator, column) or _joint_of(whole) is None:
        return None
    return type(whole.effects[0]).__name__, None if column.hypothesis is None else column.at


def size_of(simulator: ArmSimulator, column: Column, share: float) -> float:
    """What a share of a typical size is within bounds, upwards if there is room."""
    return _ends(simulator, column, share)[0].size


def sides_at(
    simulator: ArmSimulator, columns: Sequence[Column], nominal: Array, number: int, shares: Sequence[float]
) -> list[Side]:
    """The changes on one side of columns that are simulated at once, each by a share of a typical size.

    Of repeats only the first is simulated: the others were given the same drive.
    """
    ends = [_ends(simulator, column, by)[number] for column, by in zip(columns, shares, strict=True)]
    if _kind(simulator, columns[0]) is None:
        changes = [_alone(simulator, columns[0], ends[0], nominal)]
    else:
        changes = _each(simulator, ends, nominal)
    return [Side(by, end.size, change) for by, end, change in zip(shares, ends, changes, strict=True)]


def _alone(simulator: ArmSimulator, column: Column, end: _End, nominal: Array) -> Array:
    if column.hypothesis is None and (beside := simulator.uncertain[column.at].beside):
        simulator = simulator.patched(beside)
        nominal = simulator.predicted(())
    return changed(simulator, end.effects, nominal)


def _each(simulator: ArmSimulator, ends: Sequence[_End], nominal: Array) -> list[Array]:
    """Motions simulated once, with all effects, and each joint's own of it; rests one by one."""
    every = tuple(effect for end in ends for effect in end.effects)
    moved = changed(simulator, every, nominal)
    moving = np.arange(moved.size) < sum(len(one.features) for one in simulator.campaign.moving)
    found = []
    for end in ends:
        own = moving & _at(simulator, _joint_of(end))
        found.append(np.where(own, moved, changed(simulator, end.effects, nominal, none_of)))
    return found


def _at(simulator: ArmSimulator, name: str | None) -> Flags:
    """Features at a place, (m,)."""
    return np.array([place == name for place in simulator.layout.places])[simulator.layout.place]


def _joint_of(end: _End) -> str | None:
    """The joint that it sits at, by name; None if it sits elsewhere."""
    (effect,) = end.effects
    joint = getattr(effect, "joint", None)
    return None if joint is None else Joint(joint).name.lower()


def _whole(simulator: ArmSimulator, column: Column) -> _End:
    """A typical size, upwards if there is room."""
    return _ends(simulator, column, 1.0)[0]


def _ends(simulator: ArmSimulator, column: Column, share: float) -> tuple[_End, ...]:
    """Up and down, where bounds allow it."""
    found = (_end(simulator, column, sign * share) for sign in (1.0, -1.0))
    return tuple(end for end in found if end is not None)


def _end(simulator: ArmSimulator, column: Column, share: float) -> _End | None:
    """None where there is nothing on that side."""
    zero = np.zeros(len(simulator.nuisances))
    if column.hypothesis is None:
        one = simulator.uncertain[column.at]
        if share < 0.0 and one.one_sided:
            return None
        zero[column.at] = 1.0 if one.one_sided else np.sign(share) * one.nuisance.sigma
        return _End(tuple(simulator.effects({}, zero)), float(zero[column.at]))
    hypothesis = simulator.hypotheses[column.hypothesis]
    parameter, values = hypothesis.parameters[column.at], hypothesis.absent
    absent = values[column.at]
    values[column.at] = np.clip(absent + share * parameter.typical, parameter.least, parameter.most)
    if values[column.at] == absent:
        return None
    size = float((values[column.at] - absent) / parameter.typical)
    return _End(tuple(simulator.effects({hypothesis: values}, zero)), size)
