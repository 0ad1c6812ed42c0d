"""HTML page of a diagnosis: four lines, residual map, effects, closure, lack of fit, next motion."""

from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Final

import numpy as np

from marsarm.diagnosis.closure import Closure
from marsarm.diagnosis.diagnose import Finding
from marsarm.diagnosis.figures import amplitude_figure, closure_figure, residual_map_figure
from marsarm.diagnosis.result import MAX_LISTED, DiagnosisResult
from marsarm.diagnosis.sentences import (
    channel_words,
    closure_sentence,
    finding_sentence,
    format_cell_interval,
    format_number,
    format_percent,
    format_quantity,
    format_value_interval,
    next_sentence,
    unexplained_sentence,
    verdict_lines,
)
from simgap import Trace, choose_traces
from simgap.common.page import Origin, Requirement, figures, heading, paragraph, save_page, table
from simgap.report.page import draw_traces, figure_style

TITLES: Final = {
    "size": "The gap has a name",
    "effect": "The gap has one of several names",
    "family": "The gap has a family",
    "place": "The gap has a place",
    "unlocated": "The gap is not located",
}
"""Title by the coarsest level of the findings."""
MAX_FIGURES: Final = 3
"""Number of interactive figures of channels."""
Rows = list[tuple[str, ...]]


def save_diagnosis_page(result: DiagnosisResult, origin: Origin, path: Path) -> None:
    """Write the page.

    Args:
        origin: Command and digests.
        path: The HTML file.

    Raises:
        BadOutput: The file cannot be written.
    """
    parts = [
        *_residual_section(result),
        *_effect_section(result),
        *_closure_section(result),
        *_lack_of_fit_section(result),
        *_next_section(result),
    ]
    summary = "\n".join(f"{label}: {text}" for label, text in verdict_lines(result))
    save_page(_title(result), summary, list_requirements(result), origin, parts, path)


def _title(result: DiagnosisResult) -> str:
    levels = {one.level for one in result.diagnosis.findings}
    if not levels:
        return "The gap is not in the catalogue" if result.diagnosis.has_remainder else "No effect is seen"
    return next(title for level, title in reversed(TITLES.items()) if level in levels)


def list_requirements(result: DiagnosisResult) -> list[Requirement]:
    """List the conditions of a verdict that names a cause, or says that there is none."""
    diagnosis = result.diagnosis
    named = all(one.level == "size" for one in diagnosis.findings)
    rows = [
        Requirement(
            "every cause is one effect with its size, or no effect is seen",
            "size or none",
            ", ".join(one.level for one in diagnosis.findings) or diagnosis.verdict,
            named if diagnosis.findings else diagnosis.verdict == "none",
        ),
        Requirement(
            "the residual has no structure, -log10 p",
            f"below {format_number(result.model.lack_of_fit_limit)}",
            format_number(diagnosis.unexplained[0].neg_log10_p),
            not diagnosis.has_remainder,
        ),
    ]
    if result.closure is None:
        rows.append(Requirement("the gap shrinks on held-out motion", "", "nothing was held out", None))
    return rows


def _residual_section(result: DiagnosisResult) -> Iterator[str]:
    cells = result.diagnosis.residual_map
    yield heading("Where the gap is")
    yield paragraph(
        "Root mean square of measured less simulated, over the noise floor between repeats: 1 means only "
        "noise. No effect is on; the nuisance parameters are those that fit beside the effects found."
    )
    yield figures(residual_map_figure(cells))
    rows = [
        (channel_words(one.channel, one.place), one.regime, str(one.features), f"{one.ratio:.2f}",
         format_cell_interval(one))
        for one in cells[:MAX_LISTED]
    ]  # fmt: skip
    yield paragraph("The largest:")
    yield table(("channel", "regime", "features", "over the floor", "90 %"), rows)
    if result.traces:
        yield paragraph(
            "Below are the channels that the findings bring closest to the measurement, or without findings "
            "those with the largest residuals: of each the fitted sessions with the "
            "largest, middle and smallest error with the findings. Each point is the mean of a quarter of a "
            "second in motion; rests are left out."
        )
        yield figure_style()
        yield from draw_traces(choose_channels(result))


def choose_channels(result: DiagnosisResult) -> dict[str, tuple[Trace, ...]]:
    """Choose the traces of the channels in motion that the findings bring closest, by channel.

    Without findings, those with the largest residuals are chosen.
    """
    chosen = {channel: own for (channel, _), own in choose_traces(result.traces).items()}
    largest = dict.fromkeys(cell.channel for cell in result.diagnosis.residual_map if cell.channel in chosen)
    nearest = sorted(largest, key=lambda channel: _error_ratio(chosen[channel]))
    return {channel: chosen[channel] for channel in nearest[:MAX_FIGURES]}


def _error_ratio(traces: Sequence[Trace]) -> float:
    """Return the squared error with the findings over that without."""
    after, before = (
        sum(float(np.sum((one.measured - predicted(one)) ** 2)) for one in traces)
        for predicted in (attrgetter("explained"), attrgetter("nominal"))
    )
    return after / max(before, float(np.finfo(float).tiny))


def _effect_section(result: DiagnosisResult) -> Iterator[str]:
    findings = result.diagnosis.findings
    yield heading("Which effect")
    for finding in findings:
        yield paragraph(finding_sentence(result, finding))
    if findings:
        yield figures(amplitude_figure(result))
        head = ("effect", "level", "parameter", "value", "90 %", "bounds", "seen from", "named from", "share")
        yield table(head, [row for finding in findings for row in _finding_rows(result, finding)])
        yield paragraph(
            "An effect is seen, alone and with 90 % power, from the first size on, and in the "
            "selection from all effects from the second on."
        )
    for finding in findings:
        if rest := finding.alternatives[1:]:
            named = ", ".join(f"{result.hypothesis(one.hypothesis).name} (p {one.p:.2f})" for one in rest)
            own = result.hypothesis(finding.hypothesis).name
            yield paragraph(f"Not excluded at 95 % in place of {own}: {named}.")


def _finding_rows(result: DiagnosisResult, finding: Finding) -> Rows:
    hypothesis, limit = result.hypothesis(finding.hypothesis), result.model.limits[finding.hypothesis]
    numbers = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
    return [
        (
            hypothesis.name,
            finding.level,
            parameter.name,
            format_quantity(value, parameter.unit),
            format_value_interval(least, most, parameter.unit),
            format_value_interval(parameter.least, parameter.most, parameter.unit),
            format_quantity(abs(limit.limit * parameter.typical), parameter.unit),
            format_quantity(abs(limit.family_wise_limit * parameter.typical), parameter.unit),
            format_percent(finding.share),
        )
        for parameter, value, least, most in numbers
    ]


def _closure_section(result: DiagnosisResult) -> Iterator[str]:
    found, tool = result.closure, result.tool
    yield heading("How far the gap shrinks")
    yield paragraph(closure_sentence(result))
    if found is not None and result.diagnosis.findings:
        yield figures(closure_figure(found))
        yield table(("on held-out motion", "before", "after", "floor"), _closure_rows(found))
    if tool is not None and result.diagnosis.findings:
        rows = [("tool", *(f"{mm:.3g} mm" for mm in (tool.before_mm, tool.after_mm, tool.noise_floor_mm)))]
        yield table(("at the tool", "before", "after", "floor"), rows)


def _closure_rows(found: Closure) -> Rows:
    rows: Rows = [
        (
            one.channel,
            *(format_quantity(value, one.unit) for value in (one.before, one.after, one.noise_floor)),
        )
        for one in found.channels
    ]
    return [
        *rows,
        ("what can be explained, over noise", format_number(found.before), format_number(found.after), "1"),
    ]


def _lack_of_fit_section(result: DiagnosisResult) -> Iterator[str]:
    yield heading("What is still unexplained")
    yield paragraph(unexplained_sentence(result))
    if result.diagnosis.has_remainder:
        rows = [
            (
                channel_words(one.channel, one.place),
                one.regime,
                one.depends_on,
                format_number(one.neg_log10_p),
            )
            for one in result.diagnosis.unexplained[:MAX_LISTED]
        ]
        yield table(("channel", "regime", "depends on", "-log10 p"), rows)
    yield paragraph("p is the probability of as much without structure.")


def _next_section(result: DiagnosisResult) -> Iterator[str]:
    yield heading("What to do next")
    yield paragraph(next_sentence(result))
    if result.next_motion:
        rows = [
            (one.name, format_number(one.separation_now), format_number(one.separation))
            for one in result.next_motion
        ]
        yield table(("motion", "sigmas apart now", "with it"), rows)
    if result.notes:
        yield paragraph("Notes of the audit:")
        yield table(("note",), [(note,) for note in result.notes])
    if result.noise_floor:
        yield paragraph("Origin of the noise floor:")
        yield table(("floor",), [(note,) for note in result.noise_floor])
