"""Figures drawn with matplotlib: as SVG inside a page, or as PNG for documents.

Functions that draw use the names of colours below. In an SVG they stand for the variables of the style sheet,
so that one figure serves a light and a dark page. In a PNG they have the values of the light page.
"""

import html
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, Final

from simgap.common.files import atomic_write

WIDTH_INCH: Final = 5.2
"""Width of a figure: its text is readable on a phone, and two fit beside each other on a desk."""
INK: Final = "page:ink"
MUTED: Final = "page:muted"
FAINT: Final = "page:faint"
SHADE: Final = "page:shade"
PAPER: Final = "page:paper"
BLUE: Final = "page:blue"
RED: Final = "page:red"
GREEN: Final = "page:green"
AMBER: Final = "page:amber"
VIOLET: Final = "page:violet"
LIGHT: Final = "page:light"
MARKERS: Final = {
    name: f"#0101{number:02x}"
    for number, name in enumerate(
        (INK, MUTED, FAINT, SHADE, PAPER, BLUE, RED, GREEN, AMBER, VIOLET, LIGHT), start=1
    )
}
"""Colours that stand in an SVG for the variables of the style sheet."""
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


@dataclass(frozen=True, slots=True, eq=False)
class ReportFigure:
    """Figure on the page of a report."""

    alt: str
    """Description for readers who do not see it; unique on the page."""
    height_inch: float
    draw: Callable[[Any], None]
    """Function that draws on a matplotlib figure."""

    def render(self) -> str:
        """Return the SVG element."""
        return render_svg(self.alt, self.height_inch, self.draw)


def render_svg(alt: str, height_inch: float, draw: Callable[[Any], None]) -> str:
    """Draw a figure of the common width, and return the SVG element; the same figure gives the same text.

    The description is for readers who do not see the figure; it is unique on the page.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    _name_colours(MARKERS)
    with matplotlib.rc_context(matplotlib.rcParamsDefault | STYLE | {"svg.hashsalt": alt}):
        figure = Figure(figsize=(WIDTH_INCH, height_inch), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        written = StringIO()
        figure.savefig(written, format="svg", metadata={"Date": None, "Creator": None})
    return _embed(written.getvalue(), alt)


def save_png(path: Path, size_inch: tuple[float, float], draw: Callable[[Any], None]) -> None:
    """Draw a figure of a page, and save it in the colours of the light page; else as `save_figure`."""

    def draw_in_colours(figure: Any) -> None:
        import matplotlib

        style = resources.files("simgap.common").joinpath("page.css").read_text(encoding="utf-8")
        light = re.findall(r"--(\w+): (#\w+);", style[: style.index("@media")])
        _name_colours({f"page:{name}": value for name, value in light})
        paper = {"figure.facecolor": PAPER, "axes.facecolor": PAPER}
        matplotlib.rcParams.update(STYLE | paper)
        figure.set_facecolor(PAPER)
        draw(figure)

    save_figure(path, size_inch, draw_in_colours)


def _name_colours(values: Mapping[str, str]) -> None:
    import matplotlib

    names = matplotlib.colors.get_named_colors_mapping()
    for name, value in values.items():
        names[name] = value  # `update` would keep what matplotlib has cached


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
    for name, marker in MARKERS.items():
        body = body.replace(marker, f"var(--{name.removeprefix('page:')})")
    label = html.escape(alt, quote=True)
    return f'<svg viewBox="{view_box[1]}" role="img" aria-label="{label}"><title>{label}</title>{body}'


def save_figure(path: Path, size_inch: tuple[float, float], draw: Callable[[Any], None]) -> None:
    """Draw a figure as PNG of 110 dots an inch; BadOutput if the file cannot be written."""
    os.environ.pop("MPLBACKEND", None)  # an unknown backend stops the import, and none is needed
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(matplotlib.rcParamsDefault):
        figure = Figure(figsize=size_inch, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        image = BytesIO()
        figure.savefig(image, format="png", dpi=110, facecolor=figure.get_facecolor())
    with atomic_write(path, "picture") as file:
        file.write(image.getvalue())
