"""Traces of held-out motions, measured and predicted; and errors in the units in which a user logs."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import degrees
from typing import Final, TypeVar

import numpy as np

from simgap.arrays import Array, Integers
from simgap.logs import Motion, Usable
from simgap.residuals.residuals import ResidualModel
from simgap.residuals.simulation_residuals import SimulationResiduals, list_kinds
from simgap.result import Diagnosis, JointError, Remainder
from simgap.robot import Robot

MAX_POINTS: Final = 2000
"""Points of a trace up to which a page shows all: about two for each pixel of a wide screen."""
PARTS: Final = 500
"""Parts of a longer trace, of each of which the extremes are shown: some three pixels of a wide screen."""
SIMULATION: Final = SimulationResiduals.kind
"""Kind of residual whose traces also show what was measured; of others, the residuals alone are known."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One joint in one motion."""

    joint: str
    kind: str
    """Kind of residual: `ResidualModel.kind`."""
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
    """Predict the motions of a residual model without and with what a diagnosis has found."""
    effects, sizes = diagnosis.fitted_to(model.kind)
    _, reference = diagnosis.fitted_to(model.kind, is_reference=True)
    points = [np.concatenate([np.zeros(0), *map(np.asarray, part)]) for part in (reference, sizes)]
    nominal, explained = model.residuals(effects, np.stack(points))
    measured = model.explain("position") if model.kind == SIMULATION else None
    return tuple(_cut(model, nominal, explained, measured))


def trace_motions(
    robot: Robot, motions: Sequence[Motion], diagnosis: Diagnosis, usable: Usable | None = None
) -> tuple[Trace, ...]:
    """Predict motions without and with what was found, by each kind of residual that was used.

    None is simulated in which a joint has no command. RobotError says that a motion cannot be predicted.
    """
    driven = [one for one in motions if all(log.command is not None for log in one.joints.values())]
    found: list[Trace] = []
    for kind in list_kinds(robot, motions, usable):
        part = driven if kind.name == SIMULATION else motions
        if part and kind.name in diagnosis.kinds:
            found += make_traces(kind.make(part, True), diagnosis)
    return tuple(found)


def _cut(model: ResidualModel, nominal: Array, explained: Array, measured: Array | None) -> Iterator[Trace]:
    """Yield the traces of joints and motions that have samples."""
    for joint, name in enumerate(model.joints):
        for motion, title in enumerate(model.motions):
            at = np.flatnonzero((model.joint_of == joint) & (model.motion_of == motion))
            if at.size:
                own = None if measured is None else measured[at]
                unit, time_s = model.units[joint], model.time_s[at]
                yield Trace(name, model.kind, title, unit, time_s, own, nominal[at], explained[at])


def choose_traces(traces: Iterable[Trace]) -> dict[tuple[str, str], tuple[Trace, ...]]:
    """Return for each joint and kind of residual the traces with the largest, middle and smallest error.

    The error is that with the findings. So a page shows the worst as well as the best, and its size does not
    grow with the number of motions.
    """
    chosen: dict[tuple[str, str], tuple[Trace, ...]] = {}
    every = list(traces)
    for place in dict.fromkeys((one.joint, one.kind) for one in every):
        own = [one for one in every if (one.joint, one.kind) == place]
        own.sort(key=lambda one: float(np.mean(np.abs(one.explained))), reverse=True)
        chosen[place] = tuple(own[k] for k in sorted({0, len(own) // 2, len(own) - 1}))
    return chosen


def thin(one: Trace) -> Trace:
    """Return a trace without points that a screen would not show; extremes stay."""
    shown = [*([] if one.measured is None else [one.measured]), one.nominal, one.explained]
    at = extreme_rows(shown)
    measured = None if one.measured is None else one.measured[at]
    kept = replace(one, nominal=one.nominal[at], explained=one.explained[at])
    return replace(kept, time_s=one.time_s[at], measured=measured)


def extreme_rows(series: Iterable[Array]) -> Integers:
    """Return the rows with the smallest and the largest value of each series, (n,), in many equal parts.

    Returns:
        Indices in order, two for each series and part; all where there are no more than MAX_POINTS.
    """
    rows: list[Integers] = []
    for values in series:
        if values.size <= MAX_POINTS:
            return np.arange(values.size)
        parts = np.array_split(np.nan_to_num(values), PARTS)
        first = np.cumsum([0, *(part.size for part in parts[:-1])])
        rows += [first + [int(find(part)) for part in parts] for find in (np.argmin, np.argmax)]
        rows.append(np.array([0, values.size - 1]))
    return np.unique(np.concatenate(rows))


MOTOR_SIDE = "N m of the motor"
ERRORS = ("nominal", "base", "explained", "noise_floor")
Measured = TypeVar("Measured", JointError, Remainder)


def find_user_unit(robot: Robot, joint: str, unit: str) -> tuple[str, float]:
    """Return the unit in which a joint is logged for one of the engine, and what errors are multiplied by."""
    table = None if robot.file is None else robot.file.joints.get(joint)
    if table is None:
        return unit, 1.0
    if unit == "rad" and table.position.unit == "deg":
        return "deg", degrees(1.0)
    if unit in ("N m", "N") and table.torque is not None and table.torque.side == "motor":
        return MOTOR_SIDE, 1.0 / table.gear_ratio
    return unit, 1.0


def convert_errors(robot: Robot, diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis whose errors and remainders are in the units of the user."""
    return replace(
        diagnosis,
        errors=tuple(_convert(robot, one, *ERRORS) for one in diagnosis.errors),
        remaining=tuple(_convert(robot, one, "mean_abs") for one in diagnosis.remaining),
    )


def convert_trace(robot: Robot, trace: Trace) -> Trace:
    """Return a trace in the unit of the user."""
    unit, factor = find_user_unit(robot, trace.joint, trace.unit)
    measured = None if trace.measured is None else factor * trace.measured
    explained = factor * trace.explained
    return replace(trace, unit=unit, measured=measured, nominal=factor * trace.nominal, explained=explained)


def _convert(robot: Robot, one: Measured, *numbers: str) -> Measured:
    unit, factor = find_user_unit(robot, one.joint, one.unit)
    return replace(one, unit=unit, **{name: factor * getattr(one, name) for name in numbers})
