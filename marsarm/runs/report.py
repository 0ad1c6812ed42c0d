"""Reports of `marsarm place`, `run` and `hardstop`: their documents, and what they show on the console."""

from collections.abc import Sequence
from math import degrees, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr, JointCalibrated, Severity
from marsarm.telemetry.events import json_fields
from sim.scenario.effects import effect_text
from sim.scenario.records import upper_snake
from simgap.common.report import Emphasis, ReportTable, file_lines

if TYPE_CHECKING:  # a placement loads neither scenarios nor the homing of joints
    from marsarm.runs.execution import Artifacts, Execution
    from marsarm.runs.hardstop import HardstopReport
    from marsarm.runs.place import PlaceReport
    from marsarm.runs.request import RunFiles
    from marsarm.runs.scenario import RunReport
    from sim.placement import PlacementError
    from sim.scenario.data import Scenario
    from sim.scenario.judge import CheckResult

DISPLAY_UNITS: Final = {"m": ("mm", 1e3), "rad": ("deg", degrees(1.0))}
"""Unit of reports for each SI unit, and the conversion factor."""


def place_document(report: "PlaceReport") -> dict[str, Any]:
    """Collect a placement."""
    request, execution = report.request, report.execution
    result = execution.result
    contact, standoff = result.contact, result.standoff
    return {
        "outcome": result.outcome,
        "tool": report.tool,
        "arm": request.arm,
        "branch": result.branch,
        "duration_s": result.duration_s,
        "realtime_factor": execution.realtime_factor,
        "error_mm": contact and _error_mm(contact),
        "axis_error_deg": contact and degrees(contact.axis_rad),
        "standoff_error_mm": standoff and _error_mm(standoff),
        "standoff_axis_error_deg": standoff and degrees(standoff.axis_rad),
        "target_m": request.target_m,
        "normal": request.normal,
        "tilt_deg": {"roll": request.tilt_roll_deg, "pitch": request.tilt_pitch_deg},
        "seed": request.seed,
        **_execution_document(execution, request.files),
    }


def _error_mm(error: "PlacementError") -> dict[str, float]:
    names = ("total", "lateral", "normal", "backlash")
    return {name: 1e3 * float(getattr(error, f"{name}_m")) for name in names}


def place_parts(report: "PlaceReport") -> list[str | Emphasis | ReportTable]:
    """Show a placement: errors, warnings, and files."""
    request, result = report.request, report.execution.result
    rows = []
    for name, error in (("at the standoff", result.standoff), ("in contact", result.contact)):
        if error is not None:
            total, lateral, normal, backlash = (f"{value:.2f}" for value in _error_mm(error).values())
            rows.append((name, total, lateral, normal, f"{degrees(error.axis_rad):.3f}", backlash))
    head = ("", "total mm", "lateral mm", "normal mm", "axis deg", "backlash mm")
    title = f"{report.tool} on arm {request.arm}: {result.outcome.value}"
    branch = f"branch    {result.branch or 'none'}"
    return [ReportTable(head, rows, title), branch, *_execution_lines(report.execution, request.files)]


def _execution_document(execution: "Execution[Any]", files: "RunFiles") -> dict[str, Any]:
    """Collect the end of the document of a run: parameters, events and files."""
    artifacts = execution.artifacts
    return {
        "params_sha256": execution.params_sha256,
        "evrs": [evr_document(*one) for one in (*execution.result.evrs, *artifacts.events)],
        "log": files.log,
        "log_problem": artifacts.log_problem,
        "picture": artifacts.picture,
        "picture_problem": artifacts.picture_problem,
        "page": artifacts.page,
        "page_problem": artifacts.page_problem,
    }


def _execution_lines(execution: "Execution[Any]", files: "RunFiles") -> list[str | Emphasis]:
    """List duration, warnings and files of a run, or the reasons why there are no files."""
    result, artifacts = execution.result, execution.artifacts
    speed = f"{execution.realtime_factor:.0f} times real time"
    return [
        f"duration  {result.duration_s:.1f} s of Mars time, {speed}",
        *(
            Emphasis(f"{time_s:8.2f} s  {evr.severity.name}  {evr.message}")
            for time_s, evr in result.evrs
            if evr.severity >= Severity.WARNING_LO
        ),
        *file_lines(
            {
                "picture": artifacts.picture_problem or _file_text(artifacts.picture, artifacts),
                "page": artifacts.page_problem or _file_text(artifacts.page, artifacts),
                "log": artifacts.log_problem or _file_text(files.log, artifacts),
            }
        ),
    ]


def _file_text(path: Path | None, artifacts: "Artifacts") -> Path | str | None:
    return f"{path}, in place of an older one" if path in artifacts.replaced else path


def evr_document(time_s: float, evr: Evr) -> dict[str, Any]:
    """Collect an event and its time."""
    return {
        "time_s": time_s,
        "name": evr.name,
        "severity": evr.severity.name,
        "message": evr.message,
        "fields": json_fields(evr),
    }


def run_document(report: "RunReport") -> dict[str, Any]:
    """Collect a run."""
    execution, world = report.execution, report.scenario.world
    result = execution.result
    return {
        "scenario": report.scenario.name,
        "outcome": result.outcome,
        "passed": report.passed,
        "arm": report.arm,
        "commands_begun": result.command,
        "checks": [_check_document(check) for check in result.checks],
        "duration_s": result.duration_s,
        "realtime_factor": execution.realtime_factor,
        "tilt_deg": {"roll": degrees(world.tilt_roll_rad), "pitch": degrees(world.tilt_pitch_rad)},
        "seed": report.request.seed,
        "effects": [effect_text(effect) for effect in report.scenario.effects],
        **_execution_document(execution, report.request.files),
    }


def run_parts(report: "RunReport") -> list[str | Emphasis | ReportTable]:
    """Show a run: each check with its bounds, the warnings, and the files."""
    result, scenario = report.execution.result, report.scenario
    passed = "passed" if report.passed else "NOT passed"
    title = f"{scenario.title} on arm {report.arm}: {result.outcome.value}, {passed}"
    rows = [_check_cells(check) for check in result.checks]
    parts: list[str | Emphasis | ReportTable] = [
        ReportTable(("check", "", "measured", "bound", ""), rows, title)
    ]
    number = result.command
    if result.outcome != "done" and number > 0:
        parts.append(f"ended in  command {number}, {upper_snake(type(scenario.commands[number - 1]))}")
    return [*parts, *_execution_lines(report.execution, report.request.files)]


def scenarios_document(scenarios: "Sequence[Scenario]") -> dict[str, Any]:
    """Collect the built-in scenarios."""
    return {
        "scenarios": [
            {
                **{name: getattr(scenario, name) for name in ("name", "title", "summary", "start")},
                "commands": [upper_snake(type(command)) for command in scenario.commands],
                "checks": [upper_snake(type(check)).lower() for check in scenario.checks],
            }
            for scenario in scenarios
        ]
    }


def scenarios_parts(scenarios: "Sequence[Scenario]") -> list[str]:
    """List the built-in scenarios, one in each line."""
    width = max(len(scenario.name) for scenario in scenarios)
    return [f"{scenario.name:<{width}}  {scenario.summary}" for scenario in scenarios]


def _check_document(check: "CheckResult") -> dict[str, Any]:
    value, low, high, unit = _in_display_unit(check)
    shown = {"value": value, "unit": unit or None, "low": low, "high": high}
    return {"check": check.check, "name": check.name, **shown, "passed": check.passed}


def _check_cells(check: "CheckResult") -> tuple[str, ...]:
    value, low, high, unit = _in_display_unit(check)
    verdict = "ok" if check.passed else "NOT"
    if low == high == 1.0:
        return check.check, check.name, "yes" if value == 1.0 else "no", "yes", verdict
    measured = f"{value:.3g} {unit}".rstrip() if isfinite(value) else "not reached"
    bound = f"at most {high:.3g}" if not isfinite(low) else f"{low:.3g} .. {high:.3g}"
    return check.check, check.name, measured, f"{bound} {unit}".rstrip(), verdict


def _in_display_unit(check: "CheckResult") -> tuple[float, float, float, str]:
    """Convert value, lower and upper bound of a check to the unit of reports."""
    unit, factor = DISPLAY_UNITS.get(check.unit, (check.unit, 1.0))
    return factor * check.value, factor * check.low, factor * check.high, unit


def hardstop_document(report: "HardstopReport") -> dict[str, Any]:
    """Collect the run."""
    request, result = report.request, report.result
    same = ("arm", "scene", "turret", "seed")
    return {
        "outcome": result.outcome,
        **{name: getattr(request, name) for name in same},
        "tilt_deg": {"roll": request.tilt_roll_deg, "pitch": request.tilt_pitch_deg},
        "temperature_C": request.temperature_C,
        "joints": {joint.name.lower(): _joint_document(report, joint) for joint in _joints(report)},
        "max_current_ratio": float(result.max_current_ratio.max()),
        "duration_s": result.duration_s,
        "evrs": [evr_document(*one) for one in result.evrs],
        "picture": request.picture,
    }


def hardstop_parts(report: "HardstopReport") -> list[str | ReportTable]:
    """Show the hardstop errors, and the events of calibration and warnings."""
    request, result = report.request, report.result
    head = ("joint", "zero error mrad", "without wind-up mrad", "half backlash error mrad", "load N m")
    rows = [_joint_cells(joint, _joint_document(report, joint)) for joint in _joints(report)]
    title = f"Hardstops of {request.arm} on {request.scene}: {result.outcome.value}"
    events = [
        f"{time_s:8.2f} s  {evr.message}"
        for time_s, evr in result.evrs
        if isinstance(evr, JointCalibrated) or evr.severity >= Severity.WARNING_LO
    ]
    return [
        ReportTable((*head, "most on stop N m"), rows, title),
        "errors are against the true hardstop of this arm, which flight software cannot see",
        *events,
        *file_lines({"picture": request.picture}),
    ]


def _joint_cells(joint: Joint, row: dict[str, Any]) -> tuple[str, ...]:
    name = joint.name.lower()
    if not row["found"]:
        return name, "not found"
    return (
        name,
        f"{row['zero_error_mrad']:+.3f}",
        f"{row['uncorrected_error_mrad']:+.3f}",
        f"{row['half_backlash_error_mrad']:+.3f}",
        f"{row['load_Nm']:.1f}",
        f"{row['max_torque_Nm']:.0f}",
    )


def _joints(report: "HardstopReport") -> list[Joint]:
    name = report.request.joint
    return list(Joint) if name is None else [Joint[name.upper()]]


def _joint_document(report: "HardstopReport", joint: Joint) -> dict[str, Any]:
    """Collect the last hardstop that a joint found."""
    stops = [stop for stop in report.result.stops if stop.joint is joint]
    if not stops:
        return {"found": False}
    last = stops[-1]
    return {
        "found": True,
        "zero_error_mrad": 1e3 * last.zero_error_rad,
        "uncorrected_error_mrad": 1e3 * last.uncorrected_error_rad,
        "half_backlash_error_mrad": 1e3 * last.half_backlash_error_rad,
        "load_Nm": last.load_Nm,
        "max_torque_Nm": float(report.result.max_torque_Nm[joint]),
        "planned_pose_deg": [degrees(angle) for angle in report.poses_rad[joint]],
    }
