"""Reports of `marsarm hardstop`: results and plans as JSON documents and tables, and the figure of a run."""

from collections.abc import Sequence
from itertools import pairwise
from math import degrees
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.table import Table

from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.evrs import JointCalibrated, Severity
from fsw.motion.homing import HomingStage
from marsarm.render.svg import save_figure
from marsarm.runs.hardstop import HardstopReport, StopPlan
from marsarm.runs.tables import evr_json
from sim.initialisation import HardstopResult, HomingSample, InitialisationResult
from simgap.common.console import plain_console

BEFORE_S: Final = 3.0
"""Time before the contact with the hardstop from which the figure begins."""
PAUSE_S: Final = 1.0
"""Shortest time between two homing attempts of a joint."""
BLUE, ORANGE, GREEN, RED, GREY = "#31688e", "#d95f02", "#2a9d8f", "#c1121f", "0.6"
COLOURS: Final = {
    HomingStage.FREE: "0.8",
    HomingStage.COARSE: GREY,
    HomingStage.RETREAT: GREEN,
    HomingStage.FINE: BLUE,
    HomingStage.RELEASE: ORANGE,
}
NAMES: Final = {
    HomingStage.FREE: "free: away from the hardstop",
    HomingStage.COARSE: "coarse: towards it until stall",
    HomingStage.RETREAT: "retreat",
    HomingStage.FINE: "fine: slowly towards it",
    HomingStage.RELEASE: "release: slowly away",
}


def hardstop_json(report: HardstopReport, picture_problem: str | None = None) -> dict[str, Any]:
    """Return the report as a JSON document.

    Args:
        report: Report of the runs.
        picture_problem: Reason why there is no picture.
    """
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
        "picture": None if request.picture is None or picture_problem is not None else str(request.picture),
        "picture_problem": picture_problem,
    }


def hardstop_table(report: HardstopReport, picture_problem: str | None = None) -> None:
    """Print the hardstop errors, and the events of failed runs.

    Args:
        report: Report of the runs.
        picture_problem: Reason why there is no picture.
    """
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
        console.print(f"picture  {picture_problem or request.picture}", soft_wrap=True)


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


def save_hardstop_figure(runs: Sequence[InitialisationResult], path: Path) -> str | None:
    """Save the figure of the first run of each joint as PNG.

    Returns:
        None, or the reason why there is no figure: matplotlib is missing.

    Raises:
        BadOutput: the file cannot be written.
    """
    samples_by_joint = _samples_by_joint(runs)
    rows = max(len(samples_by_joint), 1)

    def draw(figure: Any) -> None:
        figure.suptitle("Homing at the negative hardstop: motor current, speed and angle", fontsize=12)
        panels = figure.subplots(rows, 4, squeeze=False)
        for axes, (joint, samples) in zip(panels, samples_by_joint.items(), strict=False):
            _draw_joint(axes, joint, samples)
        legend = dict(zip(*reversed(panels[0][0].get_legend_handles_labels()), strict=True))
        if legend:
            figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=len(legend))

    return save_figure(path, (15, 1.2 + 3.4 * rows), 90, draw)


def _samples_by_joint(runs: Sequence[InitialisationResult]) -> dict[Joint, list[HomingSample]]:
    """Select the last homing attempt of each joint in its first run, without most of the approach."""
    selected: dict[Joint, list[HomingSample]] = {}
    for joint in HARDSTOP_ORDER:
        samples = next((found for found in (_last_attempt(run, joint) for run in runs) if found), None)
        if samples is not None:
            at_stop = [s.time_s for s in samples if s.stage > HomingStage.COARSE]
            first_s = (at_stop[0] if at_stop else samples[-1].time_s) - BEFORE_S
            selected[joint] = [s for s in samples if s.time_s >= first_s]
    return selected


def _last_attempt(run: InitialisationResult, joint: Joint) -> list[HomingSample]:
    samples = [s for s in run.samples if s.joint is joint]
    pauses = [k for k, (a, b) in enumerate(pairwise(samples), 1) if b.time_s - a.time_s > PAUSE_S]
    return samples[pauses[-1] :] if pauses else samples


def _draw_joint(axes: Any, joint: Joint, samples: list[HomingSample]) -> None:
    current, speed, angle, press = axes
    zero_s, last = samples[0].time_s, samples[-1]
    name = joint.name.lower()
    for stage in HomingStage:
        part = [s for s in samples if s.stage is stage]
        if not part:
            continue
        time_s = np.array([s.time_s for s in part]) - zero_s
        angle_mrad = 1e3 * (np.array([s.angle_rad for s in part]) - last.angle_rad)
        current_A = np.array([s.current_A for s in part])
        style = {"color": COLOURS[stage], "linewidth": 0.9}
        current.plot(time_s, current_A, label=NAMES[stage], **style)
        speed.plot(time_s, 1e3 * np.array([s.speed_rad_s for s in part]), **style)
        angle.plot(time_s, angle_mrad, **style)
        if stage in (HomingStage.FINE, HomingStage.RELEASE):
            press.plot(angle_mrad, current_A, ".", markersize=2, color=COLOURS[stage])
    time_s = np.array([s.time_s for s in samples]) - zero_s
    limit_A = np.array([s.limit_A for s in samples])
    current.plot(time_s, limit_A, color=RED, linewidth=0.8, linestyle="--", label="current limit")
    current.plot(time_s, -limit_A, color=RED, linewidth=0.8, linestyle="--")
    for stall_s in _stall_times_s(samples):
        for panel in (current, speed, angle):
            panel.axvline(stall_s - zero_s, color="black", linewidth=0.8, linestyle=":", label="stall")
    current.set(title=f"{name}: current", xlabel="time [s]", ylabel="A")
    speed.set(title=f"{name}: motor speed", xlabel="time [s]", ylabel="mrad/s")
    angle.set(title=f"{name}: motor angle", xlabel="time [s]", ylabel="mrad, 0 at the end")
    press.set(title=f"{name}: current over angle", xlabel="mrad, 0 at the end", ylabel="A")


def _stall_times_s(samples: list[HomingSample]) -> list[float]:
    """Find the times of stalls, which end the stages that move towards the hardstop."""
    return [
        a.time_s
        for a, b in pairwise(samples)
        if a.stage is not b.stage and a.stage in (HomingStage.COARSE, HomingStage.FINE)
    ]
