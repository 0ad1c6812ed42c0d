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
from fsw.kinematics.transforms import Array
from sim.disturbance import LINK_BODIES

TURRET: Final = "turret"


def attach_drawing(spec: mujoco.MjSpec, params: Params) -> None:
    """Add expansion and length of each link and tool of the drawing to a specification."""
    expansion = {tool.name.lower(): tool.expansion_1_K for tool in params.tools}
    length = {}
    for body, link in zip(LINK_BODIES, params.links.in_order(), strict=True):
        X = transform6_to_pose(link.transform)
        expansion[body] = link.expansion_1_K
        length[body] = (X.R.T @ X.p).tolist()
    spec.comment = json.dumps({"expansion_1_K": expansion, "length_m": length})


def expansion_of(spec: mujoco.MjSpec, body: str) -> Row6:
    """Return the expansion per kelvin of the link or tool that a frame body ends, in axes of its frame."""
    return row6(json.loads(spec.comment)["expansion_1_K"][body])


def length_of(spec: mujoco.MjSpec, frame: Frame) -> Array:
    """Return the link that ends in a frame, from start to end [m], shape (3,), in axes of its end."""
    return np.array(json.loads(spec.comment)["length_m"][LINK_BODIES[frame]])


def tools_of(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Return the names of the tools: the bodies on the turret."""
    return tuple(body.name.upper() for body in spec.body(TURRET).bodies)
