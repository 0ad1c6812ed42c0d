"""A real arm: a UR10's measured poses, fitted on one part and judged on the other, and across two series."""

import json
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.options import parser
from ground.calibration.serial.request import SerialReport, SerialRequest, calibrate_serial
from ground.report.serial_tables import serial_json

EXAMPLE = "example: MARSARM_DATA=~/data python -m benchmarks.ur10 > ur10.json"
FILES = Path(__file__).parents[1] / "models" / "ur10"
TABLES = {"a": "series_a_grid.csv", "c": "series_c_random_poses.csv"}
BOUNDS_MM = {"a": 0.50, "c": 0.52, "a_to_c": 0.60}
"""Root mean square of the position error of poses that were held out."""
KEPT = ("steps", "moves_target_m", "joints", "temperature")


def main() -> int:
    """Print the result as JSON; exit status 1 if a bound is broken, 2 without the data."""
    options = parser("ur10", __doc__, EXAMPLE)
    options.add_argument(
        "--data", type=Path, default=os.environ.get("MARSARM_DATA"), help="folder with the data"
    )
    asked = options.parse_args()
    if asked.data is None or not (asked.data / "ur10-tracker").is_dir():
        options.error("data: there is no folder ur10-tracker; name its folder by --data or MARSARM_DATA")
    found = document(asked.data / "ur10-tracker")
    print(json.dumps(found, indent=2))
    return 0 if found["passed"] else 1


def document(folder: Path) -> dict[str, Any]:
    """Every number that is held to a bound, and what each effect explains."""
    with tempfile.TemporaryDirectory() as made:
        reports = {name: _series(folder, name, Path(made)) for name in TABLES}
        from_a = SerialRequest(
            Path(made) / "a.toml", folder / TABLES["c"], FILES / "series_c.toml", terms="none"
        )
        reports["a_to_c"] = calibrate_serial(from_a, _tell)
    checks = {name: _check(reports[name], bound) for name, bound in BOUNDS_MM.items()}
    temperature = {name: serial_json(reports[name], None)["temperature"]["explains"] for name in TABLES}
    return {
        "passed": all(one["passed"] for one in checks.values()) and set(temperature.values()) == {"nothing"},
        "held_out_position_rms": checks,
        "temperature_explains": temperature,
        **{name: _short(report) for name, report in reports.items()},
    }


def _series(folder: Path, name: str, made: Path) -> SerialReport:
    request = SerialRequest(FILES / "arm.toml", folder / TABLES[name], FILES / f"series_{name}.toml")
    return calibrate_serial(replace(request, ladder=True, out=made / f"{name}.toml"), _tell)


def _check(report: SerialReport, bound_mm: float) -> dict[str, Any]:
    fresh = report.steps[-1].fresh
    assert fresh is not None
    rms_mm = fresh.rms_m * 1e3
    return {
        "rms_mm": rms_mm,
        "bound_mm": bound_mm,
        "poses": fresh.position_m.size,
        "passed": rms_mm <= bound_mm,
    }


def _short(report: SerialReport) -> dict[str, Any]:
    whole = serial_json(report, None)
    return {name: whole[name] for name in KEPT}


def _tell(done: float, total: float, what: str) -> None:
    print(f"{what}: {done:.0f} of {total:.0f}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
