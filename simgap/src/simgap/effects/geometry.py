"""Effects of geometry: length of a link, and the direction of gravity at the base."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, Family, Fields, Size
from simgap.effects.joint import mjcf_joint
from simgap.robot import Robot


@dataclass(frozen=True, slots=True)
class LinkLength(Effect):
    """Distance from a joint to the next one: the next body moves along the line between them."""

    name: ClassVar[str] = "link length"
    family: ClassVar[Family] = Family.GEOMETRY
    place: str
    next_joint: str
    length_m: float

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Length above that of the model; 2 % is worth a name."""
        return (Size("added_length_m", -0.5 * self.length_m, 0.5 * self.length_m, 0.02 * self.length_m),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Move the frame of the next body."""
        model = fields.batch.model
        body = int(model.jnt_bodyid[model.joint(mjcf_joint(robot, self.next_joint)).id])
        rows = size[:, 0] != 0
        along = model.body_pos[body] / np.linalg.norm(model.body_pos[body])
        fields.batch.expand("body_pos")[rows, body] += size[rows] * along


@dataclass(frozen=True, slots=True)
class GravityDirection(Effect):
    """Base that is not level: gravity is tilted about two axes across it."""

    name: ClassVar[str] = "gravity direction"
    family: ClassVar[Family] = Family.GEOMETRY
    place: str

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Tilts; 0.02 rad is a base that was set up by eye, 0.5 rad would be seen."""
        return (Size("tilt_first_rad", -0.5, 0.5, 0.02), Size("tilt_second_rad", -0.5, 0.5, 0.02))

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Turn the vector of gravity by the rotation vector of both tilts."""
        rows = size.any(axis=1)
        gravity_m_s2 = fields.batch.expand("opt.gravity")
        nominal = np.array(fields.batch.model.opt.gravity)
        turn = size[rows] @ level_axes(nominal)
        angle_rad = np.linalg.norm(turn, axis=1)[:, None]
        axis = turn / angle_rad
        gravity_m_s2[rows] = nominal * np.cos(angle_rad) + np.cross(axis, nominal) * np.sin(angle_rad)


def level_axes(gravity_m_s2: Array) -> Array:
    """Return two unit vectors across gravity: x and y of the world where gravity is along z.

    Args:
        gravity_m_s2: Vector of gravity, (3,), in m/s2.

    Returns:
        Unit vectors, (2, 3).
    """
    down = gravity_m_s2 / np.linalg.norm(gravity_m_s2)
    first = np.eye(3)[0] if abs(down[0]) < 0.9 else np.eye(3)[1]
    first = first - down * (down @ first)
    first /= np.linalg.norm(first)
    return np.array((first, np.cross(-down, first)))
