"""Disturbances that are drawn for each move, uniform within bounds."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import Row6, ToolName
from fsw.kinematics.transforms import Array
from sim.disturbance import MoveDisturbance, frame_body, no_move_disturbance
from sim.effects.effect import EachMove, ParameterSpec
from sim.effects.geometry import check_tool


@dataclass(frozen=True, slots=True)
class FramePlay(EachMove):
    """Displacement of a frame within plus or minus a screw in its axes: rx, ry, rz [rad], tx, ty, tz [m].

    Causes are play of the assembly, wobble of a bearing, and hysteresis of the isolators under an instrument.
    """

    frame: Frame
    within: Annotated[Row6, ParameterSpec(0.0, 0.1, unit="rad, m", typical=3e-5, neutral=0.0)]
    tool: ToolName | None = None
    """Tool, if the frame is TOOL."""

    def __post_init__(self) -> None:
        check_tool(self.frame, self.tool)

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Draw every axis independently."""
        screw = np.array(self.within) * rng.uniform(-1.0, 1.0, 6)
        return replace(no_move_disturbance(), screws={frame_body(self.frame, self.tool): screw})


@dataclass(frozen=True, slots=True)
class Windup(EachMove):
    """Twist of a gear at rest, of either sign, from friction inside it."""

    joint: Joint
    within_rad: Annotated[float, ParameterSpec(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Draw a shift of the dead band of the gear."""
        drawn = no_move_disturbance()
        drawn.gear_rad[self.joint] = _draw_uniform(rng, self.within_rad)
        return drawn


@dataclass(frozen=True, slots=True)
class ServoError(EachMove):
    """Error of a motor angle at rest against its encoder, from lost counts or a badly tuned controller."""

    joint: Joint
    within_rad: Annotated[float, ParameterSpec(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Draw an angle that shifts set-points and readings alike."""
        drawn = no_move_disturbance()
        drawn.motor_rad[self.joint] = _draw_uniform(rng, self.within_rad)
        return drawn


def _draw_uniform(rng: np.random.Generator, bound: float) -> Array:
    return np.asarray(rng.uniform(-bound, bound))
