"""How many numbers the arrays of a packet hold; the annotations do not say."""

from typing import Final

from fsw.dictionary.joints import Joint, Switch, Tool
from sim.truth import Truth

N_JOINTS: Final = len(Joint)

SHAPES: Final[dict[str, tuple[int, ...]]] = {
    "switch_closed": (len(Switch),),
    "gravity_R_m_s2": (3,),
    "p_RoTo_R_m": (3,),
    "R_RT": (3, 3),
}
"""By the name of a field; any other array has a number for each joint."""


def shape_of(packet: type, name: str) -> tuple[int, ...]:
    """The shape of an array of a packet; the truth has the frames of all tools."""
    shape = SHAPES.get(name, (N_JOINTS,))
    return (len(Tool), *shape) if packet is Truth and name in ("p_RoTo_R_m", "R_RT") else shape
