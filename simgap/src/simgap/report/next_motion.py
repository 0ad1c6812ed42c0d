"""The next motion in sentences, tables, JSON and a picture with a band for each rival."""

import html
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from simgap.arrays import Array
from simgap.common.files import atomic_write
from simgap.common.page import Origin, heading, paragraph, save_page
from simgap.common.page import figures as draw_figures
from simgap.common.page import table as draw_table
from simgap.common.report import ReportTable, file_lines
from simgap.next_motion.proposal import Curve, Proposal
from simgap.next_motion.separation import LEAST_POWER
from simgap.report.sentences import join_words, percent
from simgap.report.traces import extreme_rows
from simgap.units import SMALL_UNITS

FORMAT: Final = "next motion 1"
"""Name and version of the document."""
SHOWN: Final = 5
"""Motions in the table."""
COLOURS: Final = ("#d55e00", "#1f7ad6", "#009e73", "#cc79a7", "#a08000", "#56b4e9", "#e69f00", "#808080")
"""Colours of rivals (Okabe and Ito), which people with any vision can tell apart."""
BAND: Final = 2.0
"""Half the width of a band, in standard deviations of the noise."""
SURE: Final = "The logs exclude the other rivals already, at 95 %: the motion is a check."
WIDTH, HEIGHT, MARGIN = 640, 260, 52


def next_lines(made: Proposal) -> list[str]:
    """Return what to record, what it tells apart and how surely, and what it does not."""
    if not made.choice.tells_apart:
        rivals = join_words(list(made.rivals), "and")
        return [
            f"None of {len(made.motions)} motions tells {rivals} apart: what is logged would differ by less "
            "than the noise. Log another signal, such as a torque or a second encoder."
        ]
    powers = made.choice.powers[0]
    told = [k for k in range(len(powers)) if powers[k] >= LEAST_POWER]
    least = min(told, key=lambda k: powers[k])
    i, j = made.choice.pairs[least]
    rest = [made.choice.pairs[k] for k in range(len(powers)) if k not in told]
    pairs = [f"{made.rivals[a]} and {made.rivals[b]}" for a, b in rest]
    return [
        f"Record{f' {made.runs} times' if made.runs > 1 else ''}: {made.motions[made.choice.motions[0]]}.",
        f"It tells {len(told)} of {len(powers)} pairs of rivals apart. The nearest of them are "
        f"{made.rivals[i]} and {made.rivals[j]}: {made.choice.sigmas[0, least]:.3g} standard deviations; the "
        f"wrong one is excluded with a probability of {_chance(powers[least])}.",
        *([f"It does not tell apart: {'; '.join(pairs)}."] if pairs else []),
        *([SURE] if made.is_sure else []),
    ]


def _chance(power: float) -> str:
    """Return a probability in percent; none is certain."""
    return "over 99 %" if power > 0.99 else percent(float(power))


def next_tables(made: Proposal) -> tuple[ReportTable, ReportTable]:
    """Return the best motions, and the pairs of rivals in the best one."""
    choice = made.choice
    rows = []
    for k in range(min(SHOWN, len(choice.motions))):
        is_told = choice.powers[k] >= LEAST_POWER
        least = f"{choice.sigmas[k][is_told].min():.3g}" if is_told.any() else ""
        rows.append((made.motions[choice.motions[k]], str(int(is_told.sum())), least))
    pairs = [
        (made.rivals[i], made.rivals[j], f"{sigma:.3g}", _chance(power))
        for (i, j), sigma, power in zip(choice.pairs, choice.sigmas[0], choice.powers[0], strict=True)
    ]
    return (
        ReportTable(("motion", f"of {len(choice.pairs)} pairs", "least sigma"), rows, "Best motions"),
        ReportTable(
            ("rival", "other rival", "sigma", "wrong one excluded"), pairs, "Pairs in the best motion"
        ),
    )


def next_document(made: Proposal) -> dict[str, Any]:
    """Return a proposal as a document that JSON can hold."""
    choice = made.choice
    return {
        "format": FORMAT,
        "lines": next_lines(made),
        "tells_apart": choice.tells_apart,
        "finding": made.finding,
        "rivals": list(made.rivals),
        "pairs": [[made.rivals[i], made.rivals[j]] for i, j in choice.pairs],
        "compared": len(made.motions),
        "motions": [
            {
                "motion": made.motions[choice.motions[k]],
                "sigmas": choice.sigmas[k].tolist(),
                "probabilities": choice.powers[k].tolist(),
            }
            for k in range(min(SHOWN, len(choice.motions)))
        ],
    }


def save_next_files(
    made: Proposal,
    motion: dict[str, Path | None],
    write: Callable[[], str],
    report: Path | None,
    origin: Origin | None,
) -> list[str]:
    """Write the best motion and the page, where they are wanted, and return a line about each.

    Where no motion tells rivals apart there is no file of a motion.

    Args:
        motion: What the file of the motion is called, and its path.
        write: Makes the text of that file.

    Raises:
        BadOutput: A file cannot be written.
    """
    ((name, out),) = motion.items()
    out = out if made.choice.tells_apart else None
    if out is not None:
        with atomic_write(out, "out") as file:
            file.write(write().encode())
    if report is not None:
        save_next_page(made, report, origin)
    return file_lines({name: out, "report": report})


def save_next_page(made: Proposal, path: Path, origin: Origin | None) -> None:
    """Write the page with pictures of the best motion; BadOutput if the file cannot be written."""
    lines = next_lines(made)
    about = (
        "What each rival predicts in the best motion, less the mean of all. A band holds the noise of the "
        "logs, two standard deviations to each side."
    )
    parts = [
        *map(paragraph, lines[1:]),
        *([heading("Predictions"), paragraph(about), _legend(made.rivals)] if made.curves else []),
        draw_figures(*map(draw_bands, made.curves)),
    ]
    for one in next_tables(made):
        parts += [heading(one.title), draw_table(one.head, one.rows)]
    save_page(f"Next motion for {made.finding}", lines[0], (), origin, parts, path)


def _legend(rivals: Sequence[str]) -> str:
    items = (
        f'<span><i class="swatch" style="color:{colour}"></i>{html.escape(one)}</span> '
        for one, colour in zip(rivals, COLOURS, strict=False)
    )
    return f'<p class="legend">{"".join(items)}</p>'


def draw_bands(one: Curve) -> str:
    """Draw the predictions of one signal, each with its band, as SVG."""
    unit, factor = SMALL_UNITS.get(one.unit, (one.unit, 1.0))
    values, half = factor * one.values, factor * BAND * one.noise
    rows = extreme_rows(values)
    low, high = float(values.min()) - half, float(values.max()) + half
    x = _scale(one.time_s[rows], float(one.time_s[0]), float(one.time_s[-1]), MARGIN, WIDTH - 8)
    shapes = []
    for value, colour in zip(values[:, rows], COLOURS, strict=False):
        top, bottom = (_scale(value + side * half, low, high, HEIGHT - 28, 24) for side in (1.0, -1.0))
        middle = _scale(value, low, high, HEIGHT - 28, 24)
        around = _points(np.concatenate([x, x[::-1]]), np.concatenate([top, bottom[::-1]]))
        shapes.append(f'<polygon points="{around}" fill="{colour}" fill-opacity="0.15"/>')
        line = f'<polyline points="{_points(x, middle)}" fill="none" stroke="{colour}"'
        shapes.append(f'{line} stroke-width="1.5"/>')
    ticks = [
        f'<text x="{MARGIN - 6}" y="{_scale(np.array([at]), low, high, HEIGHT - 28, 24)[0] + 4:.0f}" '
        f'text-anchor="end">{at:.3g}</text>'
        for at in (low, 0.0, high)
    ]
    title = html.escape(f"{one.signal} [{unit}]")
    times = (
        f'<text x="{MARGIN}" y="{HEIGHT - 8}">{one.time_s[0]:.3g} s</text>'
        f'<text x="{WIDTH - 8}" y="{HEIGHT - 8}" text-anchor="end">{one.time_s[-1]:.3g} s</text>'
    )
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{title}" font-size="12" '
        f'fill="currentColor"><text x="{MARGIN}" y="14">{title}</text>'
        f"{''.join(shapes + ticks)}{times}</svg>"
    )


def _scale(values: Array, low: float, high: float, first: float, last: float) -> Array:
    return np.asarray(first + (values - low) / max(high - low, 1e-300) * (last - first))


def _points(x: Array, y: Array) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
