"""A line of block characters that shows how numbers go."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

BLOCKS: Final = "▁▂▃▄▅▆▇█"
NOTHING: Final = "·"
NO_NUMBER: Final = "?"
WIDTH: Final = 40


def size_line(size: NDArray[np.float64], width: int = WIDTH) -> str:
    """Sizes (n,), none negative, over time: the greatest of each column; a dot where there is nothing."""
    if not size.size:
        return ""
    columns = [part.max() for part in np.array_split(size, min(width, len(size)))]
    finite = [value for value in columns if np.isfinite(value)]
    top = max(finite, default=0.0)
    return "".join(NOTHING if value == 0 else _block(value, 0.0, top) for value in columns)


def value_lines(*series: NDArray[np.float64]) -> list[str]:
    """Values of several series on one scale, a character each."""
    every = np.concatenate(series)
    finite = every[np.isfinite(every)]
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
    return ["".join(_block(value, low, high) for value in values) for values in series]


def _block(value: float, low: float, high: float) -> str:
    if np.isnan(value):
        return NO_NUMBER
    if value >= high > low or np.isposinf(value):
        return BLOCKS[-1]
    share = (value - low) / (high - low) if high > low and np.isfinite(high - low) else 0.0
    return BLOCKS[int(np.clip(share, 0.0, 1.0) * (len(BLOCKS) - 1))]
