"""Frames that do not stand where the drawing has them."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from fsw.dictionary.joints import Frame, Tool
from fsw.dictionary.params import Params, Row6
from fsw.kinematics.arm import transform6, transform6_from
from fsw.kinematics.transforms import Array, rigid, screw_exp
from sim.effects.effect import Effect

_BODY_OF = ("arm1", "link2", "link3", "link4", "link5", "turret")


@dataclass(frozen=True, slots=True)
class FrameError(Effect):
    """A frame displaced by a small screw in its own axes: rx, ry, rz [rad], tx, ty, tz [m]."""

    frame: Frame
    screw: Row6
    tool: Tool | None = None
    """Which tool, for the frame TOOL."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Displace the body that stands for the frame."""
        body = spec.body(self._body())
        X = rigid(_rotation(body.quat), body.pos) @ screw_exp(np.array(self.screw))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, X[:3, :3].ravel())
        body.pos, body.quat = X[:3, 3], quat

    def on_params(self, params: Params) -> Params:
        """The six numbers of the displaced link transform."""
        if self.frame is Frame.TOOL:
            name = self._body()
            old = getattr(params.tools, name)
            new = transform6_from(transform6(old) @ screw_exp(np.array(self.screw)))
            return replace(params, tools=replace(params.tools, **{name: new}))
        name = self.frame.name.lower()
        link = getattr(params.links, name)
        new = transform6_from(transform6(link.transform) @ screw_exp(np.array(self.screw)))
        return replace(params, links=replace(params.links, **{name: replace(link, transform=new)}))

    def _body(self) -> str:
        if self.frame is not Frame.TOOL:
            return _BODY_OF[self.frame]
        if self.tool is None:
            raise ValueError("a FrameError at TOOL names its tool")
        return self.tool.name.lower()


def _rotation(quat: Array) -> Array:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quat)
    return R.reshape(3, 3)
