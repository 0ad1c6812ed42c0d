"""All that is said of a set of logs: what the page shows and the JSON says."""

from dataclasses import dataclass

from ground.diagnosis.closure import Closure
from ground.diagnosis.diagnose import Diagnosis
from ground.diagnosis.next_motion import Motion
from ground.diagnosis.ready import Ready


@dataclass(frozen=True, slots=True)
class ToolGap:
    """How far the tools are from where the simulator has them on held-out motion, root mean squares [mm]."""

    before_mm: float
    after_mm: float
    floor_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """A diagnosis with what belongs to it."""

    ready: Ready
    diagnosis: Diagnosis
    closure: Closure | None
    """None if no motion was held out."""
    tool: ToolGap | None
    """None if no held-out motion has tracker poses."""
    next_motion: tuple[Motion, ...]
    """Best first; none if nothing is confusable, or nothing was found."""
    notes: tuple[str, ...]
    """What the audit said."""
    floor: tuple[str, ...]
    """Where the floor is from."""
