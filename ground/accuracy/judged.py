"""Measured errors against the budget at their own poses: how often its bounds hold, and how wide they are."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Tool
from fsw.kinematics.transforms import Array
from ground.accuracy.at_limit import AtLimit, at_limit, backlash_sum, without_adding
from ground.accuracy.budget import COMPONENTS, COVERAGE, Budget, ToolBudget, by_source, tool_budget
from ground.accuracy.combine import bounds
from ground.accuracy.coverage import Coverage, Interval, coverage, quantile_interval
from ground.accuracy.places import Measured
from ground.accuracy.poses import Poses
from ground.accuracy.propagate import Sensitivity, sensitivity
from ground.accuracy.sources import ErrorModel

ON_FLANK: Final = 0.999
"""Of half a gap."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What a Monte Carlo says of the budget."""

    arms: int
    error: Mapping[str, Array]
    """Of each of COMPONENTS, metres or radians, (n,)."""
    budget: Budget
    """At the measured poses."""
    percentile: Mapping[str, float]
    """What 99.73 % of the errors stay within."""
    percentile_interval: Mapping[str, Interval]
    coverage: Mapping[str, Mapping[str, Coverage]]
    """By rule and component, pose by pose."""
    on_flank: Array
    """Share of the moves after which each joint's output lies on a flank of its gap, (5,)."""
    side: Array
    """Mean side on which it lies, from -1 to 1, (5,)."""
    backlash: tuple[float, float, float]
    """How far backlash moved the tool over the sum of what it can at each joint: median, 95 %, most."""
    at_limit: tuple[AtLimit, ...]
    without_adding_m: Mapping[str, float]
    """The total by the paper's rule, and with less of it added: what 99.73 % of the poses stay within."""


def judged(
    model: ErrorModel, case: str, config: Config, gravity_R_m_s2: Array, trials: Sequence[Sequence[Measured]]
) -> Judged:
    """The judgement over all trials, one of each arm."""
    by_tool = {tool: [m for trial in trials for m in trial if m.tool == tool] for tool in Tool}
    by_tool = {tool: found for tool, found in by_tool.items() if found}
    moved = {tool: _moved(config, gravity_R_m_s2, tool, found) for tool, found in by_tool.items()}
    budgets = {
        tool: tool_budget(model, model.case[case], _poses(tool, found), moved[tool])
        for tool, found in by_tool.items()
    }
    error = bounds(np.array([m.error for found in by_tool.values() for m in found]).T)
    errors: dict[str, Array] = {name: getattr(error, name) for name in COMPONENTS}
    gap = np.array([m.gap for found in by_tool.values() for m in found])
    sums = np.concatenate(
        [backlash_sum(model, moved[tool], np.array([m.gap for m in by_tool[tool]]).T) for tool in by_tool]
    )
    return Judged(
        arms=len(trials),
        error=errors,
        budget=Budget(case, model.case[case], budgets),
        percentile={name: float(np.quantile(e, COVERAGE)) for name, e in errors.items()},
        percentile_interval={name: quantile_interval(e, COVERAGE, len(trials)) for name, e in errors.items()},
        coverage={
            rule: {
                name: coverage(errors[name], _bound(budgets, rule, name), COVERAGE, len(trials))
                for name in COMPONENTS
            }
            for rule in next(iter(budgets.values())).by_rule
        },
        on_flank=np.mean(np.abs(gap) > ON_FLANK, axis=0),
        side=gap.mean(axis=0),
        backlash=(float(np.median(sums)), float(np.quantile(sums, 0.95)), float(sums.max())),
        at_limit=at_limit(model, model.case[case], list(moved.values())),
        without_adding_m=_without_adding(model, case, moved.values()),
    )


def _without_adding(model: ErrorModel, case: str, moved: Iterable[Sensitivity]) -> dict[str, float]:
    by_tool = [without_adding(*by_source(model, model.case[case], one)) for one in moved]
    return {
        name: float(np.quantile(np.concatenate([bounds(u[name]).total_m for u in by_tool]), COVERAGE))
        for name in by_tool[0]
    }


def _poses(tool: Tool, found: Sequence[Measured]) -> Poses:
    output = np.array([m.output_rad for m in found]).T
    return Poses(tool, output, np.full((3, len(found)), np.nan))


def _moved(config: Config, gravity_R_m_s2: Array, tool: Tool, found: Sequence[Measured]) -> Sensitivity:
    return sensitivity(config, _poses(tool, found), gravity_R_m_s2)


def _bound(budgets: Mapping[Tool, ToolBudget], rule: str, name: str) -> Array:
    return np.concatenate([getattr(one.by_rule[rule], name) for one in budgets.values()])
