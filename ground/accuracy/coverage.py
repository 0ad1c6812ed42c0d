"""Measured errors against the budget at their own poses: how often its bounds hold, and how wide they are."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Joint, Tool
from fsw.kinematics.transforms import Array, Flags
from ground.accuracy.budget import (
    COMPONENTS,
    COVERAGE,
    Budget,
    ToolBudget,
    compute_tool_budget,
    errors_by_source,
)
from ground.accuracy.combine import TOTAL, bounds, paper_rule, pooled_quantile, squared_length
from ground.accuracy.confidence import Coverage, Interval, estimate_coverage, quantile_interval
from ground.accuracy.placements import MeasuredPlacement
from ground.accuracy.sensitivity import Poses, Sensitivity, compute_sensitivity
from ground.accuracy.sources import BudgetCase, ErrorModel


@dataclass(frozen=True, slots=True)
class AdditivityCheck:
    """A source that the paper's rule adds: what 99.73 % of the poses, or of the errors, stay within [m]."""

    source: str
    added_m: float
    """Absolute components, frame by frame: what the rule adds."""
    together_m: float
    """Every frame at its limit, but with its sign: one number that is wrong for the whole arm."""
    independent_m: float
    """Every frame by itself, as far as its spread has it."""


def check_additivity(
    model: ErrorModel, case: BudgetCase, moved: Sequence[Sensitivity]
) -> tuple[AdditivityCheck, ...]:
    """Of the sources of a case that the rule adds, over the poses of all tools."""
    return tuple(
        _check_source(model, name, factor, moved)
        for name, factor in case.sources.items()
        if model.source[name].at_limit
    )


def _check_source(
    model: ErrorModel, name: str, factor: float, moved: Sequence[Sensitivity]
) -> AdditivityCheck:
    source = model.source[name]
    added = [np.abs(factor * one.errors(source)[TOTAL]).sum(axis=1) for one in moved]
    signed = [(factor * one.errors(source)[TOTAL]).sum(axis=1) for one in moved]
    lengths = [squared_length([(factor * one.errors(source)[TOTAL], source.distribution)]) for one in moved]
    return AdditivityCheck(
        name,
        _covered_m(added),
        _covered_m(signed),
        min(pooled_quantile(lengths, COVERAGE), _covered_m(added)),
    )


def _covered_m(shifts: list[Array]) -> float:
    return float(np.quantile(np.linalg.norm(np.concatenate(shifts, axis=-1), axis=0), COVERAGE))


def backlash_ratio(model: ErrorModel, moved: Sensitivity, gap: Array) -> Array:
    """How far outputs in their gaps (5, n) move the tool, over the sum of what each can, (n,)."""
    by_joint = moved.errors(model.source["backlash"])[TOTAL][:, : len(Joint)]
    there = np.einsum("ikn,kn->in", by_joint, gap)
    most = np.linalg.norm(np.abs(by_joint).sum(axis=1), axis=0)
    return np.asarray(np.linalg.norm(there, axis=0) / most)


def paper_rule_variants(u: Array, at_limit: Flags) -> dict[str, Array]:
    """What the paper's rule says of errors (sources, 6, 7, n), were less of it adding: components (6, n)."""
    rooted = np.sqrt((u**2).sum(axis=2, keepdims=True))
    no_source = np.zeros_like(at_limit)
    return {
        "paper": paper_rule(u, at_limit),
        "paper, no source added": paper_rule(u, no_source),
        "paper, no frames added": paper_rule(rooted, at_limit),
        "paper, neither added": paper_rule(rooted, no_source),
    }


ON_FLANK: Final = 0.999
"""Of half a gap."""


@dataclass(frozen=True, slots=True, eq=False)
class CoverageReport:
    """What a Monte Carlo says of the budget."""

    arms: int
    error: Mapping[str, Array]
    """Of each of COMPONENTS, metres or radians, (n,)."""
    budget: Budget
    """At the measured poses."""
    percentile: Mapping[str, float]
    """What 99.73 % of the errors stay within."""
    percentile_interval: Mapping[str, Interval]
    by_rule: Mapping[str, Mapping[str, Coverage]]
    """By rule and component, pose by pose."""
    on_flank: Array
    """Share of the moves after which each joint's output lies on a flank of its gap, (5,)."""
    side: Array
    """Mean side on which it lies, from -1 to 1, (5,)."""
    backlash: tuple[float, float, float]
    """How far backlash moved the tool over the sum of what it can at each joint: median, 95 %, most."""
    additivity: tuple[AdditivityCheck, ...]
    variant_totals_m: Mapping[str, float]
    """The total by the paper's rule, and with less of it added: what 99.73 % of the poses stay within."""


def check_coverage(
    model: ErrorModel,
    case: str,
    config: Config,
    gravity_R_m_s2: Array,
    trials: Sequence[Sequence[MeasuredPlacement]],
) -> CoverageReport:
    """The judgement over all trials, one of each arm."""
    by_tool = {tool: [m for trial in trials for m in trial if m.tool == tool] for tool in Tool}
    by_tool = {tool: found for tool, found in by_tool.items() if found}
    moved = {tool: _tool_sensitivity(config, gravity_R_m_s2, tool, found) for tool, found in by_tool.items()}
    budgets = {
        tool: compute_tool_budget(model, model.case[case], _measured_poses(tool, found), moved[tool])
        for tool, found in by_tool.items()
    }
    error = bounds(np.array([m.error for found in by_tool.values() for m in found]).T)
    errors: dict[str, Array] = {name: getattr(error, name) for name in COMPONENTS}
    gap = np.array([m.gap for found in by_tool.values() for m in found])
    sums = np.concatenate(
        [backlash_ratio(model, moved[tool], np.array([m.gap for m in by_tool[tool]]).T) for tool in by_tool]
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
        on_flank=np.mean(np.abs(gap) > ON_FLANK, axis=0),
        side=gap.mean(axis=0),
        backlash=(float(np.median(sums)), float(np.quantile(sums, 0.95)), float(sums.max())),
        additivity=check_additivity(model, model.case[case], list(moved.values())),
        variant_totals_m=_variant_totals_m(model, case, moved.values()),
    )


def _variant_totals_m(model: ErrorModel, case: str, moved: Iterable[Sensitivity]) -> dict[str, float]:
    by_tool = [paper_rule_variants(*errors_by_source(model, model.case[case], one)) for one in moved]
    return {
        name: float(np.quantile(np.concatenate([bounds(u[name]).total_m for u in by_tool]), COVERAGE))
        for name in by_tool[0]
    }


def _measured_poses(tool: Tool, found: Sequence[MeasuredPlacement]) -> Poses:
    output = np.array([m.output_rad for m in found]).T
    return Poses(tool, output, np.full((3, len(found)), np.nan))


def _tool_sensitivity(
    config: Config, gravity_R_m_s2: Array, tool: Tool, found: Sequence[MeasuredPlacement]
) -> Sensitivity:
    return compute_sensitivity(config, _measured_poses(tool, found), gravity_R_m_s2)


def _join_bounds(budgets: Mapping[Tool, ToolBudget], rule: str, name: str) -> Array:
    return np.concatenate([getattr(one.by_rule[rule], name) for one in budgets.values()])
