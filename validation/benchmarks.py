"""All benchmarks that fit in two minutes, as one JSON document on standard output."""

import json
import platform
import sys
import time
from typing import Any

from ground.accuracy.budget_request import BudgetRequest, run_budget
from validation.closed_loop import closed_loop
from validation.kinematics import run_kinematics_campaign
from validation.kinematics_speed import kinematics_speed
from validation.log_reading import log_reading
from validation.recording import recording

LIMIT_S = 3.0
RUNS = 3


def budget_speed() -> dict[str, Any]:
    """The best of some runs."""
    request, took_s = BudgetRequest(), []
    for _ in range(RUNS):
        begun = time.perf_counter()
        report = run_budget(request, lambda *_: None)
        took_s.append(time.perf_counter() - begun)
    return {
        "poses": request.poses,
        "sources": len(report.model.source),
        "cases": len(report.budgets),
        "seconds": min(took_s),
        "limit_s": LIMIT_S,
        "in_bounds": min(took_s) < LIMIT_S,
    }


CAMPAIGN_TARGETS = 20_000
"""Targets, and as many vectors; `make campaign` runs ten million of each."""


def main() -> None:
    """Measure and print; exit status 1 if something is out of the bounds that it has."""
    machine = {"python": platform.python_version(), "machine": platform.machine()}
    results: dict[str, dict[str, Any]] = {
        "machine": machine,
        "closed_loop": closed_loop(),
        "recording": recording(),
        "kinematics_speed": kinematics_speed(),
        "log_reading": log_reading(),
        "budget": budget_speed(),
        "kinematics_campaign": run_kinematics_campaign(CAMPAIGN_TARGETS, CAMPAIGN_TARGETS),
    }
    print(json.dumps(results, indent=2))
    out = [name for name, found in results.items() if not found.get("in_bounds", True)]
    if out:
        sys.exit(f"out of bounds: {', '.join(out)}")


if __name__ == "__main__":
    main()
