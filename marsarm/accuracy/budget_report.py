"""Report of the error budget: what it shows on the console and on its page."""

from functools import partial
from math import degrees
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Frame
from marsarm.accuracy.budget import ALL, COMPONENTS, Budget, BudgetReport
from marsarm.accuracy.propagation import COVERAGE, sources_sha256
from marsarm.common.rates import describe_sample, is_within
from marsarm.render import svg
from marsarm.render.svg import ReportFigure
from simgap.common.files import json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin, Requirement
from simgap.common.report import Heading, ReportPage, ReportTable, file_lines, to_json

RULES: Final = ("paper", "moments", "root sum square", "worst case")
WHEN: Final = {
    "accuracy": "before calibration",
    "repeatability": "before calibration",
    "mars": "on Mars",
    "mars-repeatability": "on Mars",
}
"""Words for the cases that the paper has requirements for."""
FRAME_COLOURS: Final = ("#117733", "#88ccee", "#882255", "#332288", "#44aa99", "#ddcc77", "#cc6677")
"""Colours from the base to the tool that colour-blind readers tell apart too, neighbours most."""
CELLS: Final = 14
"""Number of cells along each side of the map."""


def budget_document(report: BudgetReport) -> dict[str, Any]:
    """Collect the budget in metres and radians."""
    request = report.request
    return {
        "poses": request.poses,
        "seed": request.seed,
        "gravity": request.gravity,
        "params_sha256": report.params_sha256,
        "rows": [
            {**to_json(row), "ours": value, "ratio": value / row.estimated} for row, value in report.rows
        ],
        "cases": {name: _case_document(budget) for name, budget in report.budgets.items()},
        "sources": report.model.source,
    }


def _case_document(budget: Budget) -> dict[str, Any]:
    frames = [frame.name.lower() for frame in Frame]
    return {
        "text": budget.case.text,
        "sources": budget.case.sources,
        "tools": [*budget.tools],
        "estimates": {rule: {c: budget.estimate(rule, c) for c in COMPONENTS} for rule in RULES},
        "share_m": {
            name: dict(zip(frames, share, strict=True))
            for name, share in zip(budget.case.sources, budget.share_m, strict=True)
        },
    }


def format_value(component: str, value: float) -> str:
    """Format a value in millimetres or degrees."""
    return f"{degrees(value):.2f} deg" if component.endswith("_rad") else f"{value * 1e3:.1f} mm"


def short_name(component: str) -> str:
    """Return the name of a component without its unit."""
    return component.rsplit("_", 1)[0]


def budget_parts(report: BudgetReport) -> list[str | ReportTable]:
    """Show the paper's rows beside ours, the shares of the sources, and the other combination rules."""
    parts: list[str | ReportTable] = [_paper_table(report)]
    for budget in report.budgets.values():
        parts += [_share_table(report, budget), _rule_table(budget)]
    return [*parts, *file_lines({"report": report.request.report})]


def _paper_table(report: BudgetReport) -> ReportTable:
    request = report.request
    rows = []
    for row, value in report.rows:
        limits = (format_value(row.component, v) for v in (row.required, row.estimated, value))
        rows.append((row.name, row.case, *limits, f"{value / row.estimated:.2f}"))
    title = f"Error budget by the paper's rule, {request.poses} poses, tool {request.tool}"
    return ReportTable(("", "case", "required", "paper", "ours", "ratio"), rows, title)


def _share_table(report: BudgetReport, budget: Budget) -> ReportTable:
    order = sorted(
        zip(budget.case.sources, budget.share_m * 1e3, strict=True), key=lambda pair: -pair[1].sum()
    )
    rows = []
    for name, share in order:
        cells = [f"{value:.2f}" if value >= 0.005 else "" for value in (*share, share.sum())]
        rows.append((name, report.model.source[name].label, *cells))
    head = ("source", "", *(frame.name.lower() for frame in Frame), "all")
    return ReportTable(head, rows, f"{budget.name}: shares of the total [mm]")


def _rule_table(budget: Budget) -> ReportTable:
    rows = [(rule, *(format_value(c, budget.estimate(rule, c)) for c in COMPONENTS)) for rule in RULES]
    title = f"{budget.name}: the same errors by other rules"
    return ReportTable(("rule", *map(short_name, COMPONENTS)), rows, title)


def budget_requirements(report: BudgetReport) -> list[Requirement]:
    """List the requirements of the cases; poses that are too few for a bound decide nothing."""
    sample = describe_sample(report.request.poses, "poses", COVERAGE)
    return [
        Requirement(
            f"{row.name} {WHEN[row.case]}",
            f"± {format_value(row.component, row.required)}",
            f"± {format_value(row.component, value)}, {sample}",
            is_within(report.budgets[row.case].interval("paper", row.component), row.required),
        )
        for row, value in report.rows
    ]


def budget_page(report: BudgetReport) -> ReportPage:
    """Show the paper's rows beside ours, each case with its figures, and the sources."""
    sources = [(s.text, s.label, s.kind, s.basis) for s in report.model.source.values()]
    parts: list[str | Heading | ReportTable | tuple[ReportFigure, ...]] = [
        f"{_poses(report)} Bounds, plus or minus, that hold at 99.73 % of the poses: our magnitudes by "
        "the paper's rule.",
        Heading("Beside the paper"),
        _paper_table(report),
    ]
    for name, budget in report.budgets.items():
        shares = ReportFigure(f"{name}: shares of the total", 3.9, partial(_draw_shares, budget=budget))
        total = ReportFigure(f"{name}: map of the total", 3.9, partial(_draw_map, budget=budget))
        parts += [Heading(name), budget.case.text, (shares, total), _rule_table(budget)]
    parts += [
        Heading("Sources"),
        ReportTable(("source", "", "kind", "basis"), sources),
        "S from a public document, I inferred, A assumed.",
    ]
    origin = make_origin("budget", report.request, report.params_sha256, budget_document(report))
    return ReportPage("Error budget of the arm", budget_requirements(report), origin, parts)


def make_origin(verb: str, request: Any, params_sha256: str, document: dict[str, Any]) -> Origin:
    """Name the command, the parameters, the sources of error and the result of a page."""
    digests = {
        "parameters": params_sha256,
        "sources of error": sources_sha256(),
        "result": json_sha256(to_json(document)),
    }
    return Origin(command_text(f"marsarm {verb}", request), digests)


def _poses(report: BudgetReport) -> str:
    request = report.request
    place = request.gravity.title()
    tools = "all tools" if request.tool == ALL else f"tool {request.tool}"
    return f"{request.poses} poses over the workspace, {tools}, gravity of {place}."


def _draw_shares(figure: Any, budget: Budget) -> None:
    bars, share = figure.subplots(), budget.share_m * 1e3
    order = np.argsort(share.sum(axis=1))
    names = [name.replace("_", " ") for name in budget.case.sources]
    left = np.zeros(len(names))
    for frame, colour in zip(Frame, FRAME_COLOURS, strict=True):
        look = {"label": frame.name.lower(), "color": colour, "edgecolor": svg.INK, "linewidth": 0.4}
        bars.barh([names[k] for k in order], share[order, frame], left=left, **look)
        left += share[order, frame]
    bars.set(title="Shares of the total, mean over the poses", xlabel="mm")
    bars.legend(loc="lower right")


def _draw_map(figure: Any, budget: Budget) -> None:
    axes = figure.subplots()
    p = np.concatenate([tool.poses.p_NoTo_N_m for tool in budget.tools.values()], axis=1)
    error = np.concatenate([tool.by_rule["paper"]["total_m"] for tool in budget.tools.values()]) * 1e3
    sums, x, z = np.histogram2d(p[0], p[2], CELLS, weights=error)
    counts, _, _ = np.histogram2d(p[0], p[2], (x, z))
    mean = np.ma.masked_where(counts == 0, sums / np.maximum(counts, 1))
    shading = axes.pcolormesh(x, z, mean.T, cmap="viridis", edgecolor="face", linewidth=0.3)
    axes.invert_yaxis()
    axes.axhline(0.0, color="white", linestyle="--")
    axes.set(
        title="Total by the paper's rule,\nmean over y and approaches",
        xlabel="x forward [m]",
        ylabel="z down [m]",
        aspect="equal",
    )
    svg.colour_bar(figure, shading, axes, "mm")
