"""Calibration of a real arm, a UR10: measured poses of two series, with held-out parts and across series."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from fsw.kinematics.transforms import Array, Integers
from simgap.command.diagnosis import calibration_json
from simgap.serial_arm.calibrate import periodic_error_rad
from simgap.serial_arm.files import read_arm, read_series
from simgap.serial_arm.tracker import TrackerFit, fit_tracker
from validation.options import campaign_parser

EXAMPLE = "example: MARSARM_DATA=~/data python -m validation.ur10 > ur10.json"
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


def main() -> int:
    """Print the result as JSON; return 1 if a bound is exceeded, 2 without the data."""
    parser = campaign_parser("ur10", __doc__, EXAMPLE)
    parser.add_argument(
        "--data", type=Path, default=os.environ.get("MARSARM_DATA"), help="folder with the data"
    )
    options = parser.parse_args()
    if options.data is None or not (options.data / "ur10-tracker").is_dir():
        parser.error("data: there is no folder ur10-tracker; name its folder by --data or MARSARM_DATA")
    found = document(options.data / "ur10-tracker")
    print(json.dumps(found, indent=2))
    return 0 if found["passed"] else 1


def document(folder: Path) -> dict[str, Any]:
    """Calibrate both series, validate one on the other, and compare the errors with their bounds."""
    arm = read_arm(FILES / "arm.toml")
    series = {
        name: read_series(arm, folder / table, FILES / f"series_{name}.toml")
        for name, table in TABLES.items()
    }
    fits = {name: fit_tracker(arm, one, progress=_print_progress) for name, one in series.items()}
    fits["a_to_c"] = fit_tracker(fits["a"].found.arm, series["c"], terms=(), progress=_print_progress)
    documents = {name: calibration_json(one) for name, one in fits.items()}
    checks = {name: _check_error(fits[name], bound) for name, bound in BOUNDS_MM.items()}
    temperature = {name: documents[name]["temperature"]["explains"] for name in TABLES}
    return {
        "passed": all(one["passed"] for one in checks.values()) and set(temperature.values()) == {"nothing"},
        "held_out_position_rms": checks,
        "temperature_explains": temperature,
        "periodic_comparison": [_compare_periodic(fits["a"], fits["c"], k) for k in range(JOINTS)],
        **{name: {key: one[key] for key in KEYS} for name, one in documents.items()},
    }


def _check_error(fitted: TrackerFit, bound_mm: float) -> dict[str, Any]:
    fresh = fitted.models[-1].fresh
    rms_mm = fresh.rms_m * 1e3
    return {
        "rms_mm": rms_mm,
        "bound_mm": bound_mm,
        "poses": fresh.position_m.size,
        "passed": rms_mm <= bound_mm,
    }


def _compare_periodic(one: TrackerFit, other: TrackerFit, joint: int) -> dict[str, Any]:
    """Compare the periodic errors of a joint from two series, at degrees that both visit, without slopes."""
    at_rad = np.radians(np.arange(-179.5, 180.0))
    visits = [_visits(fitted, joint) for fitted in (one, other)]
    at_rad = at_rad[np.all(np.array(visits) >= LEAST_VISITS, axis=0)]
    name = one.found.model.arm.links[joint].name
    if at_rad.size < LEAST_DEGREES:
        return {"name": name, "degrees": at_rad.size}
    line = np.stack([np.ones(at_rad.size), at_rad], axis=1)
    curves = np.array([_periodic_rad(fitted, joint, at_rad) for fitted in (one, other)]).T
    curves -= line @ np.linalg.lstsq(line, curves, rcond=None)[0]
    return {
        "name": name,
        "degrees": at_rad.size,
        "rms_rad": np.std(curves, axis=0).tolist(),
        "rms_of_difference_rad": float(np.std(curves[:, 0] - curves[:, 1])),
        "correlation": float(np.corrcoef(curves.T)[0, 1]),
    }


def _visits(fitted: TrackerFit, joint: int) -> Integers:
    """Count the fitted poses in each degree of a joint, shape (360,)."""
    degrees = np.degrees(fitted.found.model.series.joint_rad[joint])
    return np.bincount(np.floor(np.mod(degrees + 180, 360)).astype(int), minlength=360)


def _periodic_rad(fitted: TrackerFit, joint: int, at_rad: Array) -> Array:
    """Compute the periodic error of a joint at angles of shape (n,)."""
    arm = fitted.found.arm
    phase = at_rad[:, None] * np.arange(1, arm.orders + 1)
    amplitudes = arm.links[joint].periodic_rad(arm.orders)
    return periodic_error_rad(np.concatenate([np.cos(phase), np.sin(phase)], axis=1), amplitudes)


def _print_progress(done: float, total: float, what: str) -> None:
    print(f"{what}: {done:.0f} of {total:.0f}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
