"""What a parameter of an effect may be: an annotation of its field."""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.types import Limits


@dataclass(frozen=True, slots=True, kw_only=True)
class Size(Limits):
    """The bounds of a parameter, its unit, and how far from neutral it is typically."""

    unit: str
    typical: float
    """Departure from neutral; of a parameter without a neutral value, the value."""
    neutral: float | None = None
    """Where the effect changes nothing; None for a parameter that only shapes what others bring about."""


Factor = Annotated[float, Size(0.1, 10.0, unit="1", typical=0.2, neutral=1.0)]
"""Of what the drawing says."""
SmallAngle = Annotated[float, Size(-0.1, 0.1, unit="rad", typical=2e-3, neutral=0.0)]
SmallLength = Annotated[float, Size(-0.1, 0.1, unit="m", typical=1.5e-3, neutral=0.0)]
Compliance = Annotated[float, Size(0.0, 1e-3, unit="rad/(N m)", typical=5e-6, neutral=0.0)]
Warmth = Annotated[float, Size(-200.0, 200.0, unit="K", typical=30.0, neutral=0.0)]
When = Annotated[float, Size(0.0, 1e5, unit="s", typical=10.0)]
