"""Measured UR10: one half of a series validates the other, and one series another."""

import json

import pytest

from marsarm.calibration.request import SerialRequest
from marsarm.calibration.serial.execution import calibrate_serial
from validation.campaigns import Context
from validation.ur10 import BOUNDS_MM, FILES, TABLES, campaign


def quiet(*_) -> None:
    """Ignore progress."""


@pytest.mark.real_data
def test_half_of_series_c_predicts_the_other_half(real_data):
    table = real_data / "ur10-tracker" / TABLES["c"]
    report = calibrate_serial(SerialRequest(FILES / "arm.toml", table, FILES / "series_c.toml"), quiet)
    last = report.models[-1]
    assert last.fresh.rms_m * 1e3 < BOUNDS_MM["c"]
    assert last.found.outliers == ()
    assert last.found.fit.converged
    assert not report.temperature.explains


@pytest.mark.real_data
@pytest.mark.slow
def test_all_that_the_measured_arm_has_to_show(real_data):
    found = campaign(Context(), real_data)
    assert found["in_bounds"], json.dumps(found["held_out_position_rms"])
    assert set(found["temperature_explains"].values()) == {"nothing"}
    for name in ("a", "c"):
        assert all(step["significant"] for step in found[name]["models"])
