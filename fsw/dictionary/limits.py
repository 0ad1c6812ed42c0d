"""The ranges in which numbers are believable; annotations of commands and parameters."""

from dataclasses import dataclass
from typing import Annotated


@dataclass(frozen=True, slots=True)
class Limits:
    """The closed range in which a number is believable."""

    low: float
    high: float


Length = Annotated[float, Limits(-5.0, 5.0)]
Angle = Annotated[float, Limits(-6.5, 6.5)]
