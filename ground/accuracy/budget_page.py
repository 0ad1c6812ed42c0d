"""The error budget as a page: the paper's rows beside ours, what makes up the error, where it is large."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Frame
from ground.accuracy.budget import COMPONENTS, Budget
from ground.accuracy.budget_request import BudgetReport
from ground.accuracy.budget_tables import RULES, shown
from ground.render.figures import drawn
from ground.render.page import heading, image, paragraph, save_page, table

CELLS: Final = 14
"""Of the map, along a side."""


def save_budget_page(report: BudgetReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: the file cannot be written.
    """
    rows = [
        (row.name, row.case, *(shown(row.component, v) for v in (row.required, row.estimated, value)))
        for row, value in report.rows
    ]
    sources = [(s.text, s.label, s.kind, s.basis) for s in report.model.source.values()]
    parts = [
        paragraph(
            f"{_poses(report)} Plus or minus, what the bounds of 99.73 % of the poses stay within; ours are "
            "our magnitudes by the paper's rule."
        ),
        table(("", "case", "required", "paper", "ours"), rows),
        *(part for budget in report.budgets.values() for part in _case(budget)),
        heading("Sources"),
        table(("source", "", "kind", "basis"), sources),
        paragraph("S from a public document, I inferred, A assumed."),
    ]
    save_page("Error budget of the arm", parts, path)


def _poses(report: BudgetReport) -> str:
    asked = report.request
    return f"{asked.poses} poses over the workspace, tool {asked.tool}, gravity of {asked.gravity.title()}."


def _case(budget: Budget) -> list[str]:
    rules = [(rule, *(shown(c, budget.estimate(rule, c)) for c in COMPONENTS)) for rule in RULES]
    picture = drawn((12, 4.6), 110, lambda figure: _draw(figure, budget))
    return [
        heading(budget.name),
        paragraph(budget.case.text),
        image(picture, "shares and map"),
        table(("rule", *(name.rsplit("_", 1)[0] for name in COMPONENTS)), rules),
    ]


def _draw(figure: Any, budget: Budget) -> None:
    bars, area = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
    share = budget.share_m * 1e3
    order = np.argsort(share.sum(axis=1))
    names = list(budget.case.sources)
    left = np.zeros(len(names))
    for frame in Frame:
        bars.barh([names[k] for k in order], share[order, frame], left=left, label=frame.name.lower())
        left += share[order, frame]
    bars.set(title="What makes up the total, mean over the poses", xlabel="mm")
    bars.legend(fontsize=8)
    _map(figure, area, budget)


def _map(figure: Any, axes: Any, budget: Budget) -> None:
    p = np.concatenate([tool.poses.p_NoTo_N_m for tool in budget.tools.values()], axis=1)
    error = np.concatenate([tool.by_rule["paper"].total_m for tool in budget.tools.values()]) * 1e3
    sums, x, z = np.histogram2d(p[0], p[2], CELLS, weights=error)
    counts, _, _ = np.histogram2d(p[0], p[2], (x, z))
    mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    shading = axes.pcolormesh(x, z, mean.T, cmap="viridis")
    axes.invert_yaxis()
    axes.axhline(0.0, color="white", linestyle="--")
    axes.set(
        title="Total by the paper's rule, mean over y and approaches",
        xlabel="x forward [m]",
        ylabel="z down [m]",
        aspect="equal",
    )
    figure.colorbar(shading, ax=axes, label="mm")
