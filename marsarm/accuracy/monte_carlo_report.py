"""Report of a Monte Carlo: errors and coverage of the budget."""

from functools import partial
from typing import Any, Final

import numpy as np

from marsarm.accuracy.budget import COMPONENTS, MOMENTS, TABLE_3, TABLE_4
from marsarm.accuracy.budget_report import RULES, format_value, make_origin, short_name
from marsarm.accuracy.monte_carlo import CoverageReport, MonteCarloReport
from marsarm.accuracy.propagation import COVERAGE
from marsarm.common.rates import describe_sample, is_within, min_sample_size
from marsarm.render import svg
from marsarm.render.svg import ReportFigure
from simgap.common.page import Requirement
from simgap.common.report import Heading, ReportPage, ReportTable, file_lines, to_json

BINS: Final = 60
REPEATABILITY_OF: Final = {"accuracy": "repeatability", "mars": "mars-repeatability"}
"""Case of the paper's repeatability by that of its accuracy."""
COLOURS: Final = dict(zip(RULES, (svg.RED, svg.GREEN, svg.AMBER, svg.VIOLET), strict=True))


def monte_carlo_document(report: MonteCarloReport) -> dict[str, Any]:
    """Collect the result in SI units."""
    request, found = report.request, report.coverage
    return {
        "case": request.case,
        "built": request.built,
        "move_model": request.move_model,
        "seed": request.seed,
        "places": request.places,
        "arms": len(report.trials),
        "failed": report.failed,
        "coverage": None if found is None else _coverage_document(found),
        "three_sigma": report.three_sigma,
    }


def _coverage_document(found: CoverageReport) -> dict[str, Any]:
    return {
        "percentile": found.percentile,
        "percentile_interval": found.percentile_interval,
        "rules": {
            rule: {
                name: {**to_json(one), "estimate": found.budget.estimate(rule, name)}
                for name, one in by_component.items()
            }
            for rule, by_component in found.by_rule.items()
        },
    }


def monte_carlo_parts(report: MonteCarloReport) -> list[str | ReportTable]:
    """Show coverage and width of every rule, three sigma, failed arms and files."""
    request, found = report.request, report.coverage
    parts: list[str | ReportTable] = []
    if found is not None:
        parts.append(_coverage_table(report, found))
    if report.three_sigma is not None:
        parts.append(_three_sigma_table(report))
    parts += [f"arm {arm}: {why}" for arm, why in report.failed.items()]
    return [*parts, *file_lines({"results": request.results, "report": request.report})]


def _coverage_table(report: MonteCarloReport, found: CoverageReport) -> ReportTable:
    rows = []
    for rule in RULES:
        for name in COMPONENTS:
            one = found.by_rule[rule][name]
            low, high = one.share_interval
            rows.append(
                (
                    rule,
                    short_name(name),
                    format_value(name, found.budget.estimate(rule, name)),
                    f"{100 * one.share:.2f} %",
                    f"{100 * low:.2f} .. {100 * high:.2f} %",
                    f"{one.width:.2f}",
                    f"{one.width_interval[0]:.2f} .. {one.width_interval[1]:.2f}",
                )
            )
    request = report.request
    arms = f"{found.arms} arms, {request.built}, {request.move_model}"
    title = f"{request.case}: {arms}. {_percentile_sentence(found)}"
    return ReportTable(("rule", "", "estimate", "covers", "95 %", "width", "95 %"), rows, title)


def _percentile_sentence(found: CoverageReport) -> str:
    """Describe the error lengths that 99.73 % of the errors do not exceed."""
    values = ", ".join(
        f"{short_name(name)} {format_value(name, found.percentile[name])}" for name in COMPONENTS
    )
    enough = min_sample_size(COVERAGE)
    if found.arms >= enough:
        return f"{100 * COVERAGE:.2f} % of the errors stay within {values}."
    return f"The errors of these arms stay within {values}; what 99.73 % of all do needs {enough} arms."


def _three_sigma_table(report: MonteCarloReport) -> ReportTable:
    rows = []
    for name, values in (report.three_sigma or {}).items():
        both = (values.accuracy, values.repeatability)
        shown = (format_value(name, v) for one in both for v in (one.estimate, one.upper))
        rows.append((short_name(name), *shown))
    title = f"Three sigma, and its upper bound with 95 % confidence: {_sample(report)}"
    return ReportTable(("three sigma", "of any arm", "at most", "of one arm", "at most"), rows, title)


def _sample(report: MonteCarloReport) -> str:
    return f"{len(report.trials)} arms, {report.request.places} places each"


def monte_carlo_requirements(report: MonteCarloReport) -> list[Requirement]:
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


def monte_carlo_page(report: MonteCarloReport) -> ReportPage:
    """Show errors with the bounds of the budget, coverage and three sigma."""
    request, found = report.request, report.coverage
    parts: list[str | Heading | ReportTable | tuple[ReportFigure, ...]] = [
        f"Case {request.case}: {len(report.trials)} arms, {request.built}, {request.places} places each, "
        f"{request.move_model}, seed {request.seed}; {len(report.failed)} arms failed."
    ]
    if found is not None:
        drawn = [
            ReportFigure(
                f"{short_name(name)}: errors and bounds", 3.2, partial(_draw_errors, found=found, name=name)
            )
            for name in COMPONENTS
        ]
        parts += [
            _percentile_sentence(found),
            tuple(drawn),
            "Width: the bound of a rule, pose by pose, over what 99.73 % of errors stay within there. "
            "The 95 % intervals count arms.",
            _coverage_table(report, found),
        ]
    if report.three_sigma is not None:
        parts += [Heading(f"Accuracy and repeatability: {_sample(report)}"), _three_sigma_table(report)]
    origin = make_origin("monte-carlo", request, report.params_sha256, monte_carlo_document(report))
    title = "The error budget against a Monte Carlo"
    return ReportPage(title, monte_carlo_requirements(report), origin, parts)


def _draw_errors(figure: Any, found: CoverageReport, name: str) -> None:
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
    axes.set(title=short_name(name), xlabel=unit, xlim=(0, top), ylabel="moves", ylim=(0.7, None))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
