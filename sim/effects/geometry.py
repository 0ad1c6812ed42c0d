"""Effects on frames: displacement, play, length and angle of links and tools, thermal growth and bending."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import LinkParams, Params, PointMass, ToolParams, Transform6
from fsw.dictionary.types import Row6, ToolName, row6, vector3
from fsw.kinematics.arm import pose_to_transform6, transform6_to_pose
from fsw.kinematics.transforms import Array, Pose, inverse, rotation_z, screw_exp
from sim.effects.effect import (
    EachMove,
    Effect,
    Factor,
    ParameterSpec,
    SmallAngle,
    SmallLength,
    TemperatureRise,
    link_of,
    params_with_effects,
    rotate_matrix,
    with_link,
)
from sim.record import LINK_BODIES, MoveDisturbance, frame_body, no_move_disturbance
from sim.world import displace, expansion_of, length_of, scale_expansion, tools_of


@dataclass(frozen=True, slots=True)
class FrameError(Effect):
    """Displacement of a frame by a small screw in its own axes: rx, ry, rz [rad], tx, ty, tz [m]."""

    frame: Frame
    screw: Annotated[Row6, ParameterSpec(-0.1, 0.1, unit="rad, m", typical=2e-3, neutral=0.0)]
    tool: ToolName | None = None
    """Tool, if the frame is TOOL."""

    def __post_init__(self) -> None:
        check_tool(self.frame, self.tool)

    def on_model(self, spec: mujoco.MjSpec) -> None:
        displace(spec.body(self._body()), np.array(self.screw))

    def on_params(self, params: Params) -> Params:
        if self.frame is Frame.TOOL:
            return _with_tool(params, self.tool, lambda tool: {"transform": self._displaced(tool.transform)})
        link = link_of(params, self.frame)
        changed = self._with_fixed_lumps(link, replace(link, transform=self._displaced(link.transform)))
        return with_link(params, self.frame, changed)

    def _with_fixed_lumps(self, old: LinkParams, new: LinkParams) -> LinkParams:
        """Return the link with its spring and lumps at their place in the plant.

        The spring and bracket of the rover, and the mass of the turret, move with their frame.
        The other springs and lumps stay.
        The link frame of flight software turns with theta, so that a change of theta is taken back.
        """
        theta = np.array(old.transform.theta_rad - new.transform.theta_rad)
        back = Pose(rotation_z(theta), np.zeros(3))
        spring = far = back
        if self.frame in (Frame.ARM1, Frame.ARM6):
            far = back @ transform6_to_pose(new.transform) @ inverse(transform6_to_pose(old.transform))
        if self.frame is Frame.ARM1:
            spring = far
        return replace(
            new,
            elastic_centre_m=vector3(spring.R @ np.array(old.elastic_centre_m) + spring.p),
            compliance=rotate_matrix(old.compliance, spring.R),
            near=_transform_lump(old.near, back),
            far=_transform_lump(old.far, far),
        )

    def _displaced(self, transform: Transform6) -> Transform6:
        return pose_to_transform6(transform6_to_pose(transform) @ screw_exp(np.array(self.screw)))

    def _body(self) -> str:
        return frame_body(self.frame, self.tool)


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
class Expansion(Effect):
    """Factor on the thermal expansion of the link that ends in a frame; it shows at other temperatures."""

    frame: Frame
    factor: Factor
    tool: ToolName | None = None
    """Tool, if the frame is TOOL."""

    def __post_init__(self) -> None:
        check_tool(self.frame, self.tool)

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the expansion; the link grows when all effects are known."""
        scale_expansion(spec, frame_body(self.frame, self.tool), self.factor)

    def on_params(self, params: Params) -> Params:
        if self.frame is Frame.TOOL:
            return _with_tool(params, self.tool, self._scaled)
        link = link_of(params, self.frame)
        return with_link(params, self.frame, replace(link, **self._scaled(link)))

    def _scaled(self, part: LinkParams | ToolParams) -> dict[str, Any]:
        return {"expansion_1_K": row6(self.factor * np.array(part.expansion_1_K))}


@dataclass(frozen=True, slots=True)
class LinkWarming(Effect):
    """Thermal growth of the link that ends in a frame beyond that of the arm's temperature."""

    frame: Frame
    warming_K: TemperatureRise
    tool: ToolName | None = None
    """Tool, if the frame is TOOL."""

    def __post_init__(self) -> None:
        check_tool(self.frame, self.tool)

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Displace the frame by the growth, in its own axes."""
        self._frame_error(expansion_of(spec, frame_body(self.frame, self.tool))).on_model(spec)

    def on_params(self, params: Params) -> Params:
        if not self.warming_K:
            return params
        if self.frame is not Frame.TOOL:
            return self._frame_error(link_of(params, self.frame).expansion_1_K).on_params(params)
        tool = next(tool for tool in params.tools if tool.name == self.tool)
        return self._frame_error(tool.expansion_1_K).on_params(params)

    def _frame_error(self, expansion_1_K: Row6) -> FrameError:
        return FrameError(self.frame, row6(self.warming_K * np.array(expansion_1_K)), self.tool)


@dataclass(frozen=True, slots=True)
class Warming(Effect):
    """Thermal growth of every link and tool above the temperature that their sensor tells."""

    warming_K: TemperatureRise

    def on_model(self, spec: mujoco.MjSpec) -> None:
        for part in self._parts(tools_of(spec)):
            part.on_model(spec)

    def on_params(self, params: Params) -> Params:
        return params_with_effects(self._parts(params.tool_names), params)

    def _parts(self, tools: Iterable[str]) -> list[LinkWarming]:
        links = [LinkWarming(frame, self.warming_K) for frame in Frame if frame is not Frame.TOOL]
        return links + [LinkWarming(Frame.TOOL, self.warming_K, tool) for tool in tools]


def check_tool(frame: Frame, tool: ToolName | None) -> None:
    """Check that a tool is given if, and only if, the frame is TOOL; ValueError if not."""
    if frame is Frame.TOOL and tool is None:
        raise ValueError("tool: an effect at frame tool names its tool; write tool.NAME")
    if frame is not Frame.TOOL and tool is not None:
        raise ValueError(f"tool: frame {frame.name.lower()} has none; leave it out")


def _transform_lump(lump: PointMass, X: Pose) -> PointMass:
    return replace(lump, com_m=vector3(X.R @ np.array(lump.com_m) + X.p))


def _with_tool(
    params: Params, name: ToolName | None, change: Callable[[ToolParams], dict[str, Any]]
) -> Params:
    """Return the parameters with some of those of one tool changed."""
    tools = (replace(tool, **change(tool)) if tool.name == name else tool for tool in params.tools)
    return replace(params, tools=tuple(tools))


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
        self.error().on_model(spec)

    def on_params(self, params: Params) -> Params:
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
        self._error(length_of(spec, self.frame), expansion_of(spec, LINK_BODIES[self.frame])).on_model(spec)

    def on_params(self, params: Params) -> Params:
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
