"""Drawing of the arm as a MuJoCo specification carries it: tools, thermal expansion, lengths of the links.

MuJoCo has no field for expansion, so `attach_drawing` adds it as custom data, which does not change motion.
"""

from collections.abc import Iterable

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params
from fsw.dictionary.types import Row6, row6
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array
from sim.disturbance import LINK_BODIES

TURRET = "turret"


def attach_drawing(spec: mujoco.MjSpec, params: Params) -> None:
    """Add expansion and length of each link and tool of the drawing to a specification."""
    links = zip(LINK_BODIES, params.links.in_order(), strict=True)
    for body, link in links:
        X = transform6_to_pose(link.transform)
        _add_numeric(spec, f"expansion_{body}", link.expansion_1_K)
        _add_numeric(spec, f"length_{body}", X.R.T @ X.p)
    for tool in params.tools:
        _add_numeric(spec, f"expansion_{tool.name.lower()}", tool.expansion_1_K)


def expansion_of(spec: mujoco.MjSpec, body: str) -> Row6:
    """Return the expansion per kelvin of the link or tool that a frame body ends, in axes of its frame."""
    return row6(_read_numeric(spec, f"expansion_{body}"))


def length_of(spec: mujoco.MjSpec, frame: Frame) -> Array:
    """Return the link that ends in a frame, from start to end [m], shape (3,), in axes of its end."""
    return _read_numeric(spec, f"length_{LINK_BODIES[frame]}")


def tools_of(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Return the names of the tools: the bodies on the turret."""
    return tuple(body.name.upper() for body in spec.body(TURRET).bodies)


def _add_numeric(spec: mujoco.MjSpec, name: str, values: Iterable[float]) -> None:
    data = np.array(values, float)
    spec.add_numeric(name=name, size=data.size, data=data)


def _read_numeric(spec: mujoco.MjSpec, name: str) -> Array:
    return np.array(spec.numeric(name).data)
