"""Comparison of measured errors with the budget at the same poses: coverage, width, and additivity."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array, Flags
from marsarm.accuracy.budget import COMPONENTS, Budget, ToolBudget, compute_tool_budget, errors_by_source
from marsarm.accuracy.confidence import Coverage, Interval, estimate_coverage, quantile_interval
from marsarm.accuracy.propagation import (
    COVERAGE,
    TOTAL,
    Poses,
    Sensitivity,
    bounds,
    compute_sensitivity,
    paper_rule,
    pooled_quantile,
    squared_length,
)
from marsarm.accuracy.sources import BudgetCase, ErrorModel
from marsarm.accuracy.trial import MeasuredPlacement

ON_FLANK: Final = 0.999
"""Smallest distance from the centre, as a share of half the backlash, that counts as on a flank."""


@dataclass(frozen=True, slots=True)
class AdditivityCheck:
    """Bounds of a source that the paper's rule adds, over 99.73 % of poses or of errors [m]."""

    source: str
    added_m: float
    """Sum of absolute components over frames, as the rule adds them."""
    same_sign_m: float
    """Signed sum with every frame at its limit, as for one wrong number of the whole arm."""
    independent_m: float
    """Bound for independent frames with the distribution of the source."""


def check_additivity(
    model: ErrorModel, case: BudgetCase, sensitivity: Sequence[Sensitivity]
) -> tuple[AdditivityCheck, ...]:
    """Check the sources that the paper's rule adds, over the poses of all tools."""
    return tuple(
        _check_source(model, name, factor, sensitivity)
        for name, factor in case.sources.items()
        if model.source[name].at_limit
    )


def _check_source(
    model: ErrorModel, name: str, factor: float, sensitivity: Sequence[Sensitivity]
) -> AdditivityCheck:
    source = model.source[name]
    added = [np.abs(factor * one.errors(source)[TOTAL]).sum(axis=1) for one in sensitivity]
    signed = [(factor * one.errors(source)[TOTAL]).sum(axis=1) for one in sensitivity]
    lengths = [
        squared_length([(factor * one.errors(source)[TOTAL], source.distribution)]) for one in sensitivity
    ]
    return AdditivityCheck(
        name,
        _covered_m(added),
        _covered_m(signed),
        min(pooled_quantile(lengths, COVERAGE), _covered_m(added)),
    )


def _covered_m(shifts: list[Array]) -> float:
    return float(np.quantile(np.linalg.norm(np.concatenate(shifts, axis=-1), axis=0), COVERAGE))


def backlash_ratio(model: ErrorModel, sensitivity: Sensitivity, side: Array) -> Array:
    """Compute the tool motion by backlash over the sum of the largest motions by each joint, (n,).

    Outputs are at positions in their backlash, (5, n), that are -1 and +1 at the flanks.
    """
    by_joint = sensitivity.errors(model.source["backlash"])[TOTAL][:, : len(Joint)]
    motion = np.einsum("ikn,kn->in", by_joint, side)
    most = np.linalg.norm(np.abs(by_joint).sum(axis=1), axis=0)
    return np.asarray(np.linalg.norm(motion, axis=0) / most)


def paper_rule_variants(u: Array, at_limit: Flags) -> dict[str, Array]:
    """Combine errors (sources, 6, 7, n) by the paper's rule and by variants that add less: (6, n) by name."""
    rooted = np.sqrt((u**2).sum(axis=2, keepdims=True))
    no_source = np.zeros_like(at_limit)
    return {
        "paper": paper_rule(u, at_limit),
        "paper, no source added": paper_rule(u, no_source),
        "paper, no frames added": paper_rule(rooted, at_limit),
        "paper, neither added": paper_rule(rooted, no_source),
    }


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
    on_flank: Array
    """Share of moves after which each output lies on a flank of its backlash, shape (5,)."""
    side: Array
    """Mean position of each output in its backlash, from -1 to 1, shape (5,)."""
    backlash: tuple[float, float, float]
    """Ratios of `backlash_ratio`: median, 95 % quantile, maximum."""
    additivity: tuple[AdditivityCheck, ...]
    variant_totals_m: Mapping[str, float]
    """Total error by the paper's rule and by variants that add less, which holds at 99.73 % of the poses."""


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
    sensitivity = {
        tool: compute_sensitivity(config, _measured_poses(tool, found), gravity_R_m_s2)
        for tool, found in by_tool.items()
    }
    budgets = {
        tool: compute_tool_budget(model, model.case[case], _measured_poses(tool, found), sensitivity[tool])
        for tool, found in by_tool.items()
    }
    error = bounds(np.array([m.error for found in by_tool.values() for m in found]).T)
    errors: dict[str, Array] = {name: getattr(error, name) for name in COMPONENTS}
    side = np.array([m.backlash_position for found in by_tool.values() for m in found])
    sums = np.concatenate(
        [
            backlash_ratio(model, sensitivity[tool], np.array([m.backlash_position for m in by_tool[tool]]).T)
            for tool in by_tool
        ]
    )
    return CoverageReport(
        arms=len(trials),
        error=errors,
        budget=Budget(case, model.case[case], budgets),
        percentile={name: float(np.quantile(e, COVERAGE)) for name, e in errors.items()},
        percentile_interval={name: quantile_interval(e, COVERAGE, len(trials)) for name, e in errors.items()},
        by_rule={
            rule: {
                name: estimate_coverage(
                    errors[name], _join_bounds(budgets, rule, name), COVERAGE, len(trials)
                )
                for name in COMPONENTS
            }
            for rule in next(iter(budgets.values())).by_rule
        },
        on_flank=np.mean(np.abs(side) > ON_FLANK, axis=0),
        side=side.mean(axis=0),
        backlash=(float(np.median(sums)), float(np.quantile(sums, 0.95)), float(sums.max())),
        additivity=check_additivity(model, model.case[case], list(sensitivity.values())),
        variant_totals_m=_variant_totals_m(model, case, sensitivity.values()),
    )


def _variant_totals_m(model: ErrorModel, case: str, sensitivity: Iterable[Sensitivity]) -> dict[str, float]:
    by_tool = [paper_rule_variants(*errors_by_source(model, model.case[case], one)) for one in sensitivity]
    return {
        name: float(np.quantile(np.concatenate([bounds(u[name]).total_m for u in by_tool]), COVERAGE))
        for name in by_tool[0]
    }


def _measured_poses(tool: str, found: Sequence[MeasuredPlacement]) -> Poses:
    output = np.array([m.output_rad for m in found]).T
    return Poses(tool, output, np.full((3, len(found)), np.nan))


def _join_bounds(budgets: Mapping[str, ToolBudget], rule: str, name: str) -> Array:
    return np.concatenate([getattr(one.by_rule[rule], name) for one in budgets.values()])
