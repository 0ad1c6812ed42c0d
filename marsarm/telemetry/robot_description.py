"""URDF of a recorded run, from which viewers draw the arm: frames, joints and visible shapes."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from fsw.kinematics.transforms import Array, Pose

DIGITS: Final = 9
"""Decimal places of metres and radians."""


ROBOT_NAME: Final = "marsarm"
"""Name of the robot, under which Rerun lists the shapes."""
ROOT_FRAME: Final = "map"
"""Root frame: RMECH turned so that z is up, as 3D panels expect."""
ROVER_FRAME: Final = "rover"
"""Frame of the rover, RMECH."""
TURRET_FRAME: Final = "arm6"


class Visual(NamedTuple):
    """Shape that a viewer draws in a frame; a cylinder lies along z."""

    shape: str
    """`box`, `cylinder` or `sphere`."""
    size_m: tuple[float, ...]
    """Three sides; radius and length; radius."""
    X: Pose
    """Pose in the frame."""
    rgba: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnScene:
    """Visible shapes by frame, and the frames that stand still beside the arm, in the root frame."""

    visuals: Mapping[str, tuple[Visual, ...]]
    frames: Mapping[str, Pose]


class FixedFrame(NamedTuple):
    """Frame that does not move in its parent."""

    parent: str
    child: str
    X: Pose


class TurningFrame(NamedTuple):
    """Frame that a joint turns about z of its parent."""

    joint: str
    parent: str
    child: str
    zero_rad: float
    """Turn of the frame at zero angle of the joint."""
    min_rad: float
    max_rad: float
    speed_rad_s: float
    torque_Nm: float

    def at(self, angle_rad: float) -> tuple[float, ...]:
        """Return position and quaternion x, y, z, w in the parent at an angle of the joint."""
        half_rad = 0.5 * (self.zero_rad + angle_rad)
        return 0.0, 0.0, 0.0, 0.0, 0.0, math.sin(half_rad), math.cos(half_rad)


def robot_description(
    fixed: Sequence[FixedFrame],
    turning: Sequence[TurningFrame],
    visuals: Mapping[str, Sequence[Visual]],
) -> str:
    """Return the URDF of the frames of a log and the shapes in them.

    Args:
        turning: Frames that joints turn; together with the fixed ones they are a tree.
        visuals: Shapes by frame.
    """
    robot = Element("robot", name=ROBOT_NAME)
    colours = list(dict.fromkeys(_numbers(one.rgba) for shapes in visuals.values() for one in shapes))
    for k, rgba in enumerate(colours):
        SubElement(SubElement(robot, "material", name=f"colour{k}"), "color", rgba=rgba)
    ends = [(still.parent, still.child) for still in fixed] + [(one.parent, one.child) for one in turning]
    for frame in dict.fromkeys(name for pair in ends for name in pair):
        link = SubElement(robot, "link", name=frame)
        for visual in visuals.get(frame, ()):
            _add_visual(link, visual, f"colour{colours.index(_numbers(visual.rgba))}")
    for still in fixed:
        joint = SubElement(robot, "joint", name=f"{still.parent}_{still.child}", type="fixed")
        _add_origin(joint, still.X.p, roll_pitch_yaw(still.X.R))
        _add_ends(joint, still.parent, still.child)
    for one in turning:
        joint = SubElement(robot, "joint", name=one.joint, type="revolute")
        _add_origin(joint, (0.0, 0.0, 0.0), (0.0, 0.0, one.zero_rad))
        _add_ends(joint, one.parent, one.child)
        SubElement(joint, "axis", xyz="0 0 1")
        bounds = {"lower": one.min_rad, "upper": one.max_rad}
        rates = {"effort": one.torque_Nm, "velocity": one.speed_rad_s}
        SubElement(joint, "limit", {key: _numbers((value,)) for key, value in (bounds | rates).items()})
    indent(robot, "")
    return tostring(robot, encoding="unicode")


def _add_visual(link: Element, one: Visual, colour: str) -> None:
    visual = SubElement(link, "visual")
    _add_origin(visual, one.X.p, roll_pitch_yaw(one.X.R))
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}[one.shape]
    values = [one.size_m] if len(keys) == 1 else [(size,) for size in one.size_m]
    sizes = {key: _numbers(value) for key, value in zip(keys, values, strict=True)}
    SubElement(SubElement(visual, "geometry"), one.shape, sizes)
    SubElement(visual, "material", name=colour)


def _add_origin(part: Element, p_m: Iterable[float], rpy_rad: Iterable[float]) -> None:
    SubElement(part, "origin", xyz=_numbers(p_m), rpy=_numbers(rpy_rad))


def _add_ends(joint: Element, parent: str, child: str) -> None:
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)


def _numbers(values: Iterable[float]) -> str:
    """Write numbers without noise in the last bits, which would differ between machines."""
    return " ".join(repr(round(float(value), DIGITS) + 0.0) for value in values)


def roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Convert a rotation to roll, pitch and yaw: turns about fixed x, then y, then z.

    Args:
        R: Rotation matrix, shape (3, 3).

    Returns:
        Angles in radians. At a pitch of a right angle only yaw less roll is defined; yaw is zero there.
    """
    (r00, _, _), (r10, r11, r12), (r20, r21, r22) = R.tolist()
    cosine = math.hypot(r00, r10)
    pitch = math.atan2(-r20, cosine)
    if cosine < 10**-DIGITS:
        return math.atan2(-r12, r11), pitch, 0.0
    return math.atan2(r21, r22), pitch, math.atan2(r10, r00)
