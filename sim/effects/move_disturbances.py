"""What a move leaves to chance: drawn anew whenever one begins, evenly within bounds."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fsw.dictionary.enums import Frame, Joint, Tool
from fsw.dictionary.types import Row6
from fsw.kinematics.transforms import Array
from sim.disturbance import MoveDisturbance, body_index, no_move_disturbance
from sim.effects.effect import EachMove, ParameterSpec
from sim.effects.geometry import check_tool


@dataclass(frozen=True, slots=True)
class FramePlay(EachMove):
    """A frame comes to rest within plus or minus a screw in its own axes: rx, ry, rz [rad], tx, ty, tz [m].

    Slop of the assembly, wobble of a bearing, hysteresis of the isolators under an instrument.
    """

    frame: Frame
    within: Annotated[Row6, ParameterSpec(0.0, 0.1, unit="rad, m", typical=3e-5, neutral=0.0)]
    tool: Tool | None = None
    """Which tool, for the frame TOOL."""

    def __post_init__(self) -> None:
        check_tool(self.frame, self.tool)

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Every axis by itself."""
        drawn = no_move_disturbance()
        drawn.screw[:, body_index(self.frame, self.tool)] = self.within * rng.uniform(-1.0, 1.0, 6)
        return drawn


@dataclass(frozen=True, slots=True)
class Windup(EachMove):
    """Friction inside a gear leaves it twisted, one way or the other."""

    joint: Joint
    within_rad: Annotated[float, ParameterSpec(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """The dead band of the gear shifted."""
        drawn = no_move_disturbance()
        drawn.gear_rad[self.joint] = _draw_uniform(rng, self.within_rad)
        return drawn


@dataclass(frozen=True, slots=True)
class ServoError(EachMove):
    """A motor comes to rest beside where its encoder says: lost counts, an ill-tuned controller."""

    joint: Joint
    within_rad: Annotated[float, ParameterSpec(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Set-points and readings off by the same angle."""
        drawn = no_move_disturbance()
        drawn.motor_rad[self.joint] = _draw_uniform(rng, self.within_rad)
        return drawn


def _draw_uniform(rng: np.random.Generator, most: float) -> Array:
    return np.asarray(rng.uniform(-most, most))
