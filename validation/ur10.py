"""Calibration of a real arm, a UR10: measured poses of two series, with held-out parts and across series."""

import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fsw.kinematics.transforms import Array, Integers
from marsarm.calibration.request import SerialRequest
from marsarm.calibration.serial.execution import SerialReport, calibrate_serial
from marsarm.calibration.serial.report import serial_json
from simgap.common.errors import BadRequest
from simgap.serial_arm.calibrate import periodic_error_rad
from validation.campaigns import Context, Document

FILES = Path(__file__).parents[1] / "models" / "robots" / "ur10"
TABLES = {"a": "series_a_grid.csv", "c": "series_c_random_poses.csv"}
BOUNDS_MM = {"a": 0.50, "c": 0.52, "a_to_c": 0.60}
"""Bounds of the root mean square position error of held-out poses."""
JOINTS = 6
LEAST_VISITS = 3
"""Least number of poses of each series in a degree that is compared."""
LEAST_DEGREES = 8
"""Least number of degrees for a comparison."""
KEYS = ("models", "contributions_m", "joints", "temperature")


def campaign(context: Context, data: Path | None = None) -> Document:
    """Calibrate both series, validate one on the other, and compare the errors with their bounds.

    Args:
        context: Its seed is not used.
        data: Folder with the data; that which MARSARM_DATA names if there is none.
    """
    data = data or Path(os.environ.get("MARSARM_DATA", ""))
    folder = data / "ur10-tracker"
    if not folder.is_dir():
        raise BadRequest("set data: there is no folder ur10-tracker; name its folder here or by MARSARM_DATA")
    with tempfile.TemporaryDirectory() as output:
        reports = {name: _calibrate_series(context, folder, name, Path(output)) for name in TABLES}
        from_a = SerialRequest(
            Path(output) / "a.toml", folder / TABLES["c"], FILES / "series_c.toml", terms="none"
        )
        reports["a_to_c"] = calibrate_serial(from_a, context.progress)
    checks = {name: _check_error(reports[name], bound) for name, bound in BOUNDS_MM.items()}
    temperature = {name: serial_json(reports[name], None)["temperature"]["explains"] for name in TABLES}
    return {
        "in_bounds": all(one["passed"] for one in checks.values())
        and set(temperature.values()) == {"nothing"},
        "held_out_position_rms": checks,
        "temperature_explains": temperature,
        "periodic_comparison": [_compare_periodic(reports["a"], reports["c"], k) for k in range(JOINTS)],
        **{name: _select_keys(report) for name, report in reports.items()},
    }


def _calibrate_series(context: Context, folder: Path, name: str, output: Path) -> SerialReport:
    request = SerialRequest(FILES / "arm.toml", folder / TABLES[name], FILES / f"series_{name}.toml")
    return calibrate_serial(replace(request, nested=True, out=output / f"{name}.toml"), context.progress)


def _check_error(report: SerialReport, bound_mm: float) -> dict[str, Any]:
    fresh = report.models[-1].fresh
    assert fresh is not None
    rms_mm = fresh.rms_m * 1e3
    return {
        "rms_mm": rms_mm,
        "bound_mm": bound_mm,
        "poses": fresh.position_m.size,
        "passed": rms_mm <= bound_mm,
    }


def _compare_periodic(one: SerialReport, other: SerialReport, joint: int) -> dict[str, Any]:
    """Compare the periodic errors of a joint from two series, at degrees that both visit, without slopes."""
    at_rad = np.radians(np.arange(-179.5, 180.0))
    visits = [_visits(report, joint) for report in (one, other)]
    at_rad = at_rad[np.all(np.array(visits) >= LEAST_VISITS, axis=0)]
    name = one.arm.links[joint].name
    if at_rad.size < LEAST_DEGREES:
        return {"name": name, "degrees": at_rad.size}
    line = np.stack([np.ones(at_rad.size), at_rad], axis=1)
    curves = np.array([_periodic_rad(report, joint, at_rad) for report in (one, other)]).T
    curves -= line @ np.linalg.lstsq(line, curves, rcond=None)[0]
    return {
        "name": name,
        "degrees": at_rad.size,
        "rms_rad": np.std(curves, axis=0).tolist(),
        "rms_of_difference_rad": float(np.std(curves[:, 0] - curves[:, 1])),
        "correlation": float(np.corrcoef(curves.T)[0, 1]),
    }


def _visits(report: SerialReport, joint: int) -> Integers:
    """Count the fitted poses in each degree of a joint, shape (360,)."""
    degrees = np.degrees(report.part.joint_rad[joint])
    return np.bincount(np.floor(np.mod(degrees + 180, 360)).astype(int), minlength=360)


def _periodic_rad(report: SerialReport, joint: int, at_rad: Array) -> Array:
    """Compute the periodic error of a joint at angles of shape (n,)."""
    arm = report.models[-1].found.arm
    phase = at_rad[:, None] * np.arange(1, arm.orders + 1)
    amplitudes = arm.links[joint].periodic_rad(arm.orders)
    return periodic_error_rad(np.concatenate([np.cos(phase), np.sin(phase)], axis=1), amplitudes)


def _select_keys(report: SerialReport) -> dict[str, Any]:
    whole = serial_json(report, None)
    return {name: whole[name] for name in KEYS}
