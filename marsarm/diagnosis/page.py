"""HTML page of a diagnosis: four lines, residual map, effects, closure, lack of fit, next motion."""

from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from marsarm.diagnosis.closure import Closure
from marsarm.diagnosis.diagnose import Finding, ResidualCell
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.result import (
    MAX_LISTED,
    DiagnosisResult,
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
from marsarm.render import svg
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

ROW_INCH: Final = 0.26

MARGIN_INCH: Final = 1.3

MIN_ROWS: Final = 3
"""Least number of rows of a figure."""

DARKEST_RATIO: Final = 10.0
"""Least ratio to the noise floor that is drawn in the darkest colour."""

MIN_AXIS_SPAN: Final = (0.5, 4.0)
"""Least span of the axis, in ratios to the noise floor."""

LEAST_DRAWN: Final = 1e-3
"""Smallest ratio to the noise floor that is drawn."""


def save_diagnosis_page(result: DiagnosisResult, origin: Origin, path: Path) -> None:
    """Write the page.

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


def residual_map_figure(cells: tuple[ResidualCell, ...]) -> str:
    """Draw the residual map, channels by regimes, largest ratio on top."""
    rows = list(dict.fromkeys(channel_words(cell.channel, cell.place) for cell in cells))
    columns = sorted({cell.regime for cell in cells})
    ratio = np.full((len(rows), len(columns)), np.nan)
    for cell in cells:
        at = rows.index(channel_words(cell.channel, cell.place)), columns.index(cell.regime)
        ratio[at] = cell.ratio
    return svg.render_svg(
        "map of the gap: channels by regimes",
        _height(len(rows)),
        lambda figure: _draw_map(figure, rows, columns, ratio),
    )


def amplitude_figure(result: DiagnosisResult) -> str:
    """Draw the amplitudes of the findings with their intervals."""
    count = max(len(result.diagnosis.findings), MIN_ROWS)
    return svg.render_svg(
        "sizes of effects",
        _height(count),
        lambda figure: _draw_amplitudes(figure.subplots(), result.model, result.diagnosis.findings),
    )


def closure_figure(closure: Closure) -> str:
    """Draw every channel on held-out motion before and after, in units of its noise floor."""
    return svg.render_svg(
        "before and after, channel by channel",
        _height(len(closure.channels)),
        lambda figure: _draw_closure(figure, closure),
    )


def _height(rows: int) -> float:
    return MARGIN_INCH + ROW_INCH * rows


def _draw_map(figure: Any, rows: list[str], columns: list[str], ratio: Any) -> None:
    from matplotlib.colors import LogNorm

    axes = figure.subplots()
    norm = LogNorm(1.0, max(DARKEST_RATIO, float(np.nanmax(ratio))), clip=True)
    image = axes.pcolormesh(np.ma.masked_invalid(ratio), cmap="Reds", norm=norm, edgecolor=svg.PAPER)
    for (row, column), value in np.ndenumerate(ratio):
        if np.isfinite(value):
            dark = norm(value) > 0.6
            axes.text(
                column + 0.5, row + 0.5, f"{value:.1f}" if value < 99.95 else f"{value:.0f}",
                ha="center", va="center", fontsize=8, color="#ffffff" if dark else "#1f2328",
            )  # fmt: skip
    axes.set_xticks(np.arange(len(columns)) + 0.5, columns)
    axes.set_yticks(np.arange(len(rows)) + 0.5, rows, fontsize=8)
    axes.invert_yaxis()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    bar = svg.colour_bar(figure, image, axes, "rms over the floor")
    _decimal_ticks(bar.ax.yaxis)


def _draw_amplitudes(axes: Any, model: DiagnosisModel, findings: tuple[Finding, ...]) -> None:
    """Draw departures from neutral in typical sizes, with the undetectable range in grey."""
    names: list[str] = []
    for finding in findings:
        hypothesis = model.sensitivities.hypotheses[finding.hypothesis]
        limit = model.limits[finding.hypothesis].limit
        for parameter, value, least, most in zip(
            hypothesis.parameters, finding.values, finding.least, finding.most, strict=True
        ):
            if parameter.is_amplitude and np.isfinite(least):
                row = len(names)
                size, one, other = (
                    (end - parameter.absent) / parameter.typical for end in (value, least, most)
                )
                if len(hypothesis.amplitudes) == 1 and np.isfinite(limit):
                    axes.barh(row, 2.0 * limit, left=-limit, color=svg.SHADE, height=0.9)
                axes.plot([one, other], [row, row], color=svg.BLUE, linewidth=3, solid_capstyle="butt")
                axes.plot(size, row, "o", color=svg.BLUE)
                names.append(f"{parameter.name},\n{hypothesis.name}")
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(*_rows(len(names)))
    axes.axvline(0.0, color=svg.MUTED, linewidth=0.8)
    axes.set(title="Sizes with 90 % intervals; grey: not seen", xlabel="typical sizes from neutral")


def _rows(count: int) -> tuple[float, float]:
    """Return the limits of an axis of rows, first row on top, with room for MIN_ROWS."""
    room = max(count, MIN_ROWS)
    return (count + room - 1) / 2.0, (count - room - 1) / 2.0


def _draw_closure(figure: Any, closure: Closure) -> None:
    axes = figure.subplots()
    channels = sorted(closure.channels, key=lambda one: -one.before / one.noise_floor)
    for row, one in enumerate(channels):
        before, after = (max(value / one.noise_floor, LEAST_DRAWN) for value in (one.before, one.after))
        axes.plot([before, after], [row, row], color=svg.FAINT, zorder=1)
        labels = ("before", "after") if row == 0 else (None, None)
        axes.plot(before, row, "o", color=svg.RED, label=labels[0], fillstyle="none", markersize=8)
        axes.plot(after, row, "o", color=svg.BLUE, label=labels[1])
    axes.axvline(1.0, color=svg.INK, linestyle=":", label="floor")
    axes.set_yticks(range(len(channels)), [one.channel for one in channels], fontsize=8)
    axes.invert_yaxis()
    axes.set_xscale("log")
    least, most = axes.get_xlim()
    axes.set_xlim(min(least, MIN_AXIS_SPAN[0]), max(most, MIN_AXIS_SPAN[1]))
    _decimal_ticks(axes.xaxis)
    axes.set(xlabel="rms on held-out motion, over the floor")
    figure.legend(loc="outside lower center", ncols=3)


def _decimal_ticks(axis: Any) -> None:
    """Set ticks of a logarithmic axis at 1, 2, 5 and 10."""
    from matplotlib.ticker import LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: format_number(value))
