"""The rows of the paper's Tables 3 and 4: what was required, and what was estimated."""

from dataclasses import dataclass
from math import radians
from typing import Final, Literal

Component = Literal["total_m", "lateral_m", "normal_m", "axial_rad"]


@dataclass(frozen=True, slots=True)
class Row:
    """One row; plus or minus, in metres or radians."""

    name: str
    case: str
    component: Component
    required: float
    estimated: float


def _table(accuracy: str, repeatability: str, estimated: tuple[float, ...]) -> tuple[Row, ...]:
    total, lateral, axial, lateral_again, normal_again, axial_again = estimated
    return (
        Row("total position accuracy", accuracy, "total_m", 0.020, total),
        Row("lateral position accuracy", accuracy, "lateral_m", 0.015, lateral),
        Row("axial orientation accuracy", accuracy, "axial_rad", radians(9.8), axial),
        Row("lateral position repeatability", repeatability, "lateral_m", 0.010, lateral_again),
        Row("normal position repeatability", repeatability, "normal_m", 0.010, normal_again),
        Row("axial orientation repeatability", repeatability, "axial_rad", radians(2.0), axial_again),
    )


TABLE_3: Final = _table(
    "accuracy", "repeatability", (0.0262, 0.0232, radians(1.2), 0.0112, 0.0072, radians(0.7))
)
"""Before calibration."""
TABLE_4: Final = _table(
    "mars", "mars-repeatability", (0.0140, 0.0127, radians(1.1), 0.0077, 0.0050, radians(1.0))
)
"""After calibration, on Mars."""
