"""Figures drawn with matplotlib, which may not be installed."""

import os
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

from simgap.common.files import atomic_write


def save_figure(
    path: Path, size_inch: tuple[float, float], dpi: int, draw: Callable[[Any], None]
) -> str | None:
    """Draw a figure and save it as PNG.

    Args:
        path: The PNG file.
        size_inch: Width and height.
        dpi: Pixels per inch.
        draw: Function that draws on a matplotlib figure.

    Returns:
        None, or the reason why there is no picture: matplotlib is missing.

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
    """Draw a figure, and return the bytes of a PNG.

    Raises:
        ImportError: matplotlib is not installed.
    """
    os.environ.pop("MPLBACKEND", None)  # an unknown backend stops the import, and none is needed
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(matplotlib.rcParamsDefault):
        figure = Figure(figsize=size_inch, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        image = BytesIO()
        figure.savefig(image, format="png", dpi=dpi, facecolor=figure.get_facecolor())
    return image.getvalue()
