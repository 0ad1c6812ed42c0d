"""Bounds on the cost of recording."""

import json
from typing import Any

import pytest

from validation import benchmarks, recording


@pytest.mark.parametrize(
    ("both_us", "write_ms", "in_bounds"),
    [(60.0, 0.9, True), (66.0, 0.9, False), (60.0, 1.1, False)],
    ids=["cheap", "a slow recorder", "late cycles"],
)
def test_recording_that_costs_too_much_is_out_of_bounds(
    both_us: float, write_ms: float, in_bounds: bool
) -> None:
    assert recording.judge_cost(both_us, write_ms)["in_bounds"] is in_bounds


def test_a_benchmark_out_of_its_bounds_fails_them_all_and_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured: dict[str, Any] = {"in_bounds": False}
    for name in ("closed_loop", "recording", "kinematics_speed", "log_reading", "budget_speed"):
        monkeypatch.setattr(benchmarks, name, lambda name=name: measured if name == "recording" else {})
    monkeypatch.setattr(benchmarks, "run_kinematics_campaign", lambda targets, vectors: {})
    with pytest.raises(SystemExit, match=r"out of bounds: recording$"):
        benchmarks.main()
    assert json.loads(capsys.readouterr().out)["recording"] == measured
