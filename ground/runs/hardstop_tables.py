"""Reports of `marsarm hardstop`: results and plans as JSON documents and as tables."""

from math import degrees
from typing import Any

import numpy as np
from rich.table import Table

from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.evrs import JointCalibrated, Severity
from ground.render.console import plain_console
from ground.runs.hardstop import HardstopReport, StopPlan
from ground.runs.tables import evr_json
from sim.initialisation import HardstopResult


def hardstop_json(report: HardstopReport) -> dict[str, Any]:
    """Return the report as a JSON document."""
    request = report.request
    return {
        "outcome": report.outcome.value,
        "arm": request.arm,
        "scene": request.scene,
        "turret": request.turret,
        "repeat": request.repeat,
        "seed": request.seed,
        "tilt_deg": {"roll": request.tilt_roll_deg, "pitch": request.tilt_pitch_deg},
        "temperature_C": request.temperature_C,
        "joints": {joint.name.lower(): _joint_json(report, joint) for joint in _joints(report)},
        "max_current_ratio": max(float(run.max_current_ratio.max()) for run in report.runs),
        "duration_s": sum(run.duration_s for run in report.runs),
        "evrs": [evr_json(time_s, evr) for time_s, evr in report.runs[-1].evrs],
        "picture": None
        if request.picture is None or report.picture_problem is not None
        else str(request.picture),
        "picture_problem": report.picture_problem,
    }


def hardstop_table(report: HardstopReport) -> None:
    """Print the hardstop errors, and the events of failed runs."""
    console = plain_console()
    request = report.request
    table = Table(title=f"Hardstops of {request.arm} on {request.scene}: {report.outcome.value}")
    is_repeated = request.repeat > 1
    for name in (
        "joint",
        "zero error mrad",
        *(("3 sigma mrad",) if is_repeated else ()),
        "without wind-up mrad",
        "half backlash error mrad",
        "load N m",
        "most on stop N m",
    ):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for joint in _joints(report):
        row = _joint_json(report, joint)
        if row["found"] == 0:
            table.add_row(joint.name.lower(), "not found")
            continue
        spread = (f"{row['zero_error_3_sigma_mrad']:.3f}",) if is_repeated else ()
        table.add_row(
            joint.name.lower(),
            f"{row['zero_error_mrad']:+.3f}",
            *spread,
            f"{row['uncorrected_error_mrad']:+.3f}",
            f"{row['half_backlash_error_mrad']:+.3f}",
            f"{row['load_Nm']:.1f}",
            f"{row['max_torque_Nm']:.0f}",
        )
    console.print(table)
    console.print("errors are against the true hardstop of this arm, which flight software cannot see")
    if not is_repeated:
        for run in report.runs:
            for time_s, evr in run.evrs:
                if isinstance(evr, JointCalibrated) or evr.severity >= Severity.WARNING_LO:
                    console.print(f"{time_s:8.2f} s  {evr.message}", soft_wrap=True)
    elif report.outcome != "done":
        for time_s, evr in report.runs[-1].evrs:
            console.print(f"{time_s:8.2f} s  {evr.message}", soft_wrap=True)
    if request.picture is not None:
        console.print(f"picture  {report.picture_problem or request.picture}", soft_wrap=True)


def plan_json(plans: tuple[StopPlan, ...]) -> dict[str, Any]:
    """Return the plans as a JSON document."""
    return {
        plan.place: {
            "joints": {
                joint.name.lower(): {
                    "pose_deg": [degrees(angle) for angle in plan.loads.pose_rad[:, joint]],
                    "torque_Nm": float(plan.loads.torque_Nm[joint]),
                }
                for joint in Joint
            },
            "order": [joint.name.lower() for joint in HARDSTOP_ORDER],
            "start_deg": [degrees(angle) for angle in plan.params.hardstop.start_rad],
            "park_deg": [degrees(angle) for angle in plan.params.hardstop.park_rad],
            "second_start_deg": [degrees(angle) for angle in plan.params.hardstop.second_start_rad],
            "clearance_mm": {
                "rover_and_ground": 1e3 * plan.clearance.outside_m,
                "itself": 1e3 * plan.clearance.self_m,
            },
        }
        for plan in plans
    }


def plan_table(plans: tuple[StopPlan, ...]) -> None:
    """Print the pose and the load of each joint at its hardstop."""
    console = plain_console()
    for plan in plans:
        table = Table(title=f"At the hardstops, {plan.place}", title_justify="left")
        for name in ("joint", "load N m", "azimuth", "elevation", "elbow", "wrist", "turret deg"):
            table.add_column(name, justify="left" if name == "joint" else "right")
        for joint in HARDSTOP_ORDER:
            pose = [f"{degrees(angle):.1f}" for angle in plan.loads.pose_rad[:, joint]]
            table.add_row(joint.name.lower(), f"{plan.loads.torque_Nm[joint]:.1f}", *pose)
        console.print(table)
        clearance = plan.clearance
        console.print(
            f"on the way at least {1e3 * clearance.outside_m:.0f} mm from rover and ground, "
            f"{1e3 * clearance.self_m:.0f} mm from itself"
        )


def _joints(report: HardstopReport) -> list[Joint]:
    name = report.request.joint
    return list(Joint) if name is None else [Joint[name.upper()]]


def _joint_json(report: HardstopReport, joint: Joint) -> dict[str, Any]:
    """Compute means and spreads over the repetitions, from the last hardstop that each run found."""
    stops_by_run = [[stop for stop in run.stops if stop.joint is joint] for run in report.runs]
    stops = [of_run[-1] for of_run in stops_by_run if of_run]
    if not stops:
        return {"found": 0}
    error = 1e3 * np.array([stop.zero_error_rad for stop in stops])
    uncorrected = 1e3 * np.array([stop.uncorrected_error_rad for stop in stops])
    return {
        "found": len(stops),
        "zero_error_mrad": float(error.mean()),
        "zero_error_3_sigma_mrad": _three_sigma(error),
        "uncorrected_error_mrad": float(uncorrected.mean()),
        "uncorrected_error_3_sigma_mrad": _three_sigma(uncorrected),
        "half_backlash_error_mrad": 1e3 * _mean(stops, "half_backlash_error_rad"),
        "load_Nm": _mean(stops, "load_Nm"),
        "max_torque_Nm": max(float(run.max_torque_Nm[joint]) for run in report.runs),
        "planned_pose_deg": [degrees(angle) for angle in report.poses_rad[joint]],
    }


def _mean(stops: list[HardstopResult], name: str) -> float:
    return float(np.mean([getattr(stop, name) for stop in stops]))


def _three_sigma(values: np.ndarray) -> float | None:
    return 3 * float(values.std(ddof=1)) if values.size > 1 else None
