"""Report of a Monte Carlo: JSON document, tables, and a page with errors, coverage and additivity."""

from dataclasses import asdict
from math import degrees, isfinite
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from fsw.dictionary.enums import Joint
from marsarm.accuracy.budget import COMPONENTS, MOMENTS
from marsarm.accuracy.budget_report import RULES, format_value
from marsarm.accuracy.combine import COVERAGE
from marsarm.accuracy.confidence import Interval, describe_sample, is_within, min_sample_size
from marsarm.accuracy.coverage import AdditivityCheck, CoverageReport
from marsarm.accuracy.monte_carlo import MonteCarloReport
from marsarm.accuracy.reproduce import TABLE_3, TABLE_4
from marsarm.accuracy.sources import sources_sha256
from simgap.common import svg
from simgap.common.console import plain_console
from simgap.common.json_digest import json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin, Requirement, figures, heading, paragraph, save_page, table

JOINT_NAMES: Final = tuple(joint.name.lower() for joint in Joint)
RULE_HEAD: Final = ("rule", "", "estimate", "covers", "95 %", "width", "95 %")
ADDITIVITY_HEAD: Final = ("source", "added", "all with one sign", "each by itself")
SIGMA_HEAD: Final = ("three sigma", "of any arm", "at most", "of one arm", "at most")
BINS: Final = 60
REPEATABILITY_OF: Final = {"accuracy": "repeatability", "mars": "mars-repeatability"}
"""Case of the paper's repeatability by that of its accuracy."""
COLOURS: Final = dict(zip(RULES, (svg.RED, svg.GREEN, svg.AMBER, svg.VIOLET), strict=True))


def monte_carlo_json(report: MonteCarloReport) -> dict[str, Any]:
    """Convert the report to a JSON document in SI units.

    An infinite end of an interval, which too few arms leave open, becomes null.
    """
    request, found = report.request, report.coverage
    return {
        "case": request.case,
        "built": request.built,
        "move_model": request.move_model,
        "seed": request.seed,
        "places": request.places,
        "arms": len(report.trials),
        "failed": {str(arm): why for arm, why in report.failed.items()},
        "coverage": None if found is None else _coverage_json(found),
        "three_sigma": None
        if report.three_sigma is None
        else {name: asdict(values) for name, values in report.three_sigma.items()},
        "measured": _measured_json(report) if request.only is not None else None,
    }


def _coverage_json(found: CoverageReport) -> dict[str, Any]:
    return {
        "percentile": dict(found.percentile),
        "percentile_interval": {name: _interval_json(i) for name, i in found.percentile_interval.items()},
        "rules": {
            rule: {
                name: {
                    "coverage": c.share,
                    "coverage_interval": _interval_json(c.share_interval),
                    "width": c.width,
                    "width_interval": _interval_json(c.width_interval),
                    "estimate": found.budget.estimate(rule, name),
                }
                for name, c in by_component.items()
            }
            for rule, by_component in found.by_rule.items()
        },
        "backlash": {
            "on_flank": dict(zip(JOINT_NAMES, found.on_flank.tolist(), strict=True)),
            "mean_side": dict(zip(JOINT_NAMES, found.side.tolist(), strict=True)),
            "shift_over_sum": dict(zip(("median", "p95", "max"), found.backlash, strict=True)),
        },
        "additivity": [asdict(one) for one in found.additivity],
        "variant_totals_m": dict(found.variant_totals_m),
    }


def _measured_json(report: MonteCarloReport) -> list[dict[str, Any]]:
    return [
        {
            "tool": m.tool,
            **{k: getattr(m, k).tolist() for k in ("output_rad", "error", "backlash_position")},
        }
        for trial in report.trials
        for m in trial
    ]


def _interval_json(interval: Interval) -> list[float | None]:
    return [end if isfinite(end) else None for end in interval]


def monte_carlo_table(report: MonteCarloReport) -> None:
    """Print coverage and width of every rule, additivity, and three sigma."""
    console = plain_console()
    found = report.coverage
    if found is not None:
        console.print(_rules(report, found))
        console.print(_additivity_table(found))
        console.print(backlash_sentence(found))
        console.print(additivity_sentence(found))
    if report.three_sigma is not None:
        console.print(_three_sigma(report))
    _print_rest(console, report)


def _print_rest(console: Console, report: MonteCarloReport) -> None:
    """Print failed arms and the paths of the files."""
    for arm, why in report.failed.items():
        console.print(f"arm {arm}: {why}")
    for what, path in (("results", report.request.results), ("report", report.request.report)):
        if path is not None:
            console.print(f"{what}  {path}")


def rule_rows(found: CoverageReport) -> list[tuple[str, ...]]:
    """Build rows of rule, component, estimate, coverage with its interval, and width with its interval."""
    rows: list[tuple[str, ...]] = []
    for rule in RULES:
        for name in COMPONENTS:
            c = found.by_rule[rule][name]
            low, high = c.share_interval
            rows.append(
                (
                    rule,
                    name.rsplit("_", 1)[0],
                    format_value(name, found.budget.estimate(rule, name)),
                    f"{100 * c.share:.2f} %",
                    f"{100 * low:.2f} .. {100 * high:.2f} %",
                    f"{c.width:.2f}",
                    f"{c.width_interval[0]:.2f} .. {c.width_interval[1]:.2f}",
                )
            )
    return rows


def percentile_sentence(found: CoverageReport) -> str:
    """Describe the error lengths that 99.73 % of the errors do not exceed."""
    values = ", ".join(
        f"{name.rsplit('_', 1)[0]} {format_value(name, found.percentile[name])}" for name in COMPONENTS
    )
    enough = min_sample_size(COVERAGE)
    if found.arms >= enough:
        return f"{100 * COVERAGE:.2f} % of the errors stay within {values}."
    return f"The errors of these arms stay within {values}; what 99.73 % of all do needs {enough} arms."


def _rules(report: MonteCarloReport, found: CoverageReport) -> Table:
    request = report.request
    arms = f"{found.arms} arms, {request.built}, {request.move_model}"
    title = f"{request.case}: {arms}. {percentile_sentence(found)}"
    table = Table(title=title, title_justify="left")
    for k, name in enumerate(RULE_HEAD):
        table.add_column(name, justify="left" if k < 2 else "right")
    for row in rule_rows(found):
        table.add_row(*row)
    return table


def additivity_row(one: AdditivityCheck) -> tuple[str, ...]:
    """Build the row of a source that equation 13 adds, in millimetres."""
    return one.source, *(f"{1e3 * v:.2f} mm" for v in (one.added_m, one.same_sign_m, one.independent_m))


def _additivity_table(found: CoverageReport) -> Table:
    table = Table(title="Bounds of the sources that equation 13 adds", title_justify="left")
    for name in ADDITIVITY_HEAD:
        table.add_column(name, justify="left" if name == "source" else "right")
    for one in found.additivity:
        table.add_row(*additivity_row(one))
    return table


def backlash_sentence(found: CoverageReport) -> str:
    """Describe the positions of outputs in their backlash and the resulting tool motion."""
    flank = ", ".join(f"{100 * share:.1f}" for share in found.on_flank)
    side = ", ".join(f"{value:+.2f}" for value in found.side)
    median, often, most = found.backlash
    return (
        f"Outputs lie on a flank of their backlash in {flank} % of the moves (J1 to J5), at the mean "
        f"position {side}. At the tool, backlash makes {100 * median:.0f} % of the sum over joints "
        f"(median; 95 % stay within {100 * often:.0f} %, most {100 * most:.0f} %)."
    )


def additivity_sentence(found: CoverageReport) -> str:
    """Describe the effect of the additions on the total by the paper's rule."""
    values = "; ".join(f"{name} {1e3 * value:.1f} mm" for name, value in found.variant_totals_m.items())
    return f"Total by the rule and with less of it added: {values}."


def sigma_rows(report: MonteCarloReport) -> list[tuple[str, ...]]:
    """Build the rows of accuracy and repeatability with their upper bounds."""
    rows = []
    for name, values in (report.three_sigma or {}).items():
        both = (values.accuracy, values.repeatability)
        shown_values = (format_value(name, v) for one in both for v in (one.estimate, one.upper))
        rows.append((name.rsplit("_", 1)[0], *shown_values))
    return rows


def _sample(report: MonteCarloReport) -> str:
    return f"{len(report.trials)} arms, {report.request.places} places each"


def _three_sigma(report: MonteCarloReport) -> Table:
    title = f"Three sigma, and its upper bound with 95 % confidence: {_sample(report)}"
    table = Table(title=title, title_justify="left")
    for name in SIGMA_HEAD:
        table.add_column(name, justify="left" if name == "three sigma" else "right")
    for row in sigma_rows(report):
        table.add_row(*row)
    return table


def one_arm_table(report: MonteCarloReport) -> None:
    """Print the errors of one arm at each placement."""
    title = f"{report.request.case}: arm {report.request.only}, in tool axes"
    table = Table(title=title, title_justify="left")
    for name in ("tool", "x mm", "y mm", "z mm", "about y deg", "about z deg"):
        table.add_column(name, justify="left" if name == "tool" else "right")
    for m in (m for trial in report.trials for m in trial):
        shift, turn = (f"{1e3 * v:+.2f}" for v in m.error[3:]), (f"{degrees(v):+.3f}" for v in m.error[1:3])
        table.add_row(m.tool, *shift, *turn)
    console = plain_console()
    console.print(table)
    _print_rest(console, report)


def list_requirements(report: MonteCarloReport) -> list[Requirement]:
    """List the requirements that this result decides: of the paper, of the budget, and that arms move.

    With several places of each arm, accuracy and repeatability are upper bounds of three sigma with 95 %
    confidence; else accuracy is the length that 99.73 % of the errors do not exceed. A sample that is too
    small for a bound decides nothing.
    """
    trials, count = len(report.trials), len(report.trials) + len(report.failed)
    found = [Requirement("every arm completes its moves", f"{count} arms", f"{trials}", trials == count)]
    if report.coverage is None:
        return found
    sample = f"{trials} arms" if report.three_sigma else describe_sample(trials, "arms", COVERAGE)
    for row in (*TABLE_3, *TABLE_4):
        is_same_day = row.case == REPEATABILITY_OF.get(report.request.case)
        if report.three_sigma is not None and (row.case == report.request.case or is_same_day):
            measured = report.three_sigma[row.component]
            value = (measured.repeatability if is_same_day else measured.accuracy).upper
            what = "three sigma, upper bound with 95 % confidence"
            passed: bool | None = value <= row.required
        elif row.case == report.request.case:
            value = report.coverage.percentile[row.component]
            what = f"not exceeded by {100 * COVERAGE:.2f} % of errors"
            passed = is_within(report.coverage.percentile_interval[row.component], row.required)
        else:
            continue
        bound, shown = (f"± {format_value(row.component, v)}" for v in (row.required, value))
        found.append(Requirement(f"{row.name}, {what}", bound, f"{shown}, {sample}", passed))
    covered = report.coverage.by_rule[MOMENTS]
    least = min(covered[name].share for name in COMPONENTS)
    holds: bool | None = all(covered[name].holds(COVERAGE) for name in COMPONENTS)
    shown = f"{100 * least:.2f} %, {trials} arms"
    if holds and trials < min_sample_size(COVERAGE):
        holds = None  # so few arms refute a rule, but do not confirm it
        shown = f"{100 * least:.2f} %, {describe_sample(trials, 'arms', COVERAGE)}"
    text = "the budget, by moments, covers the errors"
    return [*found, Requirement(text, f"{100 * COVERAGE:.2f} %", shown, holds)]


def save_monte_carlo_page(report: MonteCarloReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: The file cannot be written.
    """
    request, found = report.request, report.coverage
    parts = [
        paragraph(
            f"Case {request.case}: {len(report.trials)} arms, {request.built}, {request.places} places each, "
            f"{request.move_model}, seed {request.seed}; {len(report.failed)} arms failed."
        )
    ]
    if found is not None:
        parts += [
            paragraph(percentile_sentence(found)),
            figures(*(_histogram(found, name) for name in COMPONENTS)),
            paragraph(
                "Width: the bound of a rule, pose by pose, over what 99.73 % of errors stay within there. "
                "The 95 % intervals count arms."
            ),
            table(RULE_HEAD, rule_rows(found)),
            heading("Additivity in equation 13"),
            table(ADDITIVITY_HEAD, [additivity_row(one) for one in found.additivity]),
            paragraph(backlash_sentence(found)),
            paragraph(additivity_sentence(found)),
        ]
    if report.three_sigma is not None:
        name = f"Accuracy and repeatability: {_sample(report)}"
        parts += [heading(name), table(SIGMA_HEAD, sigma_rows(report))]
    digests = {
        "parameters": report.params_sha256,
        "sources of error": sources_sha256(),
        "result": json_sha256(monte_carlo_json(report)),
    }
    origin = Origin(command_text("monte-carlo", request), digests)
    title = "The error budget against a Monte Carlo"
    save_page(title, "", list_requirements(report), origin, parts, path)


def _histogram(found: CoverageReport, name: str) -> str:
    """Draw the errors of a component, with the bounds of all rules."""
    short = name.rsplit("_", 1)[0]
    return svg.render_svg(f"{short}: errors and bounds", 3.2, lambda figure: _draw(figure, found, name))


def _draw(figure: Any, found: CoverageReport, name: str) -> None:
    from matplotlib.ticker import NullFormatter

    axes = figure.subplots()
    scale, unit = (np.degrees(1.0), "deg") if name.endswith("_rad") else (1e3, "mm")
    estimates = {rule: scale * found.budget.estimate(rule, name) for rule in RULES}
    error = scale * found.error[name]
    top = 1.05 * max(*estimates.values(), error.max())
    axes.hist(error, np.linspace(0.0, top, BINS), color=svg.LIGHT, log=True)
    within = scale * found.percentile[name]
    axes.axvline(within, color=svg.INK, linestyle=":", zorder=5, label="99.73 % of the errors")
    for rule, value in estimates.items():
        axes.axvline(value, color=COLOURS[rule], label=rule)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set(title=name.rsplit("_", 1)[0], xlabel=unit, xlim=(0, top), ylabel="moves", ylim=(0.7, None))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
