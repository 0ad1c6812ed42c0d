"""What a move leaves to chance: drawn anew whenever one begins, evenly within bounds."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fsw.dictionary.enums import Frame, Joint, Tool
from fsw.dictionary.types import Row6
from fsw.kinematics.transforms import Array
from sim.effects.effect import EachMove
from sim.effects.geometry import check_tool
from sim.effects.size import Size
from sim.scatter import Scatter, body_index, no_scatter


@dataclass(frozen=True, slots=True)
class FramePlay(EachMove):
    """A frame comes to rest within plus or minus a screw in its own axes: rx, ry, rz [rad], tx, ty, tz [m].

    Slop of the assembly, wobble of a bearing, hysteresis of the isolators under an instrument.
    """

    frame: Frame
    within: Annotated[Row6, Size(0.0, 0.1, unit="rad, m", typical=3e-5, neutral=0.0)]
    tool: Tool | None = None
    """Which tool, for the frame TOOL."""

    def __post_init__(self) -> None:
        check_tool(self.frame, self.tool)

    def scatter(self, rng: np.random.Generator) -> Scatter:
        """Every axis by itself."""
        drawn = no_scatter()
        drawn.screw[:, body_index(self.frame, self.tool)] = self.within * rng.uniform(-1.0, 1.0, 6)
        return drawn


@dataclass(frozen=True, slots=True)
class Windup(EachMove):
    """Friction inside a gear leaves it twisted, one way or the other."""

    joint: Joint
    within_rad: Annotated[float, Size(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def scatter(self, rng: np.random.Generator) -> Scatter:
        """The dead band of the gear shifted."""
        drawn = no_scatter()
        drawn.gear_rad[self.joint] = _within(rng, self.within_rad)
        return drawn


@dataclass(frozen=True, slots=True)
class ServoError(EachMove):
    """A motor comes to rest beside where its encoder says: lost counts, an ill-tuned controller."""

    joint: Joint
    within_rad: Annotated[float, Size(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def scatter(self, rng: np.random.Generator) -> Scatter:
        """Set-points and readings off by the same angle."""
        drawn = no_scatter()
        drawn.motor_rad[self.joint] = _within(rng, self.within_rad)
        return drawn


def _within(rng: np.random.Generator, most: float) -> Array:
    return np.asarray(rng.uniform(-most, most))
