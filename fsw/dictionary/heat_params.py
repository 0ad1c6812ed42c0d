"""Parameters of the compensation of thermal growth."""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.types import Limits


@dataclass(frozen=True, slots=True)
class HeatParams:
    """Compensation of the thermal growth of links and tools."""

    calibration_C: Annotated[float, Limits(-100.0, 60.0)]
    """Temperature of the structure at which the transforms of links and tools hold."""
    compensated_share: Annotated[float, Limits(0.0, 1.0)]
    """Share of the growth that flight software compensates; 0 turns the compensation off."""
    filter_s: Annotated[float, Limits(0.1, 3600.0)]
    """Time constant of the filter of the temperature."""
    step_K: Annotated[float, Limits(0.01, 50.0)]
    """Change of the filtered temperature at which flight software builds the arm anew."""
