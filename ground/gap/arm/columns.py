"""One column of the sensitivities: differences of the arm's simulator beside nominal."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.arm.bound import changed
from ground.gap.arm.poses import MOVES_ON
from ground.gap.arm.simulator import ONLY_POSED, ArmSimulator
from ground.gap.arm.step import first_share
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
    """Nuisances that are a hypothesis or another nuisance as well: that one's column, and what 1 is of it."""
    known: dict[str, tuple[int, float]] = {}
    found: dict[int, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is not None:
            hypothesis = simulator.hypotheses[column.hypothesis]
            known.setdefault(hypothesis.name, (k, hypothesis.parameters[column.at].typical))
        elif (name := simulator.uncertain[column.at].like) in known:
            found[k] = known[name]
        else:
            known[name] = k, 1.0
    return found


def sides_of(simulator: ArmSimulator, column: Column) -> int:
    """On how many sides of nominal there is something to simulate: one if bounds leave one, or a line."""
    return len(_ends(simulator, column, 1.0))


def is_line(simulator: ArmSimulator, column: Column) -> bool:
    """Whether it is a straight line, as far as errors go: geometry and springs."""
    return all(isinstance(effect, ONLY_POSED) for effect in _whole(simulator, column).effects)


def takes_long(simulator: ArmSimulator, column: Column) -> bool:
    """Whether the arm is stepped to its rests, too."""
    return any(isinstance(effect, MOVES_ON) for effect in _whole(simulator, column).effects)


def size_of(simulator: ArmSimulator, column: Column, share: float) -> float:
    """What a share of a typical size is within bounds, upwards if there is room."""
    return _ends(simulator, column, share)[0].size


def side_of(
    simulator: ArmSimulator, column: Column, nominal: Array, number: int = 0, share: float | None = None
) -> Side:
    """The change on one of the sides, by a share of a typical size; without one, by what a probe says.

    Of repeats only the first is simulated: the others were given the same drive.
    """
    if column.hypothesis is None and (beside := simulator.uncertain[column.at].beside):
        simulator = simulator.patched(beside)
        nominal = simulator.predicted(())
    share = _probed(simulator, column, nominal) if share is None else share
    end = _ends(simulator, column, share)[number]
    return Side(share, end.size, changed(simulator, end.effects, nominal))


def _probed(simulator: ArmSimulator, column: Column, nominal: Array) -> float:
    """A share to begin with: from the motion that shows it most, in full size."""
    if column.hypothesis is None:
        return 1.0
    end = _whole(simulator, column)
    joints = {getattr(effect, "joint", None) for effect in end.effects} - {None}
    free = [one for one in simulator.campaign.moving if one.recording.world.surface is None]
    shown = [one for one in free if not {segment.joint for segment in one.segments} - joints]
    names = {one.recording.name for one in shown or free[-1:]}
    change = changed(simulator, end.effects, nominal, lambda one: one.recording.name in names)
    return first_share(abs(end.size), float(np.linalg.norm(change / simulator.layout.sigma)))


def _whole(simulator: ArmSimulator, column: Column) -> _End:
    """A typical size, upwards if there is room."""
    return _ends(simulator, column, 1.0)[0]


def _ends(simulator: ArmSimulator, column: Column, share: float) -> tuple[_End, ...]:
    """Up and down where bounds allow it; down only if it may bend."""
    found = (_end(simulator, column, sign * share) for sign in (1.0, -1.0))
    up, *down = (end for end in found if end is not None)
    straight = column.hypothesis is not None and all(isinstance(one, ONLY_POSED) for one in up.effects)
    return (up,) if straight else (up, *down)


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
