"""Traces of held-out motions: measured, simulated as the model is, and simulated with the findings."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Flags
from diagnosis.logs import Motion
from diagnosis.residuals.residuals import ResidualModel
from diagnosis.residuals.simulation_residuals import SimulationResiduals
from diagnosis.result import Diagnosis
from diagnosis.robot import Robot

MAX_POINTS: Final = 2000
"""Points of a trace on a page: about two for each pixel of a wide screen."""
MEASURED: Final = {"simulation": "position", "second encoder": "position", "inverse dynamics": "load"}
"""Variable of a residual model that is what it predicts; a kind that is not here shows residuals alone."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One joint in one motion."""

    joint: str
    motion: str
    unit: str
    time_s: Array
    """(n,)."""
    measured: Array | None
    """(n,); None if the residuals alone are known."""
    nominal: Array
    """Measured less predicted by the model as it is, (n,)."""
    explained: Array
    """Measured less predicted with base parameters and findings, (n,)."""


def make_traces(model: ResidualModel, diagnosis: Diagnosis) -> tuple[Trace, ...]:
    """Predict the motions of a residual model without and with what a diagnosis has found.

    Args:
        model: Residuals of the motions to show.
        diagnosis: Diagnosis with its effects and sizes.
    """
    found = np.concatenate([np.zeros(0), *(np.asarray(size, float) for size in diagnosis.sizes)])
    nominal, explained = model.residuals(diagnosis.effects, np.stack([np.zeros_like(found), found]))
    variable = MEASURED.get(model.kind)
    measured = None if variable is None else model.explain(variable)
    return tuple(_cut(model, nominal, explained, measured))


def trace_motions(
    robot: Robot,
    motions: Sequence[Motion],
    diagnosis: Diagnosis,
    usable: Mapping[tuple[str, str], Flags] | None = None,
) -> tuple[Trace, ...]:
    """Simulate motions without and with what a diagnosis has found.

    Args:
        robot: Robot that was diagnosed.
        motions: Motions to show.
        diagnosis: Diagnosis with its effects and sizes.
        usable: By names of motion and joint, flags over the position samples to show, (n,); all if absent.

    Returns:
        The traces; none of a motion in which a joint has no command, because it cannot be simulated.

    Raises:
        RobotError: A motion cannot be simulated.
    """
    driven = [one for one in motions if all(log.command is not None for log in one.joints.values())]
    return make_traces(SimulationResiduals(robot, driven, keep=usable), diagnosis) if driven else ()


def _cut(model: ResidualModel, nominal: Array, explained: Array, measured: Array | None) -> Iterator[Trace]:
    """Yield the traces of joints and motions that have samples."""
    for joint, name in enumerate(model.joints):
        for motion, title in enumerate(model.motions):
            at = np.flatnonzero((model.joint_of == joint) & (model.motion_of == motion))
            if at.size:
                own = None if measured is None else measured[at]
                yield Trace(name, title, model.unit, model.time_s[at], own, nominal[at], explained[at])


def choose_traces(traces: Iterable[Trace]) -> dict[str, tuple[Trace, ...]]:
    """Return the traces of each joint with the largest, the middle and the smallest error with findings.

    So a page shows the worst as well as the best, and its size does not grow with the number of motions.
    """
    chosen: dict[str, tuple[Trace, ...]] = {}
    every = list(traces)
    for joint in dict.fromkeys(one.joint for one in every):
        own = sorted((one for one in every if one.joint == joint), key=_error, reverse=True)
        chosen[joint] = tuple(own[k] for k in sorted({0, len(own) // 2, len(own) - 1}))
    return chosen


def thin(one: Trace) -> Trace:
    """Return a trace with at most MAX_POINTS points, evenly taken from all of them."""
    if one.time_s.size <= MAX_POINTS:
        return one
    at = np.linspace(0, one.time_s.size - 1, MAX_POINTS).round().astype(int)
    measured = None if one.measured is None else one.measured[at]
    return Trace(
        one.joint, one.motion, one.unit, one.time_s[at], measured, one.nominal[at], one.explained[at]
    )


def _error(one: Trace) -> float:
    return float(np.mean(np.abs(one.explained)))
