"""The error budget: what every source, at every frame, makes of the tool's error over the workspace."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Tool
from fsw.kinematics.transforms import Array, Flags
from ground.accuracy.combine import (
    PARTS,
    Bounds,
    SquaredLength,
    bounds,
    moments_rule,
    paper_rule,
    pooled_quantile,
    root_sum_square,
    shares,
    squared_length,
    worst_case,
)
from ground.accuracy.sensitivity import Poses, Sensitivity, compute_sensitivity, workspace_poses
from ground.accuracy.sources import BudgetCase, ErrorModel, is_compensated
from ground.common.progress import Progress

MOMENTS: Final = "moments"
COVERAGE: Final = 0.9973
"""Three sigma of a normal error; and the share of the poses whose bound is within what is reported."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolBudget:
    """What the errors of one tool stay within, pose by pose."""

    poses: Poses
    by_rule: Mapping[str, Bounds]
    """paper (equation 13), worst case (10), root sum square (11), moments (ours)."""
    lengths: tuple[SquaredLength, ...]
    """Of what each of COMPONENTS is the length of, as ours has them."""
    share_m: Array
    """Of every source at every frame in the total by the paper's rule, mean over the poses, (sources, 7)."""


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """The budget of a case."""

    name: str
    case: BudgetCase
    tools: Mapping[Tool, ToolBudget]

    def estimate(self, rule: str, component: str) -> float:
        """The bound [m, rad] that 99.73 % of the poses stay within; by ours, what so many errors do."""
        if rule == MOMENTS:
            k = COMPONENTS.index(component)
            return pooled_quantile([tool.lengths[k] for tool in self.tools.values()], COVERAGE)
        values = [getattr(tool.by_rule[rule], component) for tool in self.tools.values()]
        return float(np.quantile(np.concatenate(values), COVERAGE))

    @property
    def share_m(self) -> Array:
        """Over all poses of all tools, (sources, 7)."""
        counts = [tool.poses.output_rad.shape[1] for tool in self.tools.values()]
        return np.asarray(np.average([tool.share_m for tool in self.tools.values()], axis=0, weights=counts))


def compute_budgets(
    model: ErrorModel,
    names: tuple[str, ...],
    config: Config,
    gravity_R_m_s2: Array,
    tools: tuple[Tool, ...],
    count: int,
    seed: int,
    progress: Progress,
) -> dict[str, Budget]:
    """The budgets of some cases, at so many poses in all, shared evenly by the tools."""
    found: dict[str, dict[Tool, ToolBudget]] = {name: {} for name in names}
    for k, tool in enumerate(tools):
        progress(k, len(tools), tool.name.lower())
        poses = workspace_poses(config.arm, tool, gravity_R_m_s2, -(-count // len(tools)), seed)
        moved = compute_sensitivity(config, poses, gravity_R_m_s2)
        for name in names:
            found[name][tool] = compute_tool_budget(model, model.case[name], poses, moved)
    return {name: Budget(name, model.case[name], found[name]) for name in names}


def compute_tool_budget(model: ErrorModel, case: BudgetCase, poses: Poses, moved: Sensitivity) -> ToolBudget:
    """What the errors of a case stay within at these poses."""
    u, at_limit = errors_by_source(model, case, moved)
    lengths = _squared_lengths(model, case, moved)
    worst = bounds(worst_case(u))
    rules = {
        "paper": bounds(paper_rule(u, at_limit)),
        "worst case": worst,
        "root sum square": bounds(root_sum_square(u)),
        MOMENTS: moments_rule(lengths, worst, COVERAGE),
    }
    return ToolBudget(poses, rules, lengths, shares(u, at_limit).mean(axis=-1))


def _squared_lengths(model: ErrorModel, case: BudgetCase, moved: Sensitivity) -> tuple[SquaredLength, ...]:
    """Of the errors of a case; where gravity holds an output on a flank, backlash is known and not drawn."""
    errors, known = [], np.zeros((6, moved.side.shape[1]))
    for name, factor in case.sources.items():
        source = model.source[name]
        u = factor * moved.errors(source)
        if source.effect == "backlash" and not is_compensated(factor):
            known += np.einsum("ikn,kn->in", u, moved.side)
            u = u * (moved.side == 0)
        errors.append((u, source.distribution))
    return tuple(squared_length([(u[part], spread) for u, spread in errors], known[part]) for part in PARTS)


def errors_by_source(model: ErrorModel, case: BudgetCase, moved: Sensitivity) -> tuple[Array, Flags]:
    """Errors (sources, 6, 7, n) of a case, and which sources are at their limits."""
    u = [factor * moved.errors_by_frame(model.source[name]) for name, factor in case.sources.items()]
    return np.array(u), np.array([model.source[name].at_limit for name in case.sources])


COMPONENTS: Final = tuple(field.name for field in fields(Bounds))
