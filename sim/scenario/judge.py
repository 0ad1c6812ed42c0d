"""Judging a scenario: each check against the truth of the plant, with what was measured and its bounds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from typing import Final, assert_never

import numpy as np

from fsw.dictionary.enums import TOOL_SWITCHES, Mode, Switch, Tool
from fsw.dictionary.evrs import CommandAborted, CommandRefused
from fsw.kinematics.transforms import Array, angle_between, normalize
from fsw.protect.responses import RESPONSE_TO, Response
from sim.frames import p_R_from_N
from sim.scenario.checks import (
    SOME_N,
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
    Stowed,
)
from sim.scenario.data import Scenario, Taught
from sim.scenario.names import upper_snake
from sim.scenario.trace import Moment, Trace, touches
from sim.sequence import Outcome
from sim.world import Surface

ONLY_STOPPED: Final = {
    fault.__name__ for fault, response in RESPONSE_TO.items() if response is Response.STOP_AND_BRAKE
}
"""Faults after which commands are accepted."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What was measured for a check, in SI, and between which bounds it has to be."""

    name: str
    value: float
    """NaN where the scenario did not come so far."""
    unit: str
    """Empty for yes (1) or no (0) and for plain numbers."""
    low: float = -inf
    high: float = inf
    check: str = ""
    """As a scenario file calls it."""

    @property
    def passed(self) -> bool:
        """Whether it is within its bounds; what was not measured is not."""
        return self.low <= self.value <= self.high


def judged(scenario: Scenario, stowed_rad: Array, trace: Trace) -> tuple[Measured, ...]:
    """Every check of a scenario, in its order; `stowed_rad` is the stowed pose."""
    found = [
        replace(measured, check=upper_snake(type(check)).lower())
        for check in scenario.checks
        for measured in _measured(check, scenario, stowed_rad, trace)
    ]
    if scenario.faults:
        found.append(replace(_yes("every fault came", not trace.ending.to_come), check="fault"))
    return tuple(found)


def _measured(check: Check, scenario: Scenario, stowed_rad: Array, trace: Trace) -> tuple[Measured, ...]:
    match check:
        case Done():
            return (_yes("every command carried out", _all_done(trace)),)
        case Placed():
            return _placed(check, scenario, trace)
        case SameSpot():
            return _same_spot(check, _normal(scenario), trace)
        case Preloaded():
            return _preloaded(check, _normal(scenario), trace)
        case Loaded():
            point = _taught(scenario, check.point)
            away = -normalize(point.approach_N)
            return (_force(trace, away, check.after, point.tool, check.force_N, check.share),)
        case GravityHeld():
            return (_gravity_held(check, scenario.world.gravity_N_m_s2, trace),)
        case OverInlet():
            return _over_inlet(check, scenario, trace)
        case Docked():
            return _docked(check, _taught(scenario, check.point), trace)
        case Released():
            return (_released(check, trace),)
        case Stowed():
            off = float(np.abs(trace.ending.output_rad - stowed_rad).max())
            known = trace.ending.mode is Mode.STOWED
            return Measured("farthest joint from it", off, "rad", high=check.angle_rad), _yes("known", known)
        case Faulted():
            return _faulted(check, trace)
        case Recovered():
            came, done = _said(check.evr, trace), trace.ending.outcome is Outcome.DONE
            return _yes(check.evr, came), _yes("the sequence went on to its end", done)
        case _:
            assert_never(check)


def _placed(check: Placed, scenario: Scenario, trace: Trace) -> tuple[Measured, ...]:
    target, normal = p_R_from_N(np.array(_surface(scenario).p_N_m)), _normal(scenario)
    lateral = _at(trace, check.after, lambda m: _lateral(m.p_RoTo_R_m[check.tool] - target, normal))
    return Measured("lateral", lateral, "m", high=check.lateral_m), _contact(trace, check.after, check.tool)


def _same_spot(check: SameSpot, normal: Array, trace: Trace) -> tuple[Measured, ...]:
    first = trace.at_end_of(check.first_after)
    spot = np.full(3, nan) if first is None else first.p_RoTo_R_m[check.first_tool]
    lateral = _at(trace, check.after, lambda m: _lateral(m.p_RoTo_R_m[check.tool] - spot, normal))
    return (
        Measured("lateral", lateral, "m", high=check.lateral_m),
        _contact(trace, check.first_after, check.first_tool),
        _contact(trace, check.after, check.tool),
    )


def _preloaded(check: Preloaded, normal: Array, trace: Trace) -> tuple[Measured, ...]:
    """Force at the end of the command; from its beginning on, while pressed, ratio and slip."""
    moments = trace.since(check.after)
    normals = [float(m.force_R_N[check.tool] @ normal) for m in moments]
    pressed = [(m, f) for m, f in zip(moments, normals, strict=True) if f >= check.pressed_N]
    ratios = [_lateral(m.force_R_N[check.tool], normal) / f for m, f in pressed]
    slips = [slip for switch in TOOL_SWITCHES[check.tool] for slip in _slips(moments, switch, normal, check)]
    return (
        _force(trace, normal, check.after, check.tool, check.force_N, check.share),
        Measured("most force", _most(normals), "N", high=check.most_N),
        Measured("lateral over normal force", _most(ratios), "", high=check.ratio),
        Measured("slip", _most(slips), "m", high=check.slip_m),
    )


def _slips(moments: Sequence[Moment], switch: Switch, normal: Array, check: Preloaded) -> list[float]:
    """How far across a pad has come since it touched: a tool may roll on its pads, or turn about one."""
    touched = [m for m in moments if m.closed[switch]]
    return [
        _lateral(m.pads_R_m[switch] - touched[0].pads_R_m[switch], normal)
        for m in touched
        if float(m.force_R_N[check.tool] @ normal) >= check.pressed_N
    ]


def _gravity_held(check: GravityHeld, gravity_R_m_s2: Array, trace: Trace) -> Measured:
    moments = trace.during(check.during)
    held = [m for m in moments if m.vibrates] + list(moments[-1:])
    wanted = np.array(check.gravity_T)
    angles = [angle_between(m.R_RT[check.tool].T @ gravity_R_m_s2, wanted) for m in held]
    return Measured("gravity off", _most(angles), "rad", high=check.angle_rad)


def _over_inlet(check: OverInlet, scenario: Scenario, trace: Trace) -> tuple[Measured, ...]:
    point, gravity = _taught(scenario, check.point), scenario.world.gravity_N_m_s2
    inlet = p_R_from_N(np.array(point.p_N_m))
    off = _at(trace, check.after, lambda m: float(np.linalg.norm((m.p_RoTo_R_m[point.tool] - inlet)[:2])))
    lean = _at(trace, check.after, lambda m: angle_between(m.R_RT[point.tool][:, 0], gravity))
    return (
        Measured("from the axis", off, "m", high=check.lateral_m),
        Measured("from gravity", lean, "rad", high=check.angle_rad),
    )


def _docked(check: Docked, point: Taught, trace: Trace) -> tuple[Measured, ...]:
    place, axis = p_R_from_N(np.array(point.p_N_m)), np.array(point.approach_N)
    off = _at(trace, check.after, lambda m: float(np.linalg.norm(m.p_RoTo_R_m[point.tool] - place)))
    lean = _at(trace, check.after, lambda m: angle_between(m.R_RT[point.tool][:, 0], axis))
    return (
        Measured("from the point", off, "m", high=check.distance_m),
        Measured("from the axis", lean, "rad", high=check.angle_rad),
        _contact(trace, check.after, point.tool),
    )


def _released(check: Released, trace: Trace) -> Measured:
    force = float(np.linalg.norm(trace.moments[-1].force_R_N[check.tool])) if trace.moments else nan
    return Measured("force", force, "N", high=SOME_N)


def _faulted(check: Faulted, trace: Trace) -> tuple[Measured, ...]:
    """Refusing is asked for where the response to the fault is to refuse."""
    refuses = () if check.evr in ONLY_STOPPED else (_yes("refuses", trace.ending.refuses),)
    return _yes(check.evr, _said(check.evr, trace)), _yes("braked", trace.ending.braked), *refuses


def _said(evr_name: str, trace: Trace) -> bool:
    return any(evr.name == evr_name for _, evr in trace.ending.evrs)


def _all_done(trace: Trace) -> bool:
    ended_early = any(isinstance(evr, CommandAborted | CommandRefused) for _, evr in trace.ending.evrs)
    return trace.ending.outcome is Outcome.DONE and not ended_early


def _force(trace: Trace, away: Array, after: int, tool: Tool, force_N: float, share: float) -> Measured:
    """The force along the unit vector `away` of what is pressed on."""
    force = _at(trace, after, lambda m: float(m.force_R_N[tool] @ away))
    return Measured("force", force, "N", (1 - share) * force_N, (1 + share) * force_N)


def _contact(trace: Trace, after: int, tool: Tool) -> Measured:
    return _yes(
        f"{tool.name.lower()} in contact", _at(trace, after, lambda m: float(touches(m, tool))) == 1.0
    )


def _yes(name: str, is_so: bool) -> Measured:
    return Measured(name, float(is_so), "", low=1.0, high=1.0)


def _at(trace: Trace, command: int, measure: Callable[[Moment], float]) -> float:
    """What is measured at the end of a command; NaN if it did not begin."""
    moment = trace.at_end_of(command)
    return nan if moment is None else measure(moment)


def _most(values: Sequence[float]) -> float:
    return max(values) if len(values) else nan


def _lateral(v: Array, normal: Array) -> float:
    """The length of a vector across a unit vector."""
    return float(np.linalg.norm(v - (v @ normal) * normal))


def _normal(scenario: Scenario) -> Array:
    """Of the surface, out of it, of length one."""
    return normalize(_surface(scenario).normal_N)


def _surface(scenario: Scenario) -> Surface:
    """The surface that this check is about; the reader of the file has seen that there is one."""
    if scenario.world.surface is None:
        raise ValueError(f"{scenario.name}: a check of contact needs a surface in its world")
    return scenario.world.surface


def _taught(scenario: Scenario, name: str) -> Taught:
    return next(point for point in scenario.taught if point.name == name)
