"""Text for the terminal: consoles, plurals and sparklines."""

import re
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

NUMBER: Final = re.compile(r"[-+±]? ?\d.{0,23}|never|-")
"""Cell that is a number with its unit or an interval; a column of these is aligned right and not wrapped."""
BLOCKS: Final = "▁▂▃▄▅▆▇█"
ZERO_MARK: Final = "·"
NAN_MARK: Final = "?"
SPARKLINE_WIDTH: Final = 40


def magnitude_sparkline(size: NDArray[np.float64]) -> str:
    """Draw magnitudes, (n,), in so many blocks at most: each shows the maximum of its part, a dot zero."""
    if not size.size:
        return ""
    columns = [part.max() for part in np.array_split(size, min(SPARKLINE_WIDTH, len(size)))]
    finite = [value for value in columns if np.isfinite(value)]
    top = max(finite, default=0.0)
    return "".join(ZERO_MARK if value == 0 else _block(value, 0.0, top) for value in columns)


def value_sparklines(*series: NDArray[np.float64]) -> list[str]:
    """Draw several series, each of shape (n,), on one scale, with a block character for each value."""
    values_of_all = np.concatenate(series)
    finite = values_of_all[np.isfinite(values_of_all)]
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
    return ["".join(_block(value, low, high) for value in values) for values in series]


def _block(value: float, low: float, high: float) -> str:
    if np.isnan(value):
        return NAN_MARK
    if value >= high > low or np.isposinf(value):
        return BLOCKS[-1]
    share = (value - low) / (high - low) if high > low and np.isfinite(high - low) else 0.0
    return BLOCKS[int(np.clip(share, 0.0, 1.0) * (len(BLOCKS) - 1))]


def pluralize(count: int, one: str) -> str:
    """Format a count with its noun: 1 channel, 2 channels."""
    return f"{count} {one}" if count == 1 else f"{count} {one}s"


WARNING_STYLE: Final = "bold"


def plain_console(width: int | None = None) -> Console:
    """Make a console that interprets no markup: titles, paths and messages may contain brackets, colons."""
    return Console(highlight=False, markup=False, emoji=False, width=width)
