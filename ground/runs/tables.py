"""Results as tables for people and as documents for programs; degrees and millimetres begin here."""

from math import degrees
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from fsw.dictionary.evrs import Evr, Severity
from ground.render.console import WARNED, plain_console
from ground.runs.artifacts import Kept
from ground.runs.place import PlaceReport
from ground.telemetry.events import json_fields
from sim.placement import PlacementError


def place_json(report: PlaceReport) -> dict[str, Any]:
    """A placement as a JSON document."""
    request, result = report.request, report.result
    contact, standoff = result.contact, result.standoff
    return {
        "outcome": result.outcome.value,
        "tool": request.tool.lower(),
        "arm": request.arm,
        "branch": result.branch,
        "duration_s": result.duration_s,
        "realtime_factor": report.realtime_factor,
        "error_mm": None if contact is None else _error_mm(contact),
        "axis_error_deg": None if contact is None else degrees(contact.axis_rad),
        "standoff_error_mm": None if standoff is None else _error_mm(standoff),
        "standoff_axis_error_deg": None if standoff is None else degrees(standoff.axis_rad),
        "target_m": list(request.target_m),
        "normal": list(request.normal),
        "tilt_deg": {"roll": request.tilt_roll_deg, "pitch": request.tilt_pitch_deg},
        "seed": request.seed,
        "params_sha256": report.params_sha256,
        "evrs": [evr_json(time_s, evr) for time_s, evr in (*result.evrs, *report.kept.events)],
        "log": None if request.files.log is None else str(request.files.log),
        **kept_json(report.kept),
    }


def place_table(report: PlaceReport) -> None:
    """Print a placement: a short table, the warnings, and where the files are."""
    result, request = report.result, report.request
    console = plain_console()
    table = Table(
        title=f"{request.tool.upper()} on {request.arm} arm: {result.outcome.value}", title_justify="left"
    )
    table.add_column("")
    for name in ("total mm", "lateral mm", "normal mm", "axis deg", "backlash mm"):
        table.add_column(name, justify="right")
    for name, error in (("at the standoff", result.standoff), ("in contact", result.contact)):
        if error is not None:
            table.add_row(name, *_cells(error))
    console.print(table)
    console.print(f"branch    {result.branch or 'none'}")
    console.print(
        f"duration  {result.duration_s:.1f} s of Mars time, {report.realtime_factor:.0f} times real time"
    )
    for time_s, evr in result.evrs:
        if evr.severity >= Severity.WARNING_LO:
            console.print(f"{time_s:8.2f} s  {evr.severity.name}  {evr.message}", style=WARNED)
    kept_table(console, report.kept, request.files.log)


def kept_json(kept: Kept) -> dict[str, Any]:
    """What was kept of a run, for its document."""
    return {
        "log_problem": kept.log_problem,
        "picture": None if kept.picture is None else _path(kept.picture.path),
        "movie": None if kept.movie is None else _path(kept.movie.path),
    }


def kept_table(console: Console, kept: Kept, log: Path | None) -> None:
    """Print where the files are, or why there are none."""
    for name, drawn in (("picture", kept.picture), ("movie", kept.movie)):
        if drawn is not None:
            console.print(
                f"{name:<9} {drawn.path or 'none'}" + (f"  ({drawn.hint})" if drawn.hint else ""),
                soft_wrap=True,
            )
    if log is not None:
        console.print(f"log       {kept.log_problem or log}", soft_wrap=True)


def _cells(error: PlacementError) -> tuple[str, ...]:
    mm = (error.total_m, error.lateral_m, error.normal_m)
    return (
        *(f"{1e3 * v:.2f}" for v in mm),
        f"{degrees(error.axis_rad):.3f}",
        f"{1e3 * error.backlash_m:.2f}",
    )


def _error_mm(error: PlacementError) -> dict[str, float]:
    return {
        "total": 1e3 * error.total_m,
        "lateral": 1e3 * error.lateral_m,
        "normal": 1e3 * error.normal_m,
        "backlash": 1e3 * error.backlash_m,
    }


def evr_json(time_s: float, evr: Evr) -> dict[str, Any]:
    """An event and its time as a JSON document."""
    return {
        "time_s": time_s,
        "name": evr.name,
        "severity": evr.severity.name,
        "message": evr.message,
        "fields": json_fields(evr),
    }


def _path(path: Any) -> str | None:
    return None if path is None else str(path)
