"""Figures as SVG inside a page, whose colours follow the style of the page.

Functions that draw use the colours below. They are markers: in the SVG each becomes a variable of the style
sheet, so that one figure serves a light and a dark page.
"""

import html
import re
from collections.abc import Callable
from io import StringIO
from typing import Any, Final

WIDTH_INCH: Final = 5.2
"""Width of a figure: its text is readable on a phone, and two fit beside each other on a desk."""
INK: Final = "#010101"
MUTED: Final = "#010102"
FAINT: Final = "#010103"
SHADE: Final = "#010104"
PAPER: Final = "#010105"
BLUE: Final = "#010106"
RED: Final = "#010107"
GREEN: Final = "#010108"
AMBER: Final = "#010109"
VIOLET: Final = "#01010a"
LIGHT: Final = "#01010b"
VARIABLES: Final = {
    INK: "ink", MUTED: "muted", FAINT: "faint", SHADE: "shade", PAPER: "paper", BLUE: "blue", RED: "red",
    GREEN: "green", AMBER: "amber", VIOLET: "violet", LIGHT: "light",
}  # fmt: skip
STYLE: Final[Any] = {
    "svg.fonttype": "none",
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.edgecolor": MUTED,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
}


def render_svg(alt: str, height_inch: float, draw: Callable[[Any], None]) -> str:
    """Draw a figure, and return the SVG element; the same figure gives the same text.

    Args:
        alt: Description for readers who do not see the figure; unique on the page.
        height_inch: Height; the width is that of all figures.
        draw: Function that draws on a matplotlib figure.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context(matplotlib.rcParamsDefault | STYLE | {"svg.hashsalt": alt}):
        figure = Figure(figsize=(WIDTH_INCH, height_inch), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        written = StringIO()
        figure.savefig(written, format="svg", metadata={"Date": None, "Creator": None})
    return _embed(written.getvalue(), alt)


def colour_bar(figure: Any, mapped: Any, axes: Any, label: str) -> Any:
    """Add a colour bar of vectors; matplotlib would make a bitmap of one with many colours."""
    bar = figure.colorbar(mapped, ax=axes, label=label)
    bar.solids.set(rasterized=False, edgecolor="face")
    bar.outline.set_visible(False)
    return bar


def _embed(svg: str, alt: str) -> str:
    """Cut an SVG document down to an element of a page."""
    view_box = re.search(r'viewBox="([^"]+)"', svg)
    if view_box is None:
        raise ValueError("the SVG has no viewBox")
    body = svg[svg.index(">", svg.index("<svg")) + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'<g id="[\w.]+_\d+"', "<g", body)  # numbers that repeat in each figure
    body = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px system-ui, sans-serif", body)
    for marker, name in VARIABLES.items():
        body = body.replace(marker, f"var(--{name})")
    label = html.escape(alt, quote=True)
    return f'<svg viewBox="{view_box[1]}" role="img" aria-label="{label}"><title>{label}</title>{body}'
