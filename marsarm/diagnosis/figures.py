"""Figures of a diagnosis: residual map, amplitudes of effects, closure by channel."""

from typing import Any, Final

import numpy as np

from marsarm.diagnosis.closure import Closure
from marsarm.diagnosis.diagnose import Finding
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.residual_analysis import ResidualCell
from marsarm.diagnosis.result import DiagnosisResult
from marsarm.diagnosis.sentences import channel_words, format_number
from marsarm.render import svg

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
