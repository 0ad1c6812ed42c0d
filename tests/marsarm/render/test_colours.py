"""Colours that stand beside each other, as readers see them who lack one kind of cone.

Matrices for linear RGB: G. Machado, M. Oliveira and L. Fernandes, "A physiologically-based model for
simulation of color vision deficiency", IEEE TVCG 15 (2009), severity 1.
"""

import re
from importlib.resources import files

import numpy as np
import pytest

from marsarm.accuracy.budget_report import FRAME_COLOURS
from marsarm.view.scene import CURVE_COLOURS, DARK_CURVE_COLOURS

SIGHT = {
    "all cones": np.eye(3),
    "protanopia": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deuteranopia": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "tritanopia": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
XYZ_OF_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
JUST_NOTICEABLE = 2.3
"""Distance in CIELAB of two large patches side by side that half of the observers tell apart."""
APART = 6 * JUST_NOTICEABLE
"""For small patches and lines that are not side by side."""
SERIES_APART = 20.0
"""For thin lines that lie beside each other."""
TRACES = ("nominal", "explained")
STYLE = "".join(
    files("simgap").joinpath(name).read_text() for name in ("common/page.css", "report/figures.css")
)
SERIES = [
    tuple(re.findall(rf"--{name}: (#\w+)", STYLE)[scheme] for name in ("paper", "ink", "muted", *TRACES))
    for scheme in (0, 1)
]
"""Colours of traces and of what is behind them, in the light and the dark scheme."""


def distances(colours: tuple[str, ...], sight: np.ndarray) -> np.ndarray:
    """Return the distances in CIELAB between colours as seen, shape (n, n)."""
    srgb = np.array([[int(name[k : k + 2], 16) / 255 for k in (1, 3, 5)] for name in colours])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.transpose(sight), 0.0, 1.0) @ XYZ_OF_RGB.T / XYZ_OF_RGB.sum(axis=1)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    lab = np.column_stack([116 * f[:, 1], 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])])
    return np.linalg.norm(lab[:, None] - lab, axis=-1)


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize(
    ("colours", "least"),
    [
        *((one, APART) for one in (FRAME_COLOURS, CURVE_COLOURS, DARK_CURVE_COLOURS)),
        *((one, SERIES_APART) for one in SERIES),
    ],
    ids=["frames", "curves", "dark curves", "traces", "dark traces"],
)
def test_colours_are_told_apart(colours, least, sight):
    apart = distances(colours, SIGHT[sight])
    assert apart[np.triu_indices(len(colours), 1)].min() > least
