"""Bounds on the cost of recording."""

from typing import Any

import pytest

from validation import benchmarks, speed
from validation.campaigns import Context


@pytest.mark.parametrize(
    ("both_us", "write_ms", "in_bounds"),
    [(60.0, 0.9, True), (66.0, 0.9, False), (60.0, 1.1, False)],
    ids=["cheap", "a slow recorder", "late cycles"],
)
def test_recording_that_costs_too_much_is_out_of_bounds(
    both_us: float, write_ms: float, in_bounds: bool
) -> None:
    assert speed.judge_cost(both_us, write_ms)["in_bounds"] is in_bounds


def test_a_benchmark_out_of_its_bounds_fails_them_all(monkeypatch: pytest.MonkeyPatch) -> None:
    measured: dict[str, Any] = {"in_bounds": False}
    for name in ("closed_loop", "recording", "kinematics_speed", "log_reading", "budget_speed", "memory"):
        monkeypatch.setattr(benchmarks, name, lambda name=name: measured if name == "recording" else {})
    found = benchmarks.campaign(Context())
    assert (found["recording"], found["in_bounds"]) == (measured, False)
