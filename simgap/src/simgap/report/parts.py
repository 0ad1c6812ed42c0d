"""Parts of the page of a diagnosis, in HTML: errors by joint, interactive traces, findings, what remains.

Colours are variables of the style sheet of the page, so that one figure serves a light and a dark page.
"""

import html
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from math import floor, isfinite, log10
from typing import Any, Final

import numpy as np

from simgap.arrays import Array
from simgap.report.sentences import SMALL_UNITS, finding_lines, has_floor, level, percent, quantity
from simgap.report.traces import Trace, choose_traces, thin
from simgap.result import Diagnosis, JointError

SERIES: Final = {
    "measured": "measured",
    "nominal": "model as it is",
    "explained": "with the findings",
}
"""Series of a figure of traces, by their classes in the style sheet."""
BARS: Final = {
    "nominal": "model as it is",
    "base": "base parameters fitted",
    "explained": "with the findings",
}
RESOLUTION: Final = 4e3
"""Steps into which the range of a trace is divided: more than a screen has pixels."""
HINT: Final = "Drag to zoom, double click for all of it; point at the traces to read values."


def page_parts(diagnosis: Diagnosis, traces: Sequence[Trace]) -> list[str]:
    """Return the parts that follow the verdict.

    Args:
        traces: Traces of held-out motions; of each joint the worst, the middle and the best are shown.
    """
    return [
        figure_style(),
        *_error_part(diagnosis),
        *_trace_part(diagnosis, traces),
        *_finding_part(diagnosis),
        *_base_part(diagnosis),
        *_remaining_part(diagnosis),
        *_refused_part(diagnosis),
    ]


def figure_style() -> str:
    """Return the style of the figures as a part in HTML."""
    return f"<style>{_read('figures.css')}</style>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of plain text, which scrolls by itself if it is too wide."""
    heads = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    lines = ("".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return (
        '<div class="scroll" tabindex="0"><table>'
        f"<thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _error_part(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.errors:
        return []
    kinds = {one.kind for one in diagnosis.errors}
    is_judged = bool(diagnosis.judged_motions)
    judged = "motions that took no part" if is_judged else "the fitted motions: none was held out"
    legend = "".join(f'<span><i class="swatch {kind}"></i>{words}</span> ' for kind, words in BARS.items())
    mark = "The line across the bars is" if has_floor(diagnosis) else "No repeated motion shows"
    return [
        _heading("How far the error shrinks"),
        _paragraph(f"Mean error by joint on {judged}. {mark} the noise floor."),
        *([_paragraph(diagnosis.method)] if diagnosis.method else []),
        f"<p>{legend}</p>",
        f'<div class="bars">{"".join(_error_bars(one, len(kinds) > 1) for one in diagnosis.errors)}</div>',
    ]


def _error_bars(one: JointError, has_kind: bool) -> str:
    values = {"nominal": one.nominal, "base": one.base, "explained": one.explained}
    most = max((value for value in (*values.values(), one.noise_floor) if isfinite(value)), default=0.0)
    most = most or 1.0
    line = (
        f'<div class="floor" style="--share:{one.noise_floor / most:.4f}"></div>'
        if isfinite(one.noise_floor)
        else ""
    )
    rows = "".join(
        f'<div class="row"><span>{BARS[kind]}</span><div class="track">'
        f'<div class="bar {kind}" style="--share:{value / most if isfinite(value) else 0.0:.4f}"></div>{line}'
        f"</div><span>{html.escape(quantity(value, one.unit))}</span></div>"
        for kind, value in values.items()
    )
    title = f"{one.joint}, {one.kind}" if has_kind else one.joint
    return f"<figure><h3>{html.escape(title)}</h3>{rows}</figure>"


def _trace_part(diagnosis: Diagnosis, traces: Sequence[Trace]) -> list[str]:
    chosen = choose_traces(traces)
    if not chosen:
        return []
    kinds = {kind for _, kind in chosen}
    named = {joint if len(kinds) == 1 else f"{joint}, {kind}": own for (joint, kind), own in chosen.items()}
    return [
        _heading("Before and after"),
        _paragraph("Of each joint, the motions with the largest, middle and smallest error are shown."),
        *draw_traces(named),
    ]


def draw_traces(traces: Mapping[str, Sequence[Trace]]) -> list[str]:
    """Draw interactive figures, and the script that they need.

    Args:
        traces: Traces of each figure, by its title; a reader chooses one of them.

    Returns:
        Parts in HTML; `figures.css` styles them.
    """
    return [
        "<noscript><p>The figures here need JavaScript.</p></noscript>",
        *(_trace_figure(title, own) for title, own in traces.items()),
        f"<script>{_read('traces.js')}</script>",
    ]


def _trace_figure(joint: str, traces: Sequence[Trace]) -> str:
    shown = [one for one in SERIES if one != "measured" or traces[0].measured is not None]
    motions = [_motion(thin(one)) for one in traces]
    options = "".join(
        f'<option value="{k}">{html.escape(one.motion)}</option>' for k, one in enumerate(traces)
    )
    buttons = "".join(
        f'<button type="button" data-series="{name}" aria-pressed="true"><i class="swatch {name}"></i>'
        f"{SERIES[name]}</button>"
        for name in shown
    )
    text, label = html.escape(joint), html.escape(f"traces of {joint}", quote=True)
    return (
        f'<figure class="traces" data-label="{label}"><h3>{text}</h3><div class="tools">'
        f'<select aria-label="motion">{options}</select>{buttons}'
        '<button type="button" data-zoom="0.5" aria-label="zoom in">+</button>'
        '<button type="button" data-zoom="2" aria-label="zoom out">−</button>'
        '<button type="button" data-zoom="0">all</button></div>'
        f'<div class="plot"></div><p class="readout" data-hint="{HINT}">{HINT}</p>'
        f'<script type="application/json">{_json(motions)}</script></figure>'
    )


def _motion(one: Trace) -> dict[str, Any]:
    """Return a motion as the script reads it: times, and panels with their series."""
    unit, factor = SMALL_UNITS.get(one.unit, (one.unit, 1.0))
    residuals = {"nominal": factor * one.nominal, "explained": factor * one.explained}
    panels = [_panel(f"measured less predicted [{unit}]", unit, residuals, True)]
    if one.measured is not None:
        series = {
            "measured": one.measured,
            "nominal": one.measured - one.nominal,
            "explained": one.measured - one.explained,
        }
        panels.insert(0, _panel(f"measured and predicted [{one.unit}]", one.unit, series, False))
    return {"time_s": [round(float(t), 5) for t in one.time_s], "panels": panels}


def _panel(title: str, unit: str, series: Mapping[str, Array], is_residual: bool) -> dict[str, Any]:
    every = np.concatenate(list(series.values()))
    finite = every[np.isfinite(every)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    digits = max(0, -floor(log10(span / RESOLUTION))) if span > 0.0 else 0
    return {
        "title": title,
        "unit": unit,
        "is_residual": is_residual,
        "digits": digits,
        "series": {name: _numbers(values, digits) for name, values in series.items()},
    }


def _numbers(values: Array, digits: int) -> list[float | None]:
    return [round(float(value), digits) if isfinite(value) else None for value in values]


def _finding_part(diagnosis: Diagnosis) -> list[str]:
    if not (lines := finding_lines(diagnosis)):
        return []
    items = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
    rows = [
        (
            one.place,
            one.effect,
            one.text,
            percent(one.share) if isfinite(one.share) else "not known",
            ", ".join(one.effects) or "none of these",
        )
        for one in diagnosis.findings
        if level(one) == "effect"
    ]
    head = ("place", "effect", "size", "own share", "effects not excluded at 5 %")
    return [_heading("Which effects"), f"<ul>{items}</ul>", *([table(head, rows)] if rows else [])]


def _base_part(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.base:
        return []
    rows = [
        (
            one.place,
            one.name,
            f"{one.nominal:.4g}",
            f"{one.value:.4g}",
            f"{one.interval[0]:.4g} to {one.interval[1]:.4g}" if one.is_identifiable else "not known",
        )
        for one in diagnosis.base
    ]
    return [
        _heading("Base parameters"),
        _paragraph("Numbers that the model does not know for certain. They are fitted, and are no findings."),
        table(("place", "parameter", "model", "fitted", "90 %"), rows),
    ]


def _remaining_part(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.remaining:
        return [_heading("What remains"), _paragraph("Nothing that differs from noise.")]
    rows = [
        (
            one.joint,
            one.regime,
            quantity(one.mean_abs, one.unit),
            one.depends_on or "no logged variable",
            percent(one.depends_share) if one.depends_on else "",
        )
        for one in diagnosis.remaining
    ]
    return [
        _heading("What remains"),
        _paragraph("No effect of the catalogue explains this part; it is apart from what was named."),
        table(("joint", "regime", "mean error", "depends on", "share of it"), rows),
    ]


def _refused_part(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.refused:
        return []
    rows = [(one.motion, str(one.n_samples), one.reason) for one in diagnosis.refused]
    return [_heading("What took no part"), table(("motion", "samples", "reason"), rows)]


def _heading(text: str) -> str:
    return f"<h2>{html.escape(text)}</h2>"


def _paragraph(text: str) -> str:
    return f"<p>{html.escape(text)}</p>"


def _json(document: Any) -> str:
    """Return JSON that cannot end the element it stands in."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _read(name: str) -> str:
    return files("simgap.report").joinpath(name).read_text(encoding="utf-8")
