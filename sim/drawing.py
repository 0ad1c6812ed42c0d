"""Drawing of the arm as a MuJoCo specification carries it: tools, thermal expansion, lengths of the links.

MuJoCo has no field for expansion. `attach_drawing` puts it into the comment of the specification, which the
compiler leaves out of the model.
"""

import json
from typing import Final

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params
from fsw.dictionary.types import Row6, row6
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array, Pose, screw_exp
from sim.disturbance import LINK_BODIES

TURRET: Final = "turret"
WARM_C: Final = 20.0
"""Temperature of an arm for which no effect sets another."""


def attach_drawing(spec: mujoco.MjSpec, params: Params) -> None:
    """Add the temperature of the drawing, and expansion and length of its parts, to a specification."""
    expansion = {tool.name: tool.expansion_1_K for tool in params.tools}
    length = {}
    for body, link in zip(LINK_BODIES, params.links.in_order(), strict=True):
        X = transform6_to_pose(link.transform)
        expansion[body] = link.expansion_1_K
        length[body] = (X.R.T @ X.p).tolist()
    drawn = {"temperature_C": params.heat.calibration_C, "expansion_1_K": expansion, "length_m": length}
    spec.comment = json.dumps(drawn)


def expansion_of(spec: mujoco.MjSpec, body: str) -> Row6:
    """Return the expansion per kelvin of the link or tool that a frame body ends, in axes of its frame."""
    return row6(json.loads(spec.comment)["expansion_1_K"][body])


def scale_expansion(spec: mujoco.MjSpec, body: str, factor: float) -> None:
    """Scale the expansion of the link or tool that a frame body ends."""
    drawn = json.loads(spec.comment)
    drawn["expansion_1_K"][body] = [factor * value for value in drawn["expansion_1_K"][body]]
    spec.comment = json.dumps(drawn)


def grow(spec: mujoco.MjSpec, temperature_C: float) -> None:
    """Displace the frame at the end of each link and tool by its growth to a temperature."""
    drawn = json.loads(spec.comment)
    warming_K = temperature_C - drawn["temperature_C"]
    for body, expansion_1_K in drawn["expansion_1_K"].items():
        displace(spec.body(body), warming_K * np.array(expansion_1_K))


def displace(body: mujoco.MjsBody, screw: Array) -> None:
    """Displace a body by a small screw in its own axes, rotation first [rad, m], shape (6,)."""
    if not screw.any():
        return
    R, quat = np.zeros(9), np.zeros(4)
    mujoco.mju_quat2Mat(R, body.quat)
    X = Pose(R.reshape(3, 3), body.pos) @ screw_exp(screw)
    mujoco.mju_mat2Quat(quat, X.R.ravel())
    body.pos, body.quat = X.p, quat


def length_of(spec: mujoco.MjSpec, frame: Frame) -> Array:
    """Return the link that ends in a frame, from start to end [m], shape (3,), in axes of its end."""
    return np.array(json.loads(spec.comment)["length_m"][LINK_BODIES[frame]])


def tools_of(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Return the names of the tools: the bodies on the turret."""
    return tuple(body.name for body in spec.body(TURRET).bodies)
