"""Figures drawn with matplotlib, which may be missing."""

import os
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

from ground.common.files import atomic_write


def save_figure(
    path: Path, size_inch: tuple[float, float], dpi: int, draw: Callable[[Any], None]
) -> str | None:
    """Save as PNG what `draw` puts on a figure; the reason if matplotlib is not there to draw it.

    Raises:
        BadOutput: the file cannot be written.
    """
    try:
        image = render_png(size_inch, dpi, draw)
    except ImportError as error:
        return f"matplotlib is missing ({error}); pip install matplotlib"
    with atomic_write(path, "picture") as file:
        file.write(image)
    return None


def render_png(size_inch: tuple[float, float], dpi: int, draw: Callable[[Any], None]) -> bytes:
    """What `draw` puts on a figure, as the bytes of a PNG; ImportError without matplotlib."""
    os.environ.pop("MPLBACKEND", None)  # one that matplotlib does not know stops its import; none is needed
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(matplotlib.rcParamsDefault):
        figure = Figure(figsize=size_inch, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        image = BytesIO()
        figure.savefig(image, format="png", dpi=dpi)
    return image.getvalue()
