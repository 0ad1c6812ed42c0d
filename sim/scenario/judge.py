"""Evaluation of scenarios: each check against the true state of the plant, with value and bounds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from typing import Final, assert_never

import numpy as np

from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAborted, CommandRefused
from fsw.kinematics.transforms import Array, angle_between, normalize
from fsw.protect.responses import RESPONSE_TO, Response
from sim.frames import p_R_from_N
from sim.scenario.data import (
    CONTACT_THRESHOLD_N,
    Check,
    Docked,
    Done,
    Faulted,
    GravityHeld,
    Loaded,
    OverInlet,
    Placed,
    Preloaded,
    Recovered,
    Released,
    SameSpot,
    Scenario,
    Stowed,
    TaughtPoint,
)
from sim.scenario.names import upper_snake
from sim.scenario.trace import Snapshot, Trace, is_touching
from sim.sequence import Outcome
from sim.world import Surface

STOP_ONLY_FAULTS: Final = {
    fault.__name__ for fault, response in RESPONSE_TO.items() if response is Response.STOP_AND_BRAKE
}
"""Faults after which commands are accepted."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Value of a check in SI units, and its bounds."""

    name: str
    value: float
    """NaN if the scenario ended before."""
    unit: str
    """Empty for yes (1) or no (0) and for plain numbers."""
    low: float = -inf
    high: float = inf
    check: str = ""
    """Name of the check in a scenario file."""

    @property
    def passed(self) -> bool:
        """Return whether the value is within its bounds; NaN is not."""
        return self.low <= self.value <= self.high


def evaluate_checks(scenario: Scenario, stowed_rad: Array, trace: Trace) -> tuple[CheckResult, ...]:
    """Evaluate every check of a scenario, in its order.

    Args:
        scenario: Scenario that was run.
        stowed_rad: Output angles of the stowed pose, shape (5,).
        trace: True states of the run.
    """
    found = [
        replace(measured, check=upper_snake(type(check)).lower())
        for check in scenario.checks
        for measured in _evaluate(check, scenario, stowed_rad, trace)
    ]
    if scenario.faults:
        found.append(
            replace(_bool_result("every fault came", not trace.ending.pending_faults), check="fault")
        )
    return tuple(found)


def _evaluate(check: Check, scenario: Scenario, stowed_rad: Array, trace: Trace) -> tuple[CheckResult, ...]:
    match check:
        case Done():
            return (_bool_result("every command carried out", _all_done(trace)),)
        case Placed():
            return _check_placed(check, scenario, trace)
        case SameSpot():
            return _check_same_spot(check, _surface_normal(scenario), trace)
        case Preloaded():
            return _check_preloaded(check, _surface_normal(scenario), trace)
        case Loaded():
            point = _find_taught_point(scenario, check.point)
            away = -normalize(point.approach_N)
            return (_force_result(trace, away, check.after, point.tool, check.force_N, check.share),)
        case GravityHeld():
            return (_check_gravity(check, scenario.world.gravity_N_m_s2, trace),)
        case OverInlet():
            return _check_over_inlet(check, scenario, trace)
        case Docked():
            return _check_docked(check, _find_taught_point(scenario, check.point), trace)
        case Released():
            return (_check_released(check, trace),)
        case Stowed():
            off = float(np.abs(trace.ending.output_rad - stowed_rad).max())
            known = trace.ending.mode is Mode.STOWED
            return CheckResult("farthest joint from it", off, "rad", high=check.angle_rad), _bool_result(
                "known", known
            )
        case Faulted():
            return _check_faulted(check, trace)
        case Recovered():
            came, done = _has_evr(check.evr, trace), trace.ending.outcome is Outcome.DONE
            return _bool_result(check.evr, came), _bool_result("the sequence went on to its end", done)
        case _:
            assert_never(check)


def _check_placed(check: Placed, scenario: Scenario, trace: Trace) -> tuple[CheckResult, ...]:
    target, normal = p_R_from_N(np.array(_surface(scenario).p_N_m)), _surface_normal(scenario)
    lateral = _value_after(trace, check.after, lambda m: _lateral(m.p_RoTo_R_m[check.tool] - target, normal))
    return CheckResult("lateral", lateral, "m", high=check.lateral_m), _contact_result(
        trace, check.after, check.tool
    )


def _check_same_spot(check: SameSpot, normal: Array, trace: Trace) -> tuple[CheckResult, ...]:
    first = trace.at_end_of(check.first_after)
    spot = np.full(3, nan) if first is None else first.p_RoTo_R_m[check.first_tool]
    lateral = _value_after(trace, check.after, lambda m: _lateral(m.p_RoTo_R_m[check.tool] - spot, normal))
    return (
        CheckResult("lateral", lateral, "m", high=check.lateral_m),
        _contact_result(trace, check.first_after, check.first_tool),
        _contact_result(trace, check.after, check.tool),
    )


def _check_preloaded(check: Preloaded, normal: Array, trace: Trace) -> tuple[CheckResult, ...]:
    """Check force at the end of the command, and ratio and slip from its start while pressed."""
    snapshots = trace.since(check.after)
    normals = [float(m.force_R_N[check.tool] @ normal) for m in snapshots]
    pressed = [(m, f) for m, f in zip(snapshots, normals, strict=True) if f >= check.pressed_N]
    ratios = [_lateral(m.force_R_N[check.tool], normal) / f for m, f in pressed]
    switches = range(snapshots[0].closed[check.tool].size) if snapshots else ()
    slips = [slip for switch in switches for slip in _slips(snapshots, switch, normal, check)]
    return (
        _force_result(trace, normal, check.after, check.tool, check.force_N, check.share),
        CheckResult("most force", _maximum(normals), "N", high=check.max_N),
        CheckResult("lateral over normal force", _maximum(ratios), "", high=check.ratio),
        CheckResult("slip", _maximum(slips), "m", high=check.slip_m),
    )


def _slips(snapshots: Sequence[Snapshot], switch: int, normal: Array, check: Preloaded) -> list[float]:
    """Return the shift of a pad across the normal since it touched: a tool may roll or turn on its pads."""
    tool = check.tool
    touched = [m for m in snapshots if m.closed[tool][switch]]
    return [
        _lateral(m.pads_R_m[tool][switch] - touched[0].pads_R_m[tool][switch], normal)
        for m in touched
        if float(m.force_R_N[tool] @ normal) >= check.pressed_N
    ]


def _check_gravity(check: GravityHeld, gravity_R_m_s2: Array, trace: Trace) -> CheckResult:
    snapshots = trace.during(check.during)
    held = [m for m in snapshots if m.vibrates] + list(snapshots[-1:])
    wanted = np.array(check.gravity_T)
    angles = [angle_between(m.R_RT[check.tool].T @ gravity_R_m_s2, wanted) for m in held]
    return CheckResult("gravity off", _maximum(angles), "rad", high=check.angle_rad)


def _check_over_inlet(check: OverInlet, scenario: Scenario, trace: Trace) -> tuple[CheckResult, ...]:
    point, gravity = _find_taught_point(scenario, check.point), scenario.world.gravity_N_m_s2
    inlet = p_R_from_N(np.array(point.p_N_m))
    off = _value_after(
        trace, check.after, lambda m: float(np.linalg.norm((m.p_RoTo_R_m[point.tool] - inlet)[:2]))
    )
    lean = _value_after(trace, check.after, lambda m: angle_between(m.R_RT[point.tool][:, 0], gravity))
    return (
        CheckResult("from the axis", off, "m", high=check.lateral_m),
        CheckResult("from gravity", lean, "rad", high=check.angle_rad),
    )


def _check_docked(check: Docked, point: TaughtPoint, trace: Trace) -> tuple[CheckResult, ...]:
    place, axis = p_R_from_N(np.array(point.p_N_m)), np.array(point.approach_N)
    off = _value_after(trace, check.after, lambda m: float(np.linalg.norm(m.p_RoTo_R_m[point.tool] - place)))
    lean = _value_after(trace, check.after, lambda m: angle_between(m.R_RT[point.tool][:, 0], axis))
    return (
        CheckResult("from the point", off, "m", high=check.distance_m),
        CheckResult("from the axis", lean, "rad", high=check.angle_rad),
        _contact_result(trace, check.after, point.tool),
    )


def _check_released(check: Released, trace: Trace) -> CheckResult:
    force = float(np.linalg.norm(trace.snapshots[-1].force_R_N[check.tool])) if trace.snapshots else nan
    return CheckResult("force", force, "N", high=CONTACT_THRESHOLD_N)


def _check_faulted(check: Faulted, trace: Trace) -> tuple[CheckResult, ...]:
    """Check event and brakes, and the refusal of moves if that is the response to the fault."""
    refuses = () if check.evr in STOP_ONLY_FAULTS else (_bool_result("refuses", trace.ending.refuses),)
    return (
        _bool_result(check.evr, _has_evr(check.evr, trace)),
        _bool_result("braked", trace.ending.braked),
        *refuses,
    )


def _has_evr(evr_name: str, trace: Trace) -> bool:
    return any(evr.name == evr_name for _, evr in trace.ending.evrs)


def _all_done(trace: Trace) -> bool:
    ended_early = any(isinstance(evr, CommandAborted | CommandRefused) for _, evr in trace.ending.evrs)
    return trace.ending.outcome is Outcome.DONE and not ended_early


def _force_result(
    trace: Trace, away: Array, after: int, tool: str, force_N: float, share: float
) -> CheckResult:
    """Check the force of a tool along the unit vector `away`."""
    force = _value_after(trace, after, lambda m: float(m.force_R_N[tool] @ away))
    return CheckResult("force", force, "N", (1 - share) * force_N, (1 + share) * force_N)


def _contact_result(trace: Trace, after: int, tool: str) -> CheckResult:
    return _bool_result(
        f"{tool.lower()} in contact",
        _value_after(trace, after, lambda m: float(is_touching(m, tool))) == 1.0,
    )


def _bool_result(name: str, is_so: bool) -> CheckResult:
    return CheckResult(name, float(is_so), "", low=1.0, high=1.0)


def _value_after(trace: Trace, command: int, measure: Callable[[Snapshot], float]) -> float:
    """Measure at the end of a command; NaN if it did not begin."""
    snapshot = trace.at_end_of(command)
    return nan if snapshot is None else measure(snapshot)


def _maximum(values: Sequence[float]) -> float:
    return max(values) if len(values) else nan


def _lateral(v: Array, normal: Array) -> float:
    """Return the length of a vector across a unit vector."""
    return float(np.linalg.norm(v - (v @ normal) * normal))


def _surface_normal(scenario: Scenario) -> Array:
    """Return the unit normal out of the surface."""
    return normalize(_surface(scenario).normal_N)


def _surface(scenario: Scenario) -> Surface:
    """Return the surface of the world; a scenario file with this check has one.

    Raises:
        ValueError: the world has no surface.
    """
    if scenario.world.surface is None:
        raise ValueError(f"{scenario.name}: a check of contact needs a surface in its world")
    return scenario.world.surface


def _find_taught_point(scenario: Scenario, name: str) -> TaughtPoint:
    return next(point for point in scenario.taught if point.name == name)
