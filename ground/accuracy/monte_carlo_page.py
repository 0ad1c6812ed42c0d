"""The Monte Carlo as a page: errors against bounds, coverage, and what equation 13 takes for granted."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from ground.accuracy.budget import COMPONENTS
from ground.accuracy.budget_tables import RULES
from ground.accuracy.judged import Judged
from ground.accuracy.monte_carlo_request import MonteCarloReport
from ground.accuracy.monte_carlo_tables import (
    LIMIT_HEAD,
    RULE_HEAD,
    SIGMA_HEAD,
    adding_sentence,
    gap_sentence,
    limit_row,
    percentiles,
    rule_rows,
    sigma_rows,
)
from ground.render.figures import drawn
from ground.render.page import heading, image, paragraph, save_page, table

BINS: Final = 60
COLOURS: Final = dict(zip(RULES, ("#c1121f", "#2a9d4b", "#e09f3e", "#6a4c93"), strict=True))


def save_monte_carlo_page(report: MonteCarloReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: the file cannot be written.
    """
    asked, found = report.request, report.judged
    parts = [
        paragraph(
            f"Case {asked.case}: {len(report.trials)} arms, {asked.built}, {asked.places} places each, "
            f"{asked.how}, seed {asked.seed}; {len(report.failed)} arms did not come to their places."
        )
    ]
    if found is not None:
        picture = drawn((11, 7), 110, lambda figure: _draw(figure, found))
        parts += [
            paragraph(percentiles(found)),
            image(picture, "errors and bounds"),
            paragraph(
                "Width: the bound of a rule, pose by pose, over what 99.73 % of errors stay within there. "
                "The 95 % intervals count arms."
            ),
            table(RULE_HEAD, rule_rows(found)),
            heading("What equation 13 takes for granted"),
            table(LIMIT_HEAD, [limit_row(one) for one in found.at_limit]),
            paragraph(gap_sentence(found)),
            paragraph(adding_sentence(found)),
        ]
    if report.spreads is not None:
        parts += [heading("Between arms and within them"), table(SIGMA_HEAD, sigma_rows(report))]
    save_page("The error budget against a Monte Carlo", parts, path)


def _draw(figure: Any, found: Judged) -> None:
    for axes, name in zip(figure.subplots(2, 2).ravel(), COMPONENTS, strict=True):
        scale, unit = (np.degrees(1.0), "deg") if name.endswith("_rad") else (1e3, "mm")
        estimates = {rule: scale * found.budget.estimate(rule, name) for rule in RULES}
        error = scale * found.error[name]
        top = 1.05 * max(*estimates.values(), error.max())
        axes.hist(error, np.linspace(0.0, top, BINS), color="#8fb3d9", log=True)
        within = scale * found.percentile[name]
        axes.axvline(within, color="black", linestyle=":", zorder=5, label="99.73 % of the errors")
        for rule, value in estimates.items():
            axes.axvline(value, color=COLOURS[rule], label=rule)
        axes.set(title=name.rsplit("_", 1)[0], xlabel=unit, xlim=(0, top), ylabel="moves", ylim=(0.7, None))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=9)
