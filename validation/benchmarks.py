"""Measure speeds in two minutes, and the memory of a run without a log."""

import os
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from fsw.kinematics.ik import inverse_kinematics
from fsw.kinematics.transforms import Array
from marsarm.accuracy.budget import run_budget
from marsarm.accuracy.request import BudgetRequest
from marsarm.runs.execution import FRAME_CYCLES
from marsarm.runs.request import RunRequest
from marsarm.runs.scenario import run_scenario
from sim.frames import approach_from, p_R_from_N, random_targets
from validation.campaigns import Context, Document
from validation.kinematics import Trial, arm_of
from validation.speed import closed_loop, log_reading, recording

FROM_CYCLE: Final = 2_000
BY_CYCLE: Final = 10_000
MOST_GROWTH_MB: Final = 20.0
"""Largest growth of the resident memory from `FROM_CYCLE` to the end of a run."""
BUDGET_LIMIT_S: Final = 3.0
BUDGET_RUNS: Final = 3
IK_TARGETS: Final = 10_000
IK_SINGLE_TARGETS: Final = 100
IK_REPEATS: Final = 5
IK_TOOL: Final = "apxs"
KINDS: Final = ("workspace", "vectors")
"""Targets of the workspace, and those of random joint vectors."""
MARS_R_m_s2: Final = np.array([0.0, 0.0, 3.711])
ARMS: Final = ("nominal", "calibrated:3")


def campaign(context: Context) -> Document:
    """Measure everything."""
    results: Document = {
        "machine": {"python": platform.python_version(), "machine": platform.machine()},
        "closed_loop": closed_loop(),
        "recording": recording(),
        "kinematics_speed": kinematics_speed(),
        "log_reading": log_reading(),
        "budget": budget_speed(),
        "memory": memory(),
    }
    return {**results, "in_bounds": all(one.get("in_bounds", True) for one in results.values())}


def memory() -> Document:
    """Measure the resident memory by cycle, and compare its growth with the bound."""
    resident: list[tuple[str, float]] = []
    run_scenario(
        RunRequest("contact-science"), lambda _, __, activity: resident.append((activity, _resident_MB()))
    )
    begun = [activity for activity, _ in resident].index("teaching") + 1
    by_cycle = {n * FRAME_CYCLES: size_MB for n, (_, size_MB) in enumerate(resident[begun:])}
    later_MB = [size_MB for cycle, size_MB in by_cycle.items() if cycle >= FROM_CYCLE]
    growth_MB = max(later_MB) - later_MB[0]
    return {
        "resident_MB": {cycle: by_cycle[cycle] for cycle in list(by_cycle)[:: BY_CYCLE // FRAME_CYCLES]},
        "cycles": max(by_cycle),
        "growth_MB": growth_MB,
        "limit_MB": MOST_GROWTH_MB,
        "in_bounds": growth_MB <= MOST_GROWTH_MB,
    }


def _resident_MB() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def budget_speed() -> Document:
    """Measure the error budget; the shortest of some runs counts."""
    request, took_s = BudgetRequest(), []
    for _ in range(BUDGET_RUNS):
        began = time.perf_counter()
        report = run_budget(request, lambda *_: None)
        took_s.append(time.perf_counter() - began)
    return {
        "poses": request.poses,
        "sources": len(report.model.source),
        "cases": len(report.budgets),
        "seconds": min(took_s),
        "limit_s": BUDGET_LIMIT_S,
        "in_bounds": min(took_s) < BUDGET_LIMIT_S,
    }


def kinematics_speed() -> Document:
    """Measure the inverse kinematics in microseconds for each target, with all branches and checks."""
    return {
        "rigid": {kind: _time_rigid(*_draw_targets(kind)) for kind in KINDS},
        "compensated": {f"{name}, {kind}": _time_compensated(name, kind) for name in ARMS for kind in KINDS},
    }


def _rng() -> np.random.Generator:
    return np.random.default_rng(11)


def _draw_targets(kind: str) -> tuple[Array, Array]:
    """Draw positions [m] and unit approach vectors in the rover frame, (3, n) each."""
    if kind == "workspace":
        p_N_m, angles_rad = random_targets(_rng(), IK_TARGETS)
        return p_R_from_N(p_N_m.T).T, approach_from(angles_rad)
    arm = arm_of("nominal")
    q = _rng().uniform(arm.soft_min_rad[:, None], arm.soft_max_rad[:, None], (5, IK_TARGETS))
    X_RT = Trial("nominal", arm, IK_TOOL, None).tool_pose(q)
    return X_RT.p, X_RT.R[:, 0]


def _us(job: Callable[[], Any], count: int) -> float:
    """Measure a job in microseconds for each of its `count` parts."""
    began = time.perf_counter()
    job()
    return 1e6 * (time.perf_counter() - began) / count


def _time_rigid(p_m: Array, approach: Array) -> float:
    """Measure a batch of targets."""
    arm = arm_of("nominal")
    return median(
        _us(lambda: inverse_kinematics(arm, IK_TOOL, p_m, approach), IK_TARGETS) for _ in range(IK_REPEATS)
    )


def _time_compensated(name: str, kind: str) -> Document:
    """Measure a batch on Mars, and single targets: those near double roots take longer."""
    arm = arm_of(name)
    p_m, approach = _draw_targets(kind)

    def solve(p_m: Array, approach: Array) -> None:
        inverse_kinematics(arm, IK_TOOL, p_m, approach, MARS_R_m_s2)

    alone = list(zip(p_m.T[:IK_SINGLE_TARGETS], approach.T[:IK_SINGLE_TARGETS], strict=True))
    batch_us = [_us(partial(solve, p_m, approach), IK_TARGETS) for _ in range(IK_REPEATS)]
    single_us = [[_us(partial(solve, *one), 1) for one in alone] for _ in range(IK_REPEATS)]
    single_ms = 1e-3 * np.median(single_us, axis=0)
    return {
        "batch_us": median(batch_us),
        "single_ms": float(np.median(single_ms)),
        "single_p99_ms": float(np.percentile(single_ms, 99)),
    }
