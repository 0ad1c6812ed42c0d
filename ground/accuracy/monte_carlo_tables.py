"""The Monte Carlo as tables for people and as a document for programs."""

from dataclasses import asdict
from math import degrees, isfinite
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from fsw.dictionary.enums import Joint
from ground.accuracy.at_limit import AtLimit
from ground.accuracy.budget import COMPONENTS, COVERAGE
from ground.accuracy.budget_tables import RULES, shown
from ground.accuracy.coverage import Interval, enough_for
from ground.accuracy.judged import Judged
from ground.accuracy.monte_carlo_request import MonteCarloReport
from ground.render.console import plain_console

JOINTS: Final = tuple(joint.name.lower() for joint in Joint)


def monte_carlo_json(report: MonteCarloReport) -> dict[str, Any]:
    """SI units; null is an end of an interval that so few arms do not tell."""
    asked, found = report.request, report.judged
    return {
        "case": asked.case,
        "built": asked.built,
        "how": asked.how,
        "seed": asked.seed,
        "places": asked.places,
        "arms": len(report.trials),
        "failed": {str(arm): why for arm, why in report.failed.items()},
        "judged": None if found is None else _judged_json(found),
        "three_sigma": None
        if report.spreads is None
        else {name: asdict(values) for name, values in report.spreads.items()},
        "measured": _measured_json(report) if asked.only is not None else None,
    }


def _judged_json(found: Judged) -> dict[str, Any]:
    return {
        "percentile": dict(found.percentile),
        "percentile_interval": {name: _ends(i) for name, i in found.percentile_interval.items()},
        "rules": {
            rule: {
                name: {
                    "coverage": c.share,
                    "coverage_interval": _ends(c.share_interval),
                    "width": c.width,
                    "width_interval": _ends(c.width_interval),
                    "estimate": found.budget.estimate(rule, name),
                }
                for name, c in by_component.items()
            }
            for rule, by_component in found.coverage.items()
        },
        "gap": {
            "on_flank": dict(zip(JOINTS, found.on_flank.tolist(), strict=True)),
            "mean_side": dict(zip(JOINTS, found.side.tolist(), strict=True)),
            "shift_over_sum": dict(zip(("median", "p95", "most"), found.backlash, strict=True)),
        },
        "at_limit": [asdict(one) for one in found.at_limit],
        "without_adding_m": dict(found.without_adding_m),
    }


def _measured_json(report: MonteCarloReport) -> list[dict[str, Any]]:
    return [
        {"tool": m.tool.name.lower(), **{k: getattr(m, k).tolist() for k in ("output_rad", "error", "gap")}}
        for trial in report.trials
        for m in trial
    ]


def _ends(interval: Interval) -> list[float | None]:
    return [end if isfinite(end) else None for end in interval]


def monte_carlo_table(report: MonteCarloReport) -> None:
    """Print coverage and width of every rule, what equation 13 takes for granted, and three sigma."""
    console = plain_console()
    found = report.judged
    if found is not None:
        console.print(_rules(report, found))
        console.print(_at_limit(found))
        console.print(gap_sentence(found))
        console.print(adding_sentence(found))
    if report.spreads is not None:
        console.print(_three_sigma(report))
    _print_rest(console, report)


def _print_rest(console: Console, report: MonteCarloReport) -> None:
    """What did not come to its end, and where the files are."""
    for arm, why in report.failed.items():
        console.print(f"arm {arm}: {why}")
    for what, path in (("results", report.request.results), ("report", report.request.report)):
        if path is not None:
            console.print(f"{what}  {path}")


def rule_rows(found: Judged) -> list[tuple[str, ...]]:
    """Rule, component, what it says, coverage with its interval, and its width with that."""
    rows: list[tuple[str, ...]] = []
    for rule in RULES:
        for name in COMPONENTS:
            c = found.coverage[rule][name]
            low, high = c.share_interval
            rows.append(
                (
                    rule,
                    name.rsplit("_", 1)[0],
                    shown(name, found.budget.estimate(rule, name)),
                    f"{100 * c.share:.2f} %",
                    f"{100 * low:.2f} .. {100 * high:.2f} %",
                    f"{c.width:.2f}",
                    f"{c.width_interval[0]:.2f} .. {c.width_interval[1]:.2f}",
                )
            )
    return rows


RULE_HEAD: Final = ("rule", "", "estimate", "covers", "95 %", "width", "95 %")


def percentiles(found: Judged) -> str:
    """A sentence."""
    values = ", ".join(
        f"{name.rsplit('_', 1)[0]} {shown(name, found.percentile[name])}" for name in COMPONENTS
    )
    said = f"{100 * COVERAGE:.2f} % of the errors stay within {values}."
    if found.arms >= enough_for(COVERAGE):
        return said
    return f"{said} So few arms cannot be sure of it; {enough_for(COVERAGE)} can."


def _rules(report: MonteCarloReport, found: Judged) -> Table:
    asked = report.request
    title = f"{asked.case}: {found.arms} arms, {asked.built}, {asked.how}. {percentiles(found)}"
    table = Table(title=title, title_justify="left")
    for k, name in enumerate(RULE_HEAD):
        table.add_column(name, justify="left" if k < 2 else "right")
    for row in rule_rows(found):
        table.add_row(*row)
    return table


LIMIT_HEAD: Final = ("source", "added", "all with one sign", "each by itself")


def limit_row(one: AtLimit) -> tuple[str, ...]:
    """Of a source that equation 13 adds, in millimetres."""
    return one.source, *(f"{1e3 * v:.2f} mm" for v in (one.added_m, one.together_m, one.independent_m))


def _at_limit(found: Judged) -> Table:
    table = Table(title="What equation 13 adds, and what the source does by itself", title_justify="left")
    for name in LIMIT_HEAD:
        table.add_column(name, justify="left" if name == "source" else "right")
    for one in found.at_limit:
        table.add_row(*limit_row(one))
    return table


def gap_sentence(found: Judged) -> str:
    """Where outputs were found in their gaps, and what that does to the tool."""
    flank = ", ".join(f"{100 * share:.1f}" for share in found.on_flank)
    side = ", ".join(f"{value:+.2f}" for value in found.side)
    median, often, most = found.backlash
    return (
        f"Outputs lie on a flank of their gap in {flank} % of the moves (J1 to J5), on the mean on the side "
        f"{side}. At the tool the five gaps make {100 * median:.0f} % of their sum (median; 95 % stay "
        f"within {100 * often:.0f} %, most {100 * most:.0f} %)."
    )


def adding_sentence(found: Judged) -> str:
    """What of the paper's rule makes it wide."""
    values = "; ".join(f"{name} {1e3 * value:.1f} mm" for name, value in found.without_adding_m.items())
    return f"Total by the rule and with less of it added: {values}."


SIGMA_HEAD: Final = ("three sigma", "of any arm", "at most", "of one arm", "at most")


def sigma_rows(report: MonteCarloReport) -> list[tuple[str, ...]]:
    """Accuracy and repeatability with their upper bounds."""
    rows = []
    for name, values in (report.spreads or {}).items():
        both = (values.accuracy, values.repeatability)
        shown_values = (shown(name, v) for one in both for v in (one.estimate, one.upper))
        rows.append((name.rsplit("_", 1)[0], *shown_values))
    return rows


def _three_sigma(report: MonteCarloReport) -> Table:
    table = Table(title="Three sigma, and its upper bound with 95 % confidence", title_justify="left")
    for name in SIGMA_HEAD:
        table.add_column(name, justify="left" if name == "three sigma" else "right")
    for row in sigma_rows(report):
        table.add_row(*row)
    return table


def only_table(report: MonteCarloReport) -> None:
    """Print the errors of one arm, place by place."""
    title = f"{report.request.case}: arm {report.request.only}, in tool axes"
    table = Table(title=title, title_justify="left")
    for name in ("tool", "x mm", "y mm", "z mm", "about y deg", "about z deg"):
        table.add_column(name, justify="left" if name == "tool" else "right")
    for m in (m for trial in report.trials for m in trial):
        shift, turn = (f"{1e3 * v:+.2f}" for v in m.error[3:]), (f"{degrees(v):+.3f}" for v in m.error[1:3])
        table.add_row(m.tool.name.lower(), *shift, *turn)
    console = plain_console()
    console.print(table)
    _print_rest(console, report)
