"""Report of the error budget: JSON document, tables, and a page with the paper's values beside ours."""

from math import degrees
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.table import Table

from fsw.dictionary.enums import Frame
from marsarm.accuracy.budget import ALL, COMPONENTS, Budget, BudgetReport
from marsarm.accuracy.combine import COVERAGE
from marsarm.accuracy.confidence import describe_sample, is_within
from marsarm.accuracy.reproduce import MagnitudeFit
from marsarm.accuracy.sources import sources_sha256
from simgap.common import svg
from simgap.common.console import plain_console
from simgap.common.json_digest import json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin, Requirement, figures, heading, paragraph, save_page, table

RULES: Final = ("paper", "moments", "root sum square", "worst case")
WHEN: Final = {
    "accuracy": "before calibration",
    "repeatability": "before calibration",
    "mars": "on Mars",
    "mars-repeatability": "on Mars",
}
"""Words for the cases that the paper has requirements for."""
FRAME_COLOURS: Final = ("#482878", "#3e4a89", "#31688e", "#21918c", "#35b779", "#90d743", "#fde725")
"""Colours from the base to the tool that grow brighter, so that all readers can tell them apart."""
CELLS: Final = 14
"""Number of cells along each side of the map."""


def budget_json(report: BudgetReport) -> dict[str, Any]:
    """Convert the budget to a JSON document in metres and radians."""
    return {
        "poses": report.request.poses,
        "seed": report.request.seed,
        "gravity": report.request.gravity,
        "params_sha256": report.params_sha256,
        "rows": [
            {
                "name": row.name,
                "case": row.case,
                "component": row.component,
                "required": row.required,
                "paper": row.estimated,
                "ours": value,
                "ratio": value / row.estimated,
            }
            for row, value in report.rows
        ],
        "cases": {name: _case_json(budget) for name, budget in report.budgets.items()},
        "sources": {
            name: {
                "text": source.text,
                "kind": source.kind,
                "label": source.label,
                "basis": source.basis,
                "distribution": source.distribution,
                "at_limit": source.at_limit,
            }
            for name, source in report.model.source.items()
        },
        "reproduced": [_reproduced_json(found) for found in report.reproduced],
    }


def _case_json(budget: Budget) -> dict[str, Any]:
    return {
        "text": budget.case.text,
        "sources": dict(budget.case.sources),
        "tools": [*budget.tools],
        "estimates": {
            rule: {component: budget.estimate(rule, component) for component in COMPONENTS} for rule in RULES
        },
        "share_m": {
            name: dict(zip((frame.name.lower() for frame in Frame), share.tolist(), strict=True))
            for name, share in zip(budget.case.sources, budget.share_m, strict=True)
        },
    }


def _reproduced_json(found: MagnitudeFit) -> dict[str, Any]:
    return {
        "rows": {row.name: value for row, value in found.rows},
        "magnitudes": [
            {
                "source": source,
                "part": part,
                "factor": factor,
                "magnitude": found.magnitude[source, part][0],
                "unit": found.magnitude[source, part][1],
            }
            for (source, part), factor in found.factor.items()
        ],
    }


def format_value(component: str, value: float) -> str:
    """Format a value in millimetres or degrees."""
    return f"{degrees(value):.2f} deg" if component.endswith("_rad") else f"{value * 1e3:.1f} mm"


def budget_table(report: BudgetReport, picture_problem: str | None) -> None:
    """Print the paper's rows beside ours, the shares of the sources, and the other combination rules."""
    console = plain_console()
    console.print(_rows(report))
    for budget in report.budgets.values():
        console.print(_shares(report, budget))
        console.print(_rules(budget))
    for found in report.reproduced:
        console.print(_reproduced(found))
    if report.request.report is not None:
        console.print(f"report  {report.request.report}")
    if report.request.picture is not None:
        console.print(f"picture  {picture_problem or report.request.picture}")


def _rows(report: BudgetReport) -> Table:
    request = report.request
    title = f"Error budget by the paper's rule, {request.poses} poses, tool {request.tool}"
    table = Table(title=title, title_justify="left")
    for name in ("", "case", "required", "paper", "ours", "ratio"):
        table.add_column(name, justify="left" if name in ("", "case") else "right")
    for row, value in report.rows:
        limits = (format_value(row.component, v) for v in (row.required, row.estimated, value))
        table.add_row(row.name, row.case, *limits, f"{value / row.estimated:.2f}")
    return table


def _shares(report: BudgetReport, budget: Budget) -> Table:
    table = Table(title=f"{budget.name}: shares of the total [mm]", title_justify="left")
    table.add_column("source")
    table.add_column("")
    for frame in Frame:
        table.add_column(frame.name.lower(), justify="right")
    table.add_column("all", justify="right")
    order = sorted(
        zip(budget.case.sources, budget.share_m * 1e3, strict=True), key=lambda pair: -pair[1].sum()
    )
    for name, share in order:
        cells = [f"{value:.2f}" if value >= 0.005 else "" for value in (*share, share.sum())]
        table.add_row(name, report.model.source[name].label, *cells)
    return table


def _rules(budget: Budget) -> Table:
    table = Table(title=f"{budget.name}: the same errors by other rules", title_justify="left")
    table.add_column("rule")
    for component in COMPONENTS:
        table.add_column(component.rsplit("_", 1)[0], justify="right")
    for rule in RULES:
        table.add_row(rule, *(format_value(c, budget.estimate(rule, c)) for c in COMPONENTS))
    return table


def _reproduced(found: MagnitudeFit) -> Table:
    table = Table(title="Magnitudes that reproduce the paper", title_justify="left")
    for name in ("source", "part", "magnitude", "times ours"):
        table.add_column(name, justify="right" if name in ("magnitude", "times ours") else "left")
    for (source, part), factor in found.factor.items():
        value, unit = found.magnitude[source, part]
        table.add_row(source, part, f"{value:.3f} {unit}", f"{factor:.2f}")
    for row, value in found.rows:
        table.add_row(row.name, row.case, format_value(row.component, value), f"{value / row.estimated:.2f}")
    return table


def list_requirements(report: BudgetReport) -> list[Requirement]:
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


def save_budget_page(report: BudgetReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: The file cannot be written.
    """
    rows = [
        (
            row.name,
            WHEN[row.case],
            format_value(row.component, row.estimated),
            format_value(row.component, value),
            f"{value / row.estimated:.2f}",
        )
        for row, value in report.rows
    ]
    sources = [(s.text, s.label, s.kind, s.basis) for s in report.model.source.values()]
    parts = [
        paragraph(
            f"{_poses(report)} Bounds, plus or minus, that hold at 99.73 % of the poses: our magnitudes by "
            "the paper's rule."
        ),
        heading("Beside the paper"),
        table(("", "", "paper", "ours", "ours to the paper's"), rows),
        *(part for budget in report.budgets.values() for part in _case(budget)),
        heading("Sources"),
        table(("source", "", "kind", "basis"), sources),
        paragraph("S from a public document, I inferred, A assumed."),
    ]
    digests = {
        "parameters": report.params_sha256,
        "sources of error": sources_sha256(),
        "result": json_sha256(budget_json(report)),
    }
    origin = Origin(command_text("budget", report.request), digests)
    save_page("Error budget of the arm", "", list_requirements(report), origin, parts, path)


def _poses(report: BudgetReport) -> str:
    request = report.request
    place = request.gravity.title()
    tools = "all tools" if request.tool == ALL else f"tool {request.tool}"
    return f"{request.poses} poses over the workspace, {tools}, gravity of {place}."


def _case(budget: Budget) -> list[str]:
    rules = [(rule, *(format_value(c, budget.estimate(rule, c)) for c in COMPONENTS)) for rule in RULES]
    return [
        heading(budget.name),
        paragraph(budget.case.text),
        figures(
            svg.render_svg(
                f"{budget.name}: shares of the total", 3.9, lambda figure: _draw_shares(figure, budget)
            ),
            svg.render_svg(f"{budget.name}: map of the total", 3.9, lambda figure: _draw_map(figure, budget)),
        ),
        table(("rule", *(name.rsplit("_", 1)[0] for name in COMPONENTS)), rules),
    ]


def save_budget_picture(report: BudgetReport, path: Path) -> str | None:
    """Save the rows beside the paper's and the shares of the sources as PNG.

    Returns:
        The reason why there is no picture, or None.

    Raises:
        BadOutput: The file cannot be written.
    """
    accuracies = [name for name in report.budgets if "repeatability" not in name] or [*report.budgets]

    def draw(figure: Any) -> None:
        figure.suptitle(f"Error budget by the paper's rule. {_poses(report)}")
        rows, *shares = figure.subplots(1, 1 + len(accuracies))
        _draw_rows(rows, report)
        for axes, name in zip(shares, accuracies, strict=True):
            _draw_bars(axes, report.budgets[name])
            axes.set_title(f"Shares of the total, {WHEN[name]}")

    return svg.save_png(path, (4.6 * (1 + len(accuracies)), 4.4), draw)


def _draw_rows(axes: Any, report: BudgetReport) -> None:
    """Draw the rows of positions: required, the paper's, ours."""
    rows = [(row, value) for row, value in report.rows if not row.component.endswith("_rad")]
    at = np.arange(len(rows))
    names = [f"{row.name.replace(' position', '')},\n{WHEN[row.case]}" for row, _ in rows]
    axes.barh(at + 0.2, [1e3 * row.estimated for row, _ in rows], 0.38, color=svg.LIGHT, label="paper")
    axes.barh(at - 0.2, [1e3 * value for _, value in rows], 0.38, color=svg.BLUE, label="ours")
    required = [1e3 * row.required for row, _ in rows]
    axes.plot(required, at, "|", color=svg.RED, markersize=22, markeredgewidth=2.0, label="required")
    axes.set_yticks(at, names)
    axes.invert_yaxis()
    axes.set(title="Tables 3 and 4", xlabel="plus or minus [mm]", xlim=(0, None))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, markerscale=0.5)


def _draw_shares(figure: Any, budget: Budget) -> None:
    _draw_bars(figure.subplots(), budget)


def _draw_bars(bars: Any, budget: Budget) -> None:
    share = budget.share_m * 1e3
    order = np.argsort(share.sum(axis=1))
    names = [name.replace("_", " ") for name in budget.case.sources]
    left = np.zeros(len(names))
    for frame, colour in zip(Frame, FRAME_COLOURS, strict=True):
        bars.barh(
            [names[k] for k in order], share[order, frame], left=left, label=frame.name.lower(), color=colour
        )
        left += share[order, frame]
    bars.set(title="Shares of the total, mean over the poses", xlabel="mm")
    bars.legend(loc="lower right")


def _draw_map(figure: Any, budget: Budget) -> None:
    axes = figure.subplots()
    p = np.concatenate([tool.poses.p_NoTo_N_m for tool in budget.tools.values()], axis=1)
    error = np.concatenate([tool.by_rule["paper"].total_m for tool in budget.tools.values()]) * 1e3
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
