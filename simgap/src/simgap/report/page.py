"""Page of a diagnosis: errors by joint, interactive traces, findings, what remains.

Colours are variables of the style sheet of the page, so that one figure serves a light and a dark page.
"""

import html
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from math import degrees, floor, inf, isfinite, log10
from pathlib import Path
from typing import Any, Final

import numpy as np

from simgap.arrays import Array
from simgap.checks.records import COARSE_RAD
from simgap.common.page import Origin, heading, paragraph, save_page, table
from simgap.report.details import rest_lines
from simgap.report.sentences import (
    EARLIER,
    FAMILY_WORDS,
    NOT_LOCATED,
    has_floor,
    join_words,
    level,
    percent,
    rank_findings,
    verdict_lines,
    verdict_word,
)
from simgap.report.traces import Trace, choose_traces, thin
from simgap.result import Diagnosis, Finding, JointError
from simgap.robot import SLIDE_m_rad
from simgap.units import SMALL_UNITS, quantity

MODEL: Final = "model as it is"
SERIES: Final = {
    "measured": "measured",
    "nominal": MODEL,
    "explained": "with the findings",
    "command": "command",
    "refused": "left out",
}
"""Series of a figure of traces, by their classes in the style sheet."""
BARS: Final = {
    "nominal": MODEL,
    "base": "base parameters fitted",
    "explained": "with the findings",
}
LEAST_SPANS: Final = {"rad": COARSE_RAD, "deg": degrees(COARSE_RAD), "m": SLIDE_m_rad * COARSE_RAD}
"""Least ranges of positions that fill a figure, by unit: a joint that moves less looks idle, as it is."""
STEPS: Final = 16
"""Steps of usual encoders, of 12 bits, in LEAST_SPANS; no error smaller than a step fills a figure."""
RESOLUTION: Final = 4e3
"""Steps into which the range of a trace is divided: more than a screen has pixels."""
HINT: Final = "Drag to zoom, double click for all of it; point at the traces to read values."


def page_parts(diagnosis: Diagnosis, traces: Sequence[Trace]) -> list[str]:
    """Return the parts that follow the verdict, with some traces of each joint."""
    refused = [(one.motion, str(one.n_samples), one.reason) for one in diagnosis.refused]
    remarks = [heading("Remarks on the logs"), *map(paragraph, diagnosis.remarks)]
    return [
        figure_style(),
        *_finding_part(diagnosis),
        *_error_part(diagnosis),
        *_trace_part(diagnosis, traces),
        *_base_part(diagnosis),
        *_remaining_part(diagnosis),
        *_table_part("What took no part", ("motion", "samples", "reason"), refused),
        *(remarks if diagnosis.remarks else []),
    ]


def figure_style() -> str:
    """Return the style of the figures as a part in HTML."""
    return f"<style>{_read('figures.css')}</style>"


def _rank_errors(diagnosis: Diagnosis) -> list[JointError]:
    """Return the errors, that which is largest over its noise first; without noise in the order of joints."""

    def share(one: JointError) -> float:
        nominal = one.nominal if isfinite(one.nominal) else inf
        return nominal / one.noise_floor if one.noise_floor > 0.0 else 0.0

    return sorted(diagnosis.errors, key=share, reverse=True) if has_floor(diagnosis) else [*diagnosis.errors]


def _error_part(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.errors:
        return []
    kinds = {one.kind for one in diagnosis.errors}
    is_judged = bool(diagnosis.judged_motions)
    judged = "motions that took no part" if is_judged else "the fitted motions: none was held out"
    words = _name_series(BARS, diagnosis)
    legend = "".join(f'<span><i class="swatch {kind}"></i>{name}</span> ' for kind, name in words.items())
    unknown = "No repeated motion shows the noise floor"
    bars = "".join(_error_bars(one, len(kinds) > 1, words) for one in _rank_errors(diagnosis))
    mark = "The line across the bars is the noise floor; what is largest over it comes first"
    return [
        heading("How far the error shrinks"),
        paragraph(f"Mean error by joint on {judged}. {mark if has_floor(diagnosis) else unknown}."),
        *([paragraph(diagnosis.method)] if diagnosis.method else []),
        f'<p class="legend">{legend}</p>',
        f'<div class="bars">{bars}</div>',
    ]


def _name_series(words: Mapping[str, str], diagnosis: Diagnosis) -> dict[str, str]:
    """Return the words of series by their classes, that of the model as the diagnosis started."""
    return {kind: EARLIER if diagnosis.start and name == MODEL else name for kind, name in words.items()}


def _error_bars(one: JointError, has_kind: bool, words: Mapping[str, str]) -> str:
    values = {"nominal": one.nominal, "base": one.base, "explained": one.explained}
    most = max((value for value in (*values.values(), one.noise_floor) if isfinite(value)), default=0.0)
    most = most or 1.0
    floor = f'<div class="floor" style="--share:{one.noise_floor / most:.4f}"></div>'
    line = floor if isfinite(one.noise_floor) else ""
    rows = "".join(
        f'<div class="row"><span>{words[kind]}</span><div class="track">'
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
    rank = {(one.joint, one.kind): k for k, one in enumerate(_rank_errors(diagnosis))}
    chosen = dict(sorted(chosen.items(), key=lambda one: rank.get(one[0], len(rank))))
    kinds = {kind for _, kind in chosen}
    named = {joint if len(kinds) == 1 else f"{joint}, {kind}": own for (joint, kind), own in chosen.items()}
    is_fitted = any(one.motion in diagnosis.fitted_motions for one in traces)
    words = _name_series(SERIES, diagnosis)
    motions = "motions" if is_fitted else "motions that took no part, those"
    return [
        heading("Before and after"),
        paragraph(f"Of each joint, the {motions} with the largest, middle and smallest error are shown."),
        *draw_figures([_trace_figure(title, own, words) for title, own in named.items()]),
    ]


def draw_figures(figures: Sequence[str]) -> list[str]:
    """Return figures of `series_figure`, which `figures.css` styles, with the script that they need."""
    hint = "<noscript><p>The figures here need JavaScript.</p></noscript>"
    return [hint, *figures, f"<script>{_read('traces.js')}</script>"]


def _trace_figure(joint: str, traces: Sequence[Trace], words: Mapping[str, str]) -> str:
    shown = ["nominal", "explained"] if traces[0].measured is None else ["measured", "nominal", "explained"]
    return series_figure(joint, shown, [(one.motion, _motion(thin(one))) for one in traces], words)


def series_figure(
    title: str,
    shown: Sequence[str],
    motions: Sequence[tuple[str, dict[str, Any]]],
    words: Mapping[str, str] = SERIES,
) -> str:
    """Draw an interactive figure of keys of SERIES, in motions by name as `motion_document` has them."""
    named = ((k, html.escape(name)) for k, (name, _) in enumerate(motions))
    options = "".join(f'<option value="{k}">{name}</option>' for k, name in named)
    buttons = "".join(
        f'<button type="button" data-series="{name}" aria-pressed="true"><i class="swatch {name}"></i>'
        f"{words[name]}</button>"
        for name in shown
    )
    text, label = html.escape(title), html.escape(f"traces of {title}", quote=True)
    data = json.dumps([document for _, document in motions], allow_nan=False, separators=(",", ":"))
    data = data.replace("<", "\\u003c")  # it cannot end the element that it stands in
    return (
        f'<figure class="traces" data-label="{label}"><h3>{text}</h3><div class="tools">'
        f'<select aria-label="motion">{options}</select>{buttons}'
        '<button type="button" data-zoom="0.5" aria-label="zoom in">+</button>'
        '<button type="button" data-zoom="2" aria-label="zoom out">−</button>'
        '<button type="button" data-zoom="0">all</button></div>'
        f'<div class="plot"></div><p class="readout" data-hint="{HINT}">{HINT}</p>'
        f'<script type="application/json">{data}</script></figure>'
    )


def motion_document(time_s: Array, panels: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return a motion with times, (n,), and panels of n values each, as the script reads it."""
    return {"time_s": [round(float(t), 5) for t in time_s], "panels": panels}


def _motion(one: Trace) -> dict[str, Any]:
    residuals = {"nominal": one.nominal, "explained": one.explained}
    panels = [error_panel("measured less predicted", one.unit, residuals)]
    if one.measured is not None:
        series = {"measured": one.measured} | {name: one.measured - left for name, left in residuals.items()}
        panels.insert(0, position_panel("measured and predicted", one.unit, series))
    return motion_document(one.time_s, panels)


def position_panel(title: str, unit: str, series: Mapping[str, Array]) -> dict[str, Any]:
    """Return a panel of positions in rad, or of a slide in m."""
    shown, factor = SMALL_UNITS[unit] if unit == "m" else (unit, 1.0)
    return _panel(title, shown, factor, series, LEAST_SPANS.get(unit, 0.0))


def error_panel(title: str, unit: str, series: Mapping[str, Array]) -> dict[str, Any]:
    """Return a panel of errors, in the unit in which they are small numbers."""
    shown, factor = SMALL_UNITS.get(unit, (unit, 1.0))
    return _panel(title, shown, factor, series, LEAST_SPANS.get(unit, 0.0) / STEPS) | {"is_residual": True}


def _panel(title: str, unit: str, factor: float, series: Mapping[str, Array], least: float) -> dict[str, Any]:
    """Return a panel of a figure, with numbers as exact as a screen shows them."""
    scaled = {name: factor * values for name, values in series.items()}
    every = np.concatenate(list(scaled.values()))
    finite = every[np.isfinite(every)]
    span = max(float(np.ptp(finite)) if finite.size else 0.0, factor * least)
    digits = max(0, -floor(log10(span / RESOLUTION))) if span > 0.0 else 0
    return {
        "title": f"{title} [{unit}]",
        "unit": unit,
        "is_residual": False,
        "least": factor * least,
        "digits": digits,
        "series": {name: _numbers(values, digits) for name, values in scaled.items()},
    }


def _numbers(values: Array, digits: int) -> list[float | None]:
    return [round(float(value), digits) if isfinite(value) else None for value in values]


def _finding_part(diagnosis: Diagnosis) -> list[str]:
    items = "".join(f"<li>{html.escape(line)}</li>" for line in rest_lines(diagnosis))
    rows = [_finding_row(one) for one in rank_findings(diagnosis)]
    if not (rows or items):
        return []
    head = ("place", "effect", "size, and with 90 % probability", "own share", "not excluded at 5 %")
    listed = [f"<ul>{items}</ul>"] if items else []
    return [heading("Which effects"), *([table(head, rows)] if rows else []), *listed]


def _finding_row(one: Finding) -> tuple[str, ...]:
    """Return the cells of a finding, at the level at which it is known."""
    place = join_words(one.places or (one.place,), "or")
    known = level(one)
    families = tuple(FAMILY_WORDS[family] for family in one.families)
    members = {"effect": one.effects, "family": families}.get(known, ())
    if known != "effect":
        what = join_words(members, "or") or "something"
        return NOT_LOCATED if known == "none" else place, what, "", "", ", ".join(members) or "not known"
    sizes = zip(one.size_names, one.interval, strict=True)
    intervals = ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in sizes)
    share = percent(one.share) if isfinite(one.share) else "not known"
    return place, one.effect, f"{one.text}; {intervals}", share, ", ".join(one.effects)


def _base_part(diagnosis: Diagnosis) -> list[str]:
    rows = []
    for one in diagnosis.base:
        ends = "{:.4g} to {:.4g}".format(*one.interval) if one.is_identifiable else "not known"
        rows.append((one.place, one.name, f"{one.nominal:.4g}", f"{one.value:.4g}", ends))
    about = "Numbers that the model does not know for certain. They are fitted, and are no findings."
    return _table_part(
        "Base parameters",
        ("place", "parameter", "earlier result" if diagnosis.start else "model", "fitted", "90 %"),
        rows,
        about,
    )


def _table_part(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], about: str = "") -> list[str]:
    """Return a table with its heading; nothing without rows."""
    return [heading(title), *([paragraph(about)] if about else []), table(head, rows)] if rows else []


def _remaining_part(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.remaining:
        return [heading("What remains"), paragraph("Nothing that differs from noise.")]
    rows = []
    for one in diagnosis.remaining:
        depends = ("no logged variable", "")
        if one.depends_on:
            depends = (one.depends_on, percent(one.depends_share))
        rows.append((one.joint, one.regime, quantity(one.mean_abs, one.unit), *depends))
    about = "No effect of the catalogue explains this part; it is apart from what was named."
    if diagnosis.is_base_only:
        about = "Base parameters do not explain this part; no effect was looked for."
    head = ("joint", "regime", "mean error", "depends on", "share of it")
    return _table_part("What remains", head, rows, about)


def _read(name: str) -> str:
    return files("simgap.report").joinpath(name).read_text(encoding="utf-8")


def page_title(diagnosis: Diagnosis) -> str:
    """Return the title of the page of a diagnosis."""
    titles = {
        "named": "The error has a name",
        "set": "The error has one of several names",
        "none": "No effect is seen",
        "unknown": "The error is not in the catalogue",
    }
    title = "Base parameters alone" if diagnosis.is_base_only else titles[verdict_word(diagnosis)]
    return f"{diagnosis.robot}: {title}"


def save_diagnosis_page(
    diagnosis: Diagnosis, traces: Sequence[Trace], path: Path, origin: Origin | None = None
) -> None:
    """Write the page, the same bytes but for a date; BadOutput if the file cannot be written."""
    parted = (line.partition(": ") for line in verdict_lines(diagnosis))
    verdict = {name: text for name, _, text in parted}
    save_page(page_title(diagnosis), verdict, (), origin, page_parts(diagnosis, traces), path)
