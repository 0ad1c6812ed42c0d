"""Figures drawn with matplotlib, which may be missing."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ground.outputs import written_whole


def save_figure(
    path: Path, size_inch: tuple[float, float], dpi: int, draw: Callable[[Any], None]
) -> str | None:
    """Save as PNG what `draw` puts on a figure; the reason if matplotlib is not there to draw it.

    Raises:
        BadOutput: the file cannot be written.
    """
    os.environ.pop("MPLBACKEND", None)  # one that matplotlib does not know stops its import; none is needed
    try:
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        return f"matplotlib is missing ({error}); pip install matplotlib"
    with matplotlib.rc_context(matplotlib.rcParamsDefault):
        figure = Figure(figsize=size_inch, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        with written_whole(path, "picture") as file:
            figure.savefig(file, format="png", dpi=dpi)
    return None
