"""Comparison of measured errors with the budget at the same poses: coverage and width."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.kinematics.transforms import Array
from marsarm.accuracy.budget import COMPONENTS, Budget, compute_tool_budget
from marsarm.accuracy.confidence import Coverage, Interval, estimate_coverage, quantile_interval
from marsarm.accuracy.propagation import COVERAGE, Poses, bounds, compute_sensitivity
from marsarm.accuracy.sources import ErrorModel
from marsarm.accuracy.trial import MeasuredPlacement


@dataclass(frozen=True, slots=True, eq=False)
class CoverageReport:
    """Comparison of a Monte Carlo with the budget."""

    arms: int
    error: Mapping[str, Array]
    """Errors of each of COMPONENTS, metres or radians, shape (n,)."""
    budget: Budget
    """Budget at the measured poses."""
    percentile: Mapping[str, float]
    """Error length that 99.73 % of the errors do not exceed."""
    percentile_interval: Mapping[str, Interval]
    by_rule: Mapping[str, Mapping[str, Coverage]]
    """Coverage by rule and component."""


def check_coverage(
    model: ErrorModel,
    case: str,
    config: Config,
    gravity_R_m_s2: Array,
    trials: Sequence[Sequence[MeasuredPlacement]],
) -> CoverageReport:
    """Compare the budget of a case with the trials, one trial for each arm."""
    placements = [m for trial in trials for m in trial]
    used = [tool for tool in config.params.tool_names if any(m.tool == tool for m in placements)]
    by_tool = {tool: [m for m in placements if m.tool == tool] for tool in used}
    budgets = {}
    for tool, found in by_tool.items():
        output = np.array([m.output_rad for m in found]).T
        poses = Poses(tool, output, np.full((3, len(found)), np.nan))
        sensitivity = compute_sensitivity(config, poses, gravity_R_m_s2)
        budgets[tool] = compute_tool_budget(model, model.case[case], poses, sensitivity)
    budget = Budget(case, model.case[case], budgets)
    error = bounds(np.array([m.error for found in by_tool.values() for m in found]).T)
    errors: dict[str, Array] = {name: getattr(error, name) for name in COMPONENTS}
    return CoverageReport(
        arms=len(trials),
        error=errors,
        budget=budget,
        percentile={name: float(np.quantile(e, COVERAGE)) for name, e in errors.items()},
        percentile_interval={name: quantile_interval(e, COVERAGE, len(trials)) for name, e in errors.items()},
        by_rule={
            rule: {
                name: estimate_coverage(errors[name], budget.bounds(rule, name), COVERAGE, len(trials))
                for name in COMPONENTS
            }
            for rule in next(iter(budgets.values())).by_rule
        },
    )
