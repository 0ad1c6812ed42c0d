"""The error budget as tables for people and as a document for programs."""

from math import degrees
from typing import Any, Final

from rich.table import Table

from fsw.dictionary.enums import Frame
from ground.accuracy.budget import COMPONENTS, Budget
from ground.accuracy.budget_request import BudgetReport
from ground.accuracy.reproduce import Reproduced
from ground.render.console import plain_console

RULES: Final = ("paper", "moments", "root sum square", "worst case")


def budget_json(report: BudgetReport) -> dict[str, Any]:
    """The budget as a JSON document; metres and radians."""
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
                "spread": source.spread,
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
        "tools": [tool.name.lower() for tool in budget.tools],
        "estimates": {
            rule: {component: budget.estimate(rule, component) for component in COMPONENTS} for rule in RULES
        },
        "share_m": {
            name: dict(zip((frame.name.lower() for frame in Frame), share.tolist(), strict=True))
            for name, share in zip(budget.case.sources, budget.share_m, strict=True)
        },
    }


def _reproduced_json(found: Reproduced) -> dict[str, Any]:
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


def shown(component: str, value: float) -> str:
    """As people read it."""
    return f"{degrees(value):.2f} deg" if component.endswith("_rad") else f"{value * 1e3:.1f} mm"


def budget_table(report: BudgetReport) -> None:
    """Print the paper's rows beside ours, what makes up the error, and other rules."""
    console = plain_console()
    console.print(_rows(report))
    for budget in report.budgets.values():
        console.print(_shares(report, budget))
        console.print(_rules(budget))
    for found in report.reproduced:
        console.print(_reproduced(found))
    if report.request.report is not None:
        console.print(f"report  {report.request.report}")


def _rows(report: BudgetReport) -> Table:
    asked = report.request
    title = f"Error budget by the paper's rule, {asked.poses} poses, tool {asked.tool}"
    table = Table(title=title, title_justify="left")
    for name in ("", "case", "required", "paper", "ours"):
        table.add_column(name, justify="left" if name in ("", "case") else "right")
    for row, value in report.rows:
        limits = (shown(row.component, v) for v in (row.required, row.estimated, value))
        table.add_row(row.name, row.case, *limits)
    return table


def _shares(report: BudgetReport, budget: Budget) -> Table:
    table = Table(title=f"{budget.name}: what makes up the total [mm]", title_justify="left")
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
        table.add_row(rule, *(shown(c, budget.estimate(rule, c)) for c in COMPONENTS))
    return table


def _reproduced(found: Reproduced) -> Table:
    table = Table(title="Magnitudes that would make it the paper's", title_justify="left")
    for name in ("source", "part", "magnitude", "times ours"):
        table.add_column(name, justify="right" if name in ("magnitude", "times ours") else "left")
    for (source, part), factor in found.factor.items():
        value, unit = found.magnitude[source, part]
        table.add_row(source, part, f"{value:.3f} {unit}", f"{factor:.2f}")
    for row, value in found.rows:
        table.add_row(row.name, row.case, shown(row.component, value), f"{value / row.estimated:.2f}")
    return table
