"""How long the error budget takes: 15,000 poses, every source, frame, tool and case."""

import time
from typing import Any

from ground.accuracy.budget_request import BudgetRequest, run_budget

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
