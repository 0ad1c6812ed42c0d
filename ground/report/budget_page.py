"""The error budget as a page: the paper's rows beside ours, what makes up the error, where it is large."""

import base64
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.dictionary.joints import Frame
from ground.accuracy.budget import Budget
from ground.accuracy.budget_request import BudgetReport
from ground.outputs import written_whole
from ground.report.budget_tables import RULES, shown
from ground.report.figures import drawn

STYLE: Final = (
    "body{font:15px/1.5 sans-serif;max-width:62em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.25em .8em;border-bottom:1px solid #ccc;"
    "text-align:right}td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)
CELLS: Final = 14
"""Of the map, along a side."""


def save_budget_page(report: BudgetReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: the file cannot be written.
    """
    with written_whole(path, "report") as file:
        file.write(_page(report).encode())


def _page(report: BudgetReport) -> str:
    rows = [
        (row.name, row.case, *(shown(row.component, v) for v in (row.required, row.estimated, value)))
        for row, value in report.rows
    ]
    parts = [
        "<!doctype html><meta charset='utf-8'><title>Error budget</title>",
        f"<style>{STYLE}</style><h1>Error budget of the arm</h1>",
        f"<p>{html.escape(_poses(report))} Plus or minus, what 99.73 % of the poses stay within.</p>",
        html_table(("", "case", "required", "paper", "ours"), rows),
        *(_case(budget) for budget in report.budgets.values()),
        "<h2>Sources</h2>",
        html_table(
            ("source", "", "kind", "basis"),
            [(s.text, s.label, s.kind, s.basis) for s in report.model.source.values()],
        ),
        "<p>S from a public document, I inferred, A assumed.</p>",
    ]
    return "\n".join(parts)


def _poses(report: BudgetReport) -> str:
    asked = report.request
    return f"{asked.poses} poses over the workspace, tool {asked.tool}, gravity of {asked.gravity.title()}."


def _case(budget: Budget) -> str:
    rules = [
        (
            rule,
            *(shown(c, budget.estimate(rule, c)) for c in ("total_m", "lateral_m", "normal_m", "axial_rad")),
        )
        for rule in RULES
    ]
    picture = base64.b64encode(drawn((12, 4.6), 110, lambda figure: _draw(figure, budget))).decode()
    image = f"<img alt='shares and map' src='data:image/png;base64,{picture}'>"
    return f"<h2>{html.escape(budget.name)}</h2><p>{html.escape(budget.case.text)}</p>{image}" + html_table(
        ("rule", "total", "lateral", "normal", "axial"), rules
    )


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
        title="Total, mean over y and approaches", xlabel="x forward [m]", ylabel="z down [m]", aspect="equal"
    )
    figure.colorbar(shading, ax=axes, label="mm")


def html_table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """A table of texts."""
    cells = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{cells}</tr>{lines}</table>"
