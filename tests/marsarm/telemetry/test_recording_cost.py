"""Bounds on the cost of recording."""

from typing import Any

import pytest

from validation import benchmarks, recording
from validation.campaigns import Context


@pytest.mark.parametrize(
    ("rate_ratio", "beside_us", "bare_steps", "in_bounds"),
    [
        (0.95, 900.0, 0.6, True),
        (0.89, 900.0, 0.6, False),
        (0.95, 1600.0, 0.6, False),
        (0.95, 900.0, 0.7, False),
    ],
    ids=["cheap", "a slower loop", "late cycles", "a slow recorder"],
)
def test_recording_that_costs_too_much_is_out_of_bounds(
    rate_ratio: float, beside_us: float, bare_steps: float, in_bounds: bool
) -> None:
    assert recording.judge_cost(rate_ratio, 500.0, beside_us, bare_steps)["in_bounds"] is in_bounds


def test_a_benchmark_out_of_its_bounds_fails_them_all(monkeypatch: pytest.MonkeyPatch) -> None:
    measured: dict[str, Any] = {"in_bounds": False}
    for name in ("closed_loop", "recording", "kinematics_speed", "log_reading", "budget_speed", "memory"):
        monkeypatch.setattr(benchmarks, name, lambda name=name: measured if name == "recording" else {})
    monkeypatch.setattr(benchmarks.kinematics, "campaign", lambda *_: {})
    found = benchmarks.campaign(Context())
    assert (found["recording"], found["in_bounds"]) == (measured, False)
