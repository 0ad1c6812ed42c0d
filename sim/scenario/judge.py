"""Judgement of a scenario by the true states of the plant: each check has a value and bounds."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf, nan
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAborted, CommandRefused, Evr
from fsw.kinematics.transforms import Array, angle_between, normalize
from fsw.protect.responses import RESPONSE_TO, Response
from sim.clearance import tool_forces
from sim.frames import p_R_from_N
from sim.loop import ClosedLoop
from sim.record import CycleRecord
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
from sim.scenario.records import upper_snake
from sim.sequence import Outcome
from sim.setting import Surface


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Plant at the end of a cycle, by tool; vectors in RMECH axes."""

    command: int
    """Number of the present command, from 1."""
    p_RoTo_R_m: Mapping[str, Array]
    """Position of each tool, shape (3,)."""
    R_RT: Mapping[str, Array]
    """Rotation of each tool, shape (3, 3)."""
    force_R_N: Mapping[str, Array]
    """Contact force on each tool, shape (3,)."""
    closed: Mapping[str, NDArray[np.bool_]]
    """Switches of each tool that are closed, as this cycle read them."""
    pads_R_m: Mapping[str, Array]
    """Positions of the switches of each tool, shape (n, 3)."""
    vibrates: bool


@dataclass(frozen=True, slots=True, eq=False)
class Ending:
    """State of plant and flight software at the end of a scenario."""

    outcome: Outcome
    mode: Mode
    """Mode of flight software."""
    output_rad: Array
    """True output angles, shape (5,)."""
    braked: bool
    """True if every brake is on and no motor has power."""
    refuses: bool
    """True if a command to move after the end was refused."""
    evrs: tuple[tuple[float, Evr], ...]
    """Time [s] and event."""
    pending_faults: int = 0
    """Number of faults of the scenario that have not begun."""


@dataclass(slots=True)
class Trace:
    """Record of what the checks need of the cycles so far; its size does not depend on their number."""

    ends: dict[int, Snapshot] = field(default_factory=dict)
    """Last snapshot of each command that began."""
    peaks: dict[tuple[Check, str], float] = field(default_factory=dict)
    """Largest value of what a check measures in more than one cycle, by its name."""
    touched_R_m: dict[tuple[Check, int], Array] = field(default_factory=dict)
    """Position of each switch when a check first found it closed, shape (3,)."""


def take_snapshot(loop: ClosedLoop, record: CycleRecord, command: int) -> Snapshot:
    """Record the state of the plant after a cycle."""
    plant, truth, closed = loop.plant, loop.truth(), record.sensors.switch_closed
    pads_R_m, switches = plant.pads_R_m(), loop.config.protection.tool_switches
    return Snapshot(
        command=command,
        p_RoTo_R_m=dict(zip(plant.tools, truth.p_RoTo_R_m, strict=True)),
        R_RT=dict(zip(plant.tools, truth.R_RT, strict=True)),
        force_R_N=dict(zip(plant.tools, tool_forces(plant), strict=True)),
        closed={tool: closed[list(found)] for tool, found in switches.items()},
        pads_R_m={tool: pads_R_m[list(found)] for tool, found in switches.items()},
        vibrates=record.outputs.drive.vibrate,
    )


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


def needs_snapshot(scenario: Scenario, record: CycleRecord, command: int) -> bool:
    """Return whether a check may need the true state after a cycle; a command ends with an event, or idle."""
    outputs = record.outputs
    return (
        not outputs.joint.busy
        or bool(outputs.evrs)
        or outputs.drive.vibrate
        or any(isinstance(check, Preloaded) and check.after <= command for check in scenario.checks)
    )


def note_snapshot(scenario: Scenario, trace: Trace, snapshot: Snapshot) -> None:
    """Add to a trace what the checks of a scenario need of a cycle."""
    trace.ends[snapshot.command] = snapshot
    for check in scenario.checks:
        for name, value in _measure_cycle(check, scenario, trace, snapshot):
            # unlike max, this keeps a value that is no number
            trace.peaks[check, name] = float(np.maximum(trace.peaks.get((check, name), -inf), value))


def _measure_cycle(
    check: Check, scenario: Scenario, trace: Trace, snapshot: Snapshot
) -> Iterator[tuple[str, float]]:
    if isinstance(check, Preloaded) and snapshot.command >= check.after:
        normal, closed = _surface_normal(scenario), np.flatnonzero(snapshot.closed[check.tool]).tolist()
        force_R_N, pads_R_m = snapshot.force_R_N[check.tool], snapshot.pads_R_m[check.tool]
        normal_N = float(force_R_N @ normal)
        yield "most force", normal_N
        for switch in closed:
            trace.touched_R_m.setdefault((check, switch), pads_R_m[switch])
        if normal_N >= check.pressed_N:
            yield "lateral over normal force", _lateral(force_R_N, normal) / normal_N
            for switch in closed:  # a tool may roll, so each pad slips by itself
                yield "slip", _lateral(pads_R_m[switch] - trace.touched_R_m[check, switch], normal)
    if isinstance(check, GravityHeld) and snapshot.command == check.during and snapshot.vibrates:
        yield "gravity off", _gravity_off_rad(check, scenario.world.gravity_N_m_s2, snapshot)


def evaluate_checks(
    scenario: Scenario, stowed_rad: Array, trace: Trace, ending: Ending
) -> tuple[CheckResult, ...]:
    """Evaluate every check of a scenario, in its order."""
    found = [
        replace(measured, check=upper_snake(type(check)).lower())
        for check in scenario.checks
        for measured in _evaluate(check, scenario, stowed_rad, trace, ending)
    ]
    if scenario.faults:
        found.append(replace(_bool_result("every fault came", not ending.pending_faults), check="fault"))
    return tuple(found)


def _evaluate(
    check: Check, scenario: Scenario, stowed_rad: Array, trace: Trace, ending: Ending
) -> tuple[CheckResult, ...]:
    match check:
        case Done():
            ended_early = any(isinstance(evr, CommandAborted | CommandRefused) for _, evr in ending.evrs)
            is_done = ending.outcome is Outcome.DONE and not ended_early
            return (_bool_result("every command carried out", is_done),)
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
            off = float(np.abs(ending.output_rad - stowed_rad).max())
            known = ending.mode is Mode.STOWED
            return CheckResult("farthest joint from it", off, "rad", high=check.angle_rad), _bool_result(
                "known", known
            )
        case Faulted():
            return _check_faulted(check, ending)
        case Recovered():
            came, done = _has_evr(check.evr, ending), ending.outcome is Outcome.DONE
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
    first = trace.ends.get(check.first_after)
    spot = np.full(3, nan) if first is None else first.p_RoTo_R_m[check.first_tool]
    lateral = _value_after(trace, check.after, lambda m: _lateral(m.p_RoTo_R_m[check.tool] - spot, normal))
    return (
        CheckResult("lateral", lateral, "m", high=check.lateral_m),
        _contact_result(trace, check.first_after, check.first_tool),
        _contact_result(trace, check.after, check.tool),
    )


def _check_preloaded(check: Preloaded, normal: Array, trace: Trace) -> tuple[CheckResult, ...]:
    """Check force at the end of the command, and the peaks from its start to the end of the run."""

    def peak(name: str, unit: str, high: float) -> CheckResult:
        return CheckResult(name, trace.peaks.get((check, name), nan), unit, high=high)

    return (
        _force_result(trace, normal, check.after, check.tool, check.force_N, check.share),
        peak("most force", "N", check.max_N),
        peak("lateral over normal force", "", check.ratio),
        peak("slip", "m", check.slip_m),
    )


def _check_gravity(check: GravityHeld, gravity_R_m_s2: Array, trace: Trace) -> CheckResult:
    at_end_rad = _value_after(trace, check.during, lambda m: _gravity_off_rad(check, gravity_R_m_s2, m))
    most_rad = max(at_end_rad, trace.peaks.get((check, "gravity off"), at_end_rad))
    return CheckResult("gravity off", most_rad, "rad", high=check.angle_rad)


def _gravity_off_rad(check: GravityHeld, gravity_R_m_s2: Array, snapshot: Snapshot) -> float:
    return angle_between(snapshot.R_RT[check.tool].T @ gravity_R_m_s2, np.array(check.gravity_T))


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
    force = _value_after(
        trace, max(trace.ends, default=0), lambda m: float(np.linalg.norm(m.force_R_N[check.tool]))
    )
    return CheckResult("force", force, "N", high=CONTACT_THRESHOLD_N)


def _check_faulted(check: Faulted, ending: Ending) -> tuple[CheckResult, ...]:
    """Check event and brakes, and the refusal of moves if that is the response to the fault."""
    refuses = () if check.evr in STOP_ONLY_FAULTS else (_bool_result("refuses", ending.refuses),)
    return (
        _bool_result(check.evr, _has_evr(check.evr, ending)),
        _bool_result("braked", ending.braked),
        *refuses,
    )


def _has_evr(evr_name: str, ending: Ending) -> bool:
    return any(evr.name == evr_name for _, evr in ending.evrs)


def _force_result(
    trace: Trace, away: Array, after: int, tool: str, force_N: float, share: float
) -> CheckResult:
    """Check the force of a tool along the unit vector `away`."""
    force = _value_after(trace, after, lambda m: float(m.force_R_N[tool] @ away))
    return CheckResult("force", force, "N", (1 - share) * force_N, (1 + share) * force_N)


def _contact_result(trace: Trace, after: int, tool: str) -> CheckResult:
    closed = _value_after(trace, after, lambda m: float(m.closed[tool].any()))
    return _bool_result(f"{tool} in contact", closed == 1.0)


def _bool_result(name: str, is_so: bool) -> CheckResult:
    return CheckResult(name, float(is_so), "", low=1.0, high=1.0)


def _value_after(trace: Trace, command: int, measure: Callable[[Snapshot], float]) -> float:
    """Measure at the end of a command; NaN if it did not begin."""
    snapshot = trace.ends.get(command)
    return nan if snapshot is None else measure(snapshot)


def _lateral(v: Array, normal: Array) -> float:
    """Return the length of a vector across a unit vector."""
    return float(np.linalg.norm(v - (v @ normal) * normal))


def _surface_normal(scenario: Scenario) -> Array:
    """Return the unit normal out of the surface."""
    return normalize(_surface(scenario).normal_N)


def _surface(scenario: Scenario) -> Surface:
    """Return the surface of the world; a scenario file with this check has one."""
    if scenario.world.surface is None:
        raise ValueError(f"{scenario.name}: a check of contact needs a surface in its world")
    return scenario.world.surface


def _find_taught_point(scenario: Scenario, name: str) -> TaughtPoint:
    return next(point for point in scenario.taught if point.name == name)
