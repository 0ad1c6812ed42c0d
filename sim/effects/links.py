"""Length and angle errors of links and tools along one axis, and thermal bending of links."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame, Tool
from fsw.dictionary.params import Params
from fsw.dictionary.types import row6
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array
from sim.effects.effect import Effect, ParameterSpec, SmallAngle, SmallLength
from sim.effects.flight_params import link_of
from sim.effects.geometry import FrameError
from sim.params import nominal_params

Axis = Literal["x", "y", "z"]
AXIS_NAMES: Final = ("x", "y", "z")
WIDTH_M: Final = 0.1
"""Assumed width of a link between its warm and its cold side."""
PARALLEL_COSINE: Final = 0.9
"""Cosine above which a link counts as parallel to an axis."""


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

    tool: Tool
    axis: Axis
    offset_m: SmallLength

    def error(self) -> FrameError:
        """Return a translation."""
        return FrameError(Frame.TOOL, row6(self.offset_m * _shift(self.axis)), self.tool)


@dataclass(frozen=True, slots=True)
class ToolTurn(_FrameEffect):
    """Rotation of a tool about an axis of its frame."""

    tool: Tool
    axis: Axis
    angle_rad: SmallAngle

    def error(self) -> FrameError:
        """Return a rotation."""
        return FrameError(Frame.TOOL, row6(self.angle_rad * _turn(self.axis)), self.tool)


@dataclass(frozen=True, slots=True)
class ThermalGradient(_FrameEffect):
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
        p, axis = self._along()[0], AXIS_NAMES.index(self.axis)
        if abs(p[axis]) > PARALLEL_COSINE * np.linalg.norm(p):
            others = " and ".join(other for other in AXIS_NAMES if other != self.axis)
            raise ValueError(
                f"axis: {self.frame.name.lower()} lies along {self.axis}; it bends about {others}"
            )

    def error(self) -> FrameError:
        """Return the rotation and the translation of the end of the link."""
        p, growth_K = self._along()
        axis = np.array([self.axis == other for other in AXIS_NAMES], float)
        turn = self.gradient_K / WIDTH_M * float(np.linalg.norm(np.cross(axis, growth_K))) * axis
        return FrameError(self.frame, row6(np.concatenate([turn, 0.5 * np.cross(turn, p)])))

    def _along(self) -> tuple[Array, Array]:
        """Return the link from start to end [m] and its growth [m/K], each (3,), in axes of its end."""
        link = link_of(nominal_params(), self.frame)
        X = transform6_to_pose(link.transform)
        return X.R.T @ X.p, np.array(link.expansion_1_K[3:])


def _shift(axis: Axis) -> Array:
    return np.array([0.0, 0.0, 0.0, *(axis == other for other in AXIS_NAMES)])


def _turn(axis: Axis) -> Array:
    return np.array([*(axis == other for other in AXIS_NAMES), 0.0, 0.0, 0.0])


def _refuse_tool(frame: Frame, instead: str) -> None:
    if frame is Frame.TOOL:
        raise ValueError(f"frame: tool is no link; take {instead}, which names the tool")
