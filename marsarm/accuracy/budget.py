"""Error budget: bounds of tool errors over the workspace, from all error sources at all frames."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from typing import Final, Literal

import numpy as np

from fsw.config import configure
from fsw.dictionary.params import digest
from fsw.kinematics.transforms import Array
from marsarm.accuracy.propagation import (
    COVERAGE,
    PARTS,
    Bounds,
    BudgetCase,
    ErrorModel,
    Poses,
    Sensitivity,
    SquaredLength,
    bounds,
    compute_sensitivity,
    is_compensated,
    load_error_model,
    moments_rule,
    paper_rule,
    pooled_quantile,
    root_sum_square,
    shares,
    squared_length,
    workspace_poses,
    worst_case,
)
from marsarm.accuracy.request import BudgetRequest
from marsarm.common.rates import Interval, quantile_interval
from marsarm.common.requests import make_world, parse_tool, select_arm
from simgap.common.errors import BadRequest
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress

Component = Literal["total_m", "lateral_m", "normal_m", "axial_rad"]
REQUIRED_TOTAL_M: Final = 0.020
REQUIRED_LATERAL_M: Final = 0.015
REQUIRED_AXIAL_RAD: Final = radians(9.8)
REPEAT_LATERAL_M: Final = 0.010
REPEAT_NORMAL_M: Final = 0.010
REPEAT_AXIAL_RAD: Final = radians(2.0)
"""Requirements of Tables 3 and 4, plus or minus: accuracy (REQUIRED), repeatability (REPEAT)."""


@dataclass(frozen=True, slots=True)
class PaperRow:
    """Row of a table of the paper; plus or minus, in metres or radians."""

    name: str
    case: str
    component: Component
    required: float
    estimated: float


def _paper_rows(accuracy: str, again: str, estimated: tuple[float, ...]) -> tuple[PaperRow, ...]:
    total, lateral, axial, lateral_again, normal_again, axial_again = estimated
    return (
        PaperRow("total position accuracy", accuracy, "total_m", REQUIRED_TOTAL_M, total),
        PaperRow("lateral position accuracy", accuracy, "lateral_m", REQUIRED_LATERAL_M, lateral),
        PaperRow("axial orientation accuracy", accuracy, "axial_rad", REQUIRED_AXIAL_RAD, axial),
        PaperRow("lateral position repeatability", again, "lateral_m", REPEAT_LATERAL_M, lateral_again),
        PaperRow("normal position repeatability", again, "normal_m", REPEAT_NORMAL_M, normal_again),
        PaperRow("axial orientation repeatability", again, "axial_rad", REPEAT_AXIAL_RAD, axial_again),
    )


TABLE_3: Final = _paper_rows(
    "accuracy", "repeatability", (0.0262, 0.0232, radians(1.2), 0.0112, 0.0072, radians(0.7))
)
"""Before calibration."""
TABLE_4: Final = _paper_rows(
    "mars", "mars-repeatability", (0.0140, 0.0127, radians(1.1), 0.0077, 0.0050, radians(1.0))
)
"""After calibration, on Mars."""


MOMENTS: Final = "moments"
ALL: Final = "all"
COMPONENTS: Final = tuple(PARTS)


@dataclass(frozen=True, slots=True, eq=False)
class ToolBudget:
    """Bounds of the errors of one tool at each pose."""

    poses: Poses
    by_rule: Mapping[str, Bounds]
    """Bounds by combination rule: paper (equation 13), worst case (10), root sum square (11), moments."""
    lengths: Mapping[str, SquaredLength]
    """Distributions of squared error lengths by COMPONENTS, for the moments rule."""
    share_m: Array
    """Share of each source at each frame in the paper's total, mean over the poses, shape (sources, 7)."""


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """Error budget of a case."""

    name: str
    case: BudgetCase
    tools: Mapping[str, ToolBudget]

    def estimate(self, rule: str, component: str) -> float:
        """Compute the bound [m, rad] that holds at 99.73 % of the poses.

        The moments rule gives the bound that holds for 99.73 % of the errors.
        """
        if rule == MOMENTS:
            return pooled_quantile([tool.lengths[component] for tool in self.tools.values()], COVERAGE)
        return float(np.quantile(self.bounds(rule, component), COVERAGE))

    def interval(self, rule: str, component: str) -> Interval:
        """Compute the 95 % confidence interval of the bound that holds at 99.73 % of the poses."""
        values = self.bounds(rule, component)
        return quantile_interval(values, COVERAGE, values.size)

    def bounds(self, rule: str, component: str) -> Array:
        """Return the bounds at all poses, tool by tool."""
        return np.concatenate([tool.by_rule[rule][component] for tool in self.tools.values()])

    @property
    def share_m(self) -> Array:
        """Compute the mean shares over all poses of all tools, shape (sources, 7)."""
        counts = [tool.poses.output_rad.shape[1] for tool in self.tools.values()]
        return np.asarray(np.average([tool.share_m for tool in self.tools.values()], axis=0, weights=counts))


def compute_tool_budget(
    model: ErrorModel, case: BudgetCase, poses: Poses, sensitivity: Sensitivity
) -> ToolBudget:
    """Compute the bounds of the errors of a case at these poses."""
    u = np.array(
        [factor * sensitivity.errors_by_frame(model.source[name]) for name, factor in case.sources.items()]
    )
    at_limit = np.array([model.source[name].at_limit for name in case.sources])
    lengths = _squared_lengths(model, case, sensitivity)
    worst = bounds(worst_case(u))
    rules = {
        "paper": bounds(paper_rule(u, at_limit)),
        "worst case": worst,
        "root sum square": bounds(root_sum_square(u)),
        MOMENTS: moments_rule(lengths, worst, COVERAGE),
    }
    return ToolBudget(poses, rules, lengths, shares(u, at_limit).mean(axis=-1))


def _squared_lengths(
    model: ErrorModel, case: BudgetCase, sensitivity: Sensitivity
) -> dict[str, SquaredLength]:
    """Compute the distributions of squared error lengths of a case.

    If gravity holds an output at a flank, the backlash is a known offset and not a random error.
    """
    errors, known = [], np.zeros((6, sensitivity.side.shape[1]))
    for name, factor in case.sources.items():
        source = model.source[name]
        u = factor * sensitivity.errors(source)
        if source.effect == "backlash" and not is_compensated(factor):
            known += np.einsum("ikn,kn->in", u, sensitivity.side)
            u = u * (sensitivity.side == 0)
        errors.append((u, source.distribution))
    return {
        name: squared_length([(u[part], distribution) for u, distribution in errors], known[part])
        for name, part in PARTS.items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class BudgetReport:
    """Result of a request for an error budget."""

    request: BudgetRequest
    model: ErrorModel
    budgets: Mapping[str, Budget]
    rows: tuple[tuple[PaperRow, float], ...]
    """Rows of the paper for the requested cases, with our values."""
    params_sha256: str


def run_budget(request: BudgetRequest, progress: Progress = no_progress) -> BudgetReport:
    """Compute the budgets of one case or of all cases; BadRequest if the request is wrong."""
    check_options(request)
    model = load_error_model()
    names = tuple(model.case) if request.case == ALL else (request.case,)
    if request.case not in (ALL, *model.case):
        raise BadRequest(f"case: {request.case!r} is not known; there are {', '.join(model.case)} and {ALL}")
    gravity = make_world(request.gravity, 0.0, 0.0, "gravity").gravity_N_m_s2
    params = select_arm("nominal", request.params, request.mismatch).params
    tool = parse_tool(request.tool, (*params.tool_names, ALL))
    tools = params.tool_names if tool == ALL else (tool,)
    config = configure(params)
    found: dict[str, dict[str, ToolBudget]] = {name: {} for name in names}
    for k, tool in enumerate(tools):  # which share the poses evenly
        progress(k, len(tools), tool)
        poses = workspace_poses(config.arm, tool, gravity, -(-request.poses // len(tools)), request.seed)
        sensitivity = compute_sensitivity(config, poses, gravity)
        for name in names:
            found[name][tool] = compute_tool_budget(model, model.case[name], poses, sensitivity)
    budgets = {name: Budget(name, model.case[name], found[name]) for name in names}
    rows = [
        (row, budgets[row.case].estimate("paper", row.component))
        for row in (*TABLE_3, *TABLE_4)
        if row.case in budgets
    ]
    return BudgetReport(request, model, budgets, tuple(rows), digest(params))
