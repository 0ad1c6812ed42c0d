"""Scenarios and what came of them as tables for people and as documents for programs."""

from math import degrees, isfinite
from typing import Any, Final

from rich.table import Table
from rich.text import Text

from fsw.dictionary.evrs import Severity
from ground.render.console import WARNED, cell, plain_console
from ground.runs.scenario import RunReport
from ground.runs.tables import evr_json, kept_json, kept_table
from sim.scenario.data import Scenario
from sim.scenario.effects import effect_text
from sim.scenario.judge import CheckResult
from sim.scenario.names import upper_snake

SHOWN: Final = {"m": ("mm", 1e3), "rad": ("deg", degrees(1.0))}
"""The unit that people read, and how many of it a unit of the house is."""


def run_json(report: RunReport) -> dict[str, Any]:
    """A run as a JSON document."""
    result, world = report.result, report.scenario.world
    return {
        "scenario": report.scenario.name,
        "outcome": result.outcome.value,
        "passed": report.passed,
        "arm": report.arm,
        "commands_begun": result.command,
        "checks": [_measured_json(measured) for measured in result.checks],
        "duration_s": result.duration_s,
        "realtime_factor": report.realtime_factor,
        "tilt_deg": {"roll": degrees(world.tilt_roll_rad), "pitch": degrees(world.tilt_pitch_rad)},
        "seed": report.request.seed,
        "effects": [effect_text(effect) for effect in report.scenario.effects],
        "params_sha256": report.params_sha256,
        "evrs": [evr_json(time_s, evr) for time_s, evr in (*result.evrs, *report.kept.events)],
        "log": None if report.request.files.log is None else str(report.request.files.log),
        **kept_json(report.kept),
    }


def run_table(report: RunReport) -> None:
    """Print a run: each check with its bounds, the warnings, and where the files are."""
    result, scenario = report.result, report.scenario
    console = plain_console()
    passed = "passed" if report.passed else "NOT passed"
    table = Table(
        title=f"{scenario.title} on {report.arm} arm: {result.outcome.value}, {passed}", title_justify="left"
    )
    for name in ("check", "", "measured", "bound", ""):
        table.add_column(name, justify="right" if name in ("measured", "bound") else "left")
    for measured in result.checks:
        table.add_row(*_cells(measured))
    console.print(table)
    number = result.command
    if result.outcome != "done" and number > 0:
        console.print(f"ended in  command {number}, {upper_snake(type(scenario.commands[number - 1]))}")
    console.print(
        f"duration  {result.duration_s:.1f} s of Mars time, {report.realtime_factor:.0f} times real time"
    )
    for time_s, evr in result.evrs:
        if evr.severity >= Severity.WARNING_LO:
            console.print(f"{time_s:8.2f} s  {evr.severity.name}  {evr.message}", style=WARNED)
    kept_table(console, report.kept, report.request.files.log)


def scenarios_json(scenarios: tuple[Scenario, ...]) -> list[dict[str, Any]]:
    """The scenarios that come with the house as a JSON document."""
    return [
        {
            "name": scenario.name,
            "title": scenario.title,
            "sentence": scenario.sentence,
            "start": scenario.start,
            "commands": [upper_snake(type(command)) for command in scenario.commands],
            "checks": [upper_snake(type(check)).lower() for check in scenario.checks],
        }
        for scenario in scenarios
    ]


def scenarios_table(scenarios: tuple[Scenario, ...]) -> None:
    """Print a line for each scenario that comes with the house."""
    width = max(len(scenario.name) for scenario in scenarios)
    for scenario in scenarios:
        plain_console().print(f"{scenario.name:<{width}}  {scenario.sentence}", soft_wrap=True)


def _measured_json(measured: CheckResult) -> dict[str, Any]:
    value, low, high, unit = _in_unit(measured)
    return {
        "check": measured.check,
        "name": measured.name,
        "value": _finite(value),
        "unit": unit or None,
        "low": _finite(low),
        "high": _finite(high),
        "passed": measured.passed,
    }


def _cells(measured: CheckResult) -> tuple[str | Text, ...]:
    value, low, high, unit = _in_unit(measured)
    end = cell("ok", "") if measured.passed else cell("NOT", WARNED)
    if low == high == 1.0:
        return measured.check, measured.name, "yes" if value == 1.0 else "no", "yes", end
    said = f"{value:.3g} {unit}".rstrip() if isfinite(value) else "not reached"
    most = f"at most {high:.3g}" if not isfinite(low) else f"{low:.3g} .. {high:.3g}"
    return measured.check, measured.name, said, f"{most} {unit}".rstrip(), end


def _in_unit(measured: CheckResult) -> tuple[float, float, float, str]:
    unit, factor = SHOWN.get(measured.unit, (measured.unit, 1.0))
    return factor * measured.value, factor * measured.low, factor * measured.high, unit


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None
