"""Length and angle errors of links and tools along one axis, and thermal bending of links."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params
from fsw.dictionary.types import Row6, ToolName, row6
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array
from sim.disturbance import LINK_BODIES
from sim.drawing import expansion_of, length_of
from sim.effects.effect import Effect, ParameterSpec, SmallAngle, SmallLength
from sim.effects.flight_params import link_of
from sim.effects.geometry import FrameError

Axis = Literal["x", "y", "z"]
AXIS_NAMES: Final = ("x", "y", "z")
WIDTH_M: Final = 0.1
"""Assumed width of a link between its warm and its cold side."""
LIES_ALONG: Final = {Frame.ARM1: "x", Frame.ARM2: "x", Frame.ARM3: "x", Frame.ARM4: "x", Frame.ARM6: "z"}
"""Axis of the end frame along which a link lies, within 26 degrees; link 5 lies askew."""


@dataclass(frozen=True, slots=True)
class _FrameEffect(Effect):
    """Effect that is the error of one frame."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Displace the frame."""
        self.error().on_model(spec)

    def on_params(self, params: Params) -> Params:
        """Set the numbers of the displaced link."""
        error = self.error()
        return error.on_params(params) if any(error.screw) else params

    def error(self) -> FrameError:
        """Return the effect as the error of a frame."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class LinkLength(_FrameEffect):
    """Added length of the link that ends in a frame, along an axis of that frame."""

    frame: Frame
    axis: Axis
    length_m: SmallLength

    def __post_init__(self) -> None:
        _refuse_tool(self.frame, "tool-offset")

    def error(self) -> FrameError:
        """Return a translation."""
        return FrameError(self.frame, row6(self.length_m * _shift(self.axis)))


@dataclass(frozen=True, slots=True)
class LinkAngle(_FrameEffect):
    """Rotation of the link that ends in a frame, about an axis of that frame."""

    frame: Frame
    axis: Axis
    angle_rad: SmallAngle

    def __post_init__(self) -> None:
        _refuse_tool(self.frame, "tool-turn")

    def error(self) -> FrameError:
        """Return a rotation."""
        return FrameError(self.frame, row6(self.angle_rad * _turn(self.axis)))


@dataclass(frozen=True, slots=True)
class ToolOffset(_FrameEffect):
    """Translation of a tool along an axis of its frame."""

    tool: ToolName
    axis: Axis
    offset_m: SmallLength

    def error(self) -> FrameError:
        """Return a translation."""
        return FrameError(Frame.TOOL, row6(self.offset_m * _shift(self.axis)), self.tool)


@dataclass(frozen=True, slots=True)
class ToolTurn(_FrameEffect):
    """Rotation of a tool about an axis of its frame."""

    tool: ToolName
    axis: Axis
    angle_rad: SmallAngle

    def error(self) -> FrameError:
        """Return a rotation."""
        return FrameError(Frame.TOOL, row6(self.angle_rad * _turn(self.axis)), self.tool)


@dataclass(frozen=True, slots=True)
class ThermalGradient(Effect):
    """Bending of the link that ends in a frame, about an axis of that frame, by a warmer side.

    The link bends to an arc. Its end turns by the difference of growth over the width.
    It shifts by half that angle times the length.

    Raises:
        ValueError: the link is parallel to the axis.
    """

    frame: Frame
    axis: Axis
    gradient_K: Annotated[float, ParameterSpec(-50.0, 50.0, unit="K", typical=5.0, neutral=0.0)]

    def __post_init__(self) -> None:
        _refuse_tool(self.frame, "tool-turn")
        if LIES_ALONG.get(self.frame) == self.axis:
            others = " and ".join(other for other in AXIS_NAMES if other != self.axis)
            raise ValueError(
                f"axis: {self.frame.name.lower()} lies along {self.axis}; it bends about {others}"
            )

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Displace the frame at the end of the link."""
        self._error(length_of(spec, self.frame), expansion_of(spec, LINK_BODIES[self.frame])).on_model(spec)

    def on_params(self, params: Params) -> Params:
        """Set the numbers of the bent link."""
        link = link_of(params, self.frame)
        X = transform6_to_pose(link.transform)
        return self._error(X.R.T @ X.p, link.expansion_1_K).on_params(params) if self.gradient_K else params

    def _error(self, p: Array, expansion_1_K: Row6) -> FrameError:
        """Return the rotation and the translation of the end of a link p [m], (3,), in axes of its end."""
        growth_K = np.array(expansion_1_K[3:])
        axis = np.array([self.axis == other for other in AXIS_NAMES], float)
        turn = self.gradient_K / WIDTH_M * float(np.linalg.norm(np.cross(axis, growth_K))) * axis
        return FrameError(self.frame, row6(np.concatenate([turn, 0.5 * np.cross(turn, p)])))


def _shift(axis: Axis) -> Array:
    return np.array([0.0, 0.0, 0.0, *(axis == other for other in AXIS_NAMES)])


def _turn(axis: Axis) -> Array:
    return np.array([*(axis == other for other in AXIS_NAMES), 0.0, 0.0, 0.0])


def _refuse_tool(frame: Frame, instead: str) -> None:
    if frame is Frame.TOOL:
        raise ValueError(f"frame: tool is no link; take {instead}, which names the tool")
