"""Reports of `marsarm place`, `run` and `scenarios`: JSON documents and tables."""

from math import degrees, isfinite
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from fsw.dictionary.evrs import Evr, Severity
from marsarm.runs.execution import Execution
from marsarm.runs.place import PlaceReport
from marsarm.runs.request import RunFiles
from marsarm.runs.scenario import RunReport
from marsarm.telemetry.events import json_fields
from sim.placement import PlacementError
from sim.scenario.data import Scenario
from sim.scenario.effects import effect_text
from sim.scenario.judge import CheckResult
from sim.scenario.records import upper_snake
from simgap.common.console import WARNING_STYLE, plain_console, styled_cell

DISPLAY_UNITS: Final = {"m": ("mm", 1e3), "rad": ("deg", degrees(1.0))}
"""Unit of reports for each SI unit, and the conversion factor."""


def place_json(report: PlaceReport) -> dict[str, Any]:
    """Return a placement as a JSON document."""
    request, execution = report.request, report.execution
    result = execution.result
    contact, standoff = result.contact, result.standoff
    return {
        "outcome": result.outcome.value,
        "tool": report.tool,
        "arm": request.arm,
        "branch": result.branch,
        "duration_s": result.duration_s,
        "realtime_factor": execution.realtime_factor,
        "error_mm": None if contact is None else _error_json(contact),
        "axis_error_deg": None if contact is None else degrees(contact.axis_rad),
        "standoff_error_mm": None if standoff is None else _error_json(standoff),
        "standoff_axis_error_deg": None if standoff is None else degrees(standoff.axis_rad),
        "target_m": list(request.target_m),
        "normal": list(request.normal),
        "tilt_deg": {"roll": request.tilt_roll_deg, "pitch": request.tilt_pitch_deg},
        "seed": request.seed,
        **_execution_json(execution, request.files),
    }


def place_table(report: PlaceReport) -> None:
    """Print a placement: a table of errors, the warnings, and the files."""
    request, result = report.request, report.execution.result
    console = plain_console()
    table = Table(title=f"{report.tool} on {request.arm} arm: {result.outcome.value}", title_justify="left")
    table.add_column("")
    for name in ("total mm", "lateral mm", "normal mm", "axis deg", "backlash mm"):
        table.add_column(name, justify="right")
    for name, error in (("at the standoff", result.standoff), ("in contact", result.contact)):
        if error is not None:
            table.add_row(name, *_error_cells(error))
    console.print(table)
    console.print(f"branch    {result.branch or 'none'}")
    _print_execution(console, report.execution, request.files)


def _execution_json(execution: Execution[Any], files: RunFiles) -> dict[str, Any]:
    """Return the end of the JSON document of a run: parameters, events and files."""
    artifacts = execution.artifacts
    return {
        "params_sha256": execution.params_sha256,
        "evrs": [evr_json(time_s, evr) for time_s, evr in (*execution.result.evrs, *artifacts.events)],
        "log": _path_text(files.log),
        "log_problem": artifacts.log_problem,
        "picture": None if artifacts.picture is None else _path_text(artifacts.picture.path),
        "movie": None if artifacts.movie is None else _path_text(artifacts.movie.path),
    }


def _print_execution(console: Console, execution: Execution[Any], files: RunFiles) -> None:
    """Print duration, warnings and files of a run, or the reasons why there are no files."""
    result, artifacts = execution.result, execution.artifacts
    console.print(
        f"duration  {result.duration_s:.1f} s of Mars time, {execution.realtime_factor:.0f} times real time"
    )
    for time_s, evr in result.evrs:
        if evr.severity >= Severity.WARNING_LO:
            console.print(f"{time_s:8.2f} s  {evr.severity.name}  {evr.message}", style=WARNING_STYLE)
    for name, drawn in (("picture", artifacts.picture), ("movie", artifacts.movie)):
        if drawn is not None:
            console.print(
                f"{name:<9} {drawn.path or 'none'}" + (f"  ({drawn.hint})" if drawn.hint else ""),
                soft_wrap=True,
            )
    if files.log is not None:
        console.print(f"log       {artifacts.log_problem or files.log}", soft_wrap=True)


def _error_cells(error: PlacementError) -> tuple[str, ...]:
    mm = (error.total_m, error.lateral_m, error.normal_m)
    return (
        *(f"{1e3 * v:.2f}" for v in mm),
        f"{degrees(error.axis_rad):.3f}",
        f"{1e3 * error.backlash_m:.2f}",
    )


def _error_json(error: PlacementError) -> dict[str, float]:
    return {
        "total": 1e3 * error.total_m,
        "lateral": 1e3 * error.lateral_m,
        "normal": 1e3 * error.normal_m,
        "backlash": 1e3 * error.backlash_m,
    }


def evr_json(time_s: float, evr: Evr) -> dict[str, Any]:
    """Return an event and its time as a JSON document."""
    return {
        "time_s": time_s,
        "name": evr.name,
        "severity": evr.severity.name,
        "message": evr.message,
        "fields": json_fields(evr),
    }


def _path_text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def run_json(report: RunReport) -> dict[str, Any]:
    """Return a run as a JSON document."""
    execution, world = report.execution, report.scenario.world
    result = execution.result
    return {
        "scenario": report.scenario.name,
        "outcome": result.outcome.value,
        "passed": report.passed,
        "arm": report.arm,
        "commands_begun": result.command,
        "checks": [_check_json(check) for check in result.checks],
        "duration_s": result.duration_s,
        "realtime_factor": execution.realtime_factor,
        "tilt_deg": {"roll": degrees(world.tilt_roll_rad), "pitch": degrees(world.tilt_pitch_rad)},
        "seed": report.request.seed,
        "effects": [effect_text(effect) for effect in report.scenario.effects],
        **_execution_json(execution, report.request.files),
    }


def run_table(report: RunReport) -> None:
    """Print a run: each check with its bounds, the warnings, and the files."""
    result, scenario = report.execution.result, report.scenario
    console = plain_console()
    passed = "passed" if report.passed else "NOT passed"
    table = Table(
        title=f"{scenario.title} on {report.arm} arm: {result.outcome.value}, {passed}", title_justify="left"
    )
    for name in ("check", "", "measured", "bound", ""):
        table.add_column(name, justify="right" if name in ("measured", "bound") else "left")
    for check in result.checks:
        table.add_row(*_check_cells(check))
    console.print(table)
    number = result.command
    if result.outcome != "done" and number > 0:
        console.print(f"ended in  command {number}, {upper_snake(type(scenario.commands[number - 1]))}")
    _print_execution(console, report.execution, report.request.files)


def scenarios_json(scenarios: tuple[Scenario, ...]) -> list[dict[str, Any]]:
    """Return the built-in scenarios as a JSON document."""
    return [
        {
            "name": scenario.name,
            "title": scenario.title,
            "summary": scenario.summary,
            "start": scenario.start,
            "commands": [upper_snake(type(command)) for command in scenario.commands],
            "checks": [upper_snake(type(check)).lower() for check in scenario.checks],
        }
        for scenario in scenarios
    ]


def scenarios_table(scenarios: tuple[Scenario, ...]) -> None:
    """Print a line for each built-in scenario."""
    width = max(len(scenario.name) for scenario in scenarios)
    for scenario in scenarios:
        plain_console().print(f"{scenario.name:<{width}}  {scenario.summary}", soft_wrap=True)


def _check_json(check: CheckResult) -> dict[str, Any]:
    value, low, high, unit = _in_display_unit(check)
    return {
        "check": check.check,
        "name": check.name,
        "value": _finite_or_none(value),
        "unit": unit or None,
        "low": _finite_or_none(low),
        "high": _finite_or_none(high),
        "passed": check.passed,
    }


def _check_cells(check: CheckResult) -> tuple[str | Text, ...]:
    value, low, high, unit = _in_display_unit(check)
    verdict = styled_cell("ok", "") if check.passed else styled_cell("NOT", WARNING_STYLE)
    if low == high == 1.0:
        return check.check, check.name, "yes" if value == 1.0 else "no", "yes", verdict
    measured = f"{value:.3g} {unit}".rstrip() if isfinite(value) else "not reached"
    bound = f"at most {high:.3g}" if not isfinite(low) else f"{low:.3g} .. {high:.3g}"
    return check.check, check.name, measured, f"{bound} {unit}".rstrip(), verdict


def _in_display_unit(check: CheckResult) -> tuple[float, float, float, str]:
    """Convert value, lower and upper bound of a check to the unit of reports."""
    unit, factor = DISPLAY_UNITS.get(check.unit, (check.unit, 1.0))
    return factor * check.value, factor * check.low, factor * check.high, unit


def _finite_or_none(value: float) -> float | None:
    return value if isfinite(value) else None
