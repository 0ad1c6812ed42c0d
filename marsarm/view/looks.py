"""Numbers and colours of a view, for the viewer and, in its document, for the page."""

from typing import Any, Final

SPEEDS: Final = (1, 2, 5, 10, 20, 50)
FIRST_SPEED: Final = 10
GHOST_RGB: Final = (40, 115, 240)
FORCE_RGB: Final = (230, 30, 25)
TRAIL_RGB: Final = (255, 217, 25)
CURVE_COLOURS: Final = ("#1f77b4", "#d95f02", "#2b8a3e", "#8e44ad", "#7a5c3e")
DARK_CURVE_COLOURS: Final = ("#6db3f2", "#ff9f5a", "#6fce82", "#c58be0", "#c9a581")
"""Colours of the curves on a dark page."""
ARROW_M_PER_N: Final = 0.006
SHORTEST_ARROW_M, LONGEST_ARROW_M = 0.1, 0.8
"""A touch is as long as a tool, and 117 N or more as long as a link: both stay visible."""
ARROW_RADIUS_M, ARROW_HEAD_M = 0.012, 0.03
"""Radius of the shaft and of the head."""
LEAST_FORCE_N: Final = 0.05
"""Force below which no arrow is drawn: the readout shows tenths of a newton."""
TRAIL_STEP_M: Final = 0.01
"""Least distance of two points of a trail: two pixels of the first view, in which a pixel is 5 mm."""
MOST_MAGNIFICATION: Final = 50.0
"""At this factor the 15 mm of an as-built arm are 0.75 m, a third of its reach, and 1 mrad is 3 deg."""


def looks_json() -> dict[str, Any]:
    """Return the numbers and colours as a JSON document for the page; colours of the scene are 0 to 1."""
    scene = {"ghost": GHOST_RGB, "force": FORCE_RGB, "trail": TRAIL_RGB}
    return {
        "speeds": SPEEDS,
        "first_speed": FIRST_SPEED,
        "rgb": {name: [round(value / 255, 3) for value in rgb] for name, rgb in scene.items()},
        "curves": {"light": CURVE_COLOURS, "dark": DARK_CURVE_COLOURS},
        "arrow": {
            "m_per_N": ARROW_M_PER_N,
            "shortest_m": SHORTEST_ARROW_M,
            "longest_m": LONGEST_ARROW_M,
            "radius_m": ARROW_RADIUS_M,
            "head_m": ARROW_HEAD_M,
            "least_N": LEAST_FORCE_N,
        },
        "trail_step_m": TRAIL_STEP_M,
        "magnification": MOST_MAGNIFICATION,
    }
