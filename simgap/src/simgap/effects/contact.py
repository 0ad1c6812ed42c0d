"""Contact of the tool with a horizontal plane, such as the table that the model does not have."""

from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco

from simgap.arrays import Array
from simgap.effects.effect import Effect, Family, Fields, Size
from simgap.robot import Robot

PLANE: Final = "contact plane of the diagnosis"
TIP: Final = "contact tip of the diagnosis"
TIP_RADIUS_M: Final = 1e-3
"""The site touches, so the tip is a point; MuJoCo needs a radius, by which the plane is lowered."""
BIT: Final = 1 << 30
"""Collision bit of plane and tip, which no other geom has: neither touches anything else."""
NEVER_TOUCHED_M: Final = 1e3
"""Depth of the plane at size 0: more than a robot reaches."""


@dataclass(frozen=True, slots=True)
class PlaneContact(Effect):
    """Hard, frictionless horizontal plane that stops the tool site; the place is the site.

    MuJoCo realisation: a plane in the world and a small sphere at the site, which collide with each other
    only. The reference time of the contact is two time steps, the shortest that is stable.
    """

    name: ClassVar[str] = "contact with a plane"
    family: ClassVar[Family] = Family.CONTACT
    place: str
    lowest_m: float
    """Lowest height that the commanded motion reaches with the site."""
    high_m: float
    """Largest size: the measured motion was never lower than the plane."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Height of the plane above the lowest commanded height; 1 cm of lost motion is worth a name."""
        return (Size("above_lowest_m", 0.0, self.high_m, min(0.01, self.high_m)),)

    def describe(self, size: Array) -> str:
        """Return the height of the plane in the world."""
        return f"plane at z = {(self.lowest_m + float(size[0])) * 1e3:.1f} mm"

    def vary(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add plane and tip; the plane is out of reach."""
        site = spec.site(self.place)
        common = {"condim": 1, "priority": 1, "mass": 0.0, "solimp": (0.99, 0.99, 1e-3, 0.5, 2.0)}
        common["solref"] = (2 * robot.model.opt.timestep, 1.0)
        spec.worldbody.add_geom(
            name=PLANE,
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(1.0, 1.0, 1.0),
            pos=(0.0, 0.0, -NEVER_TOUCHED_M),
            contype=BIT,
            conaffinity=0,
            **common,
        )
        site.parent.add_geom(
            name=TIP,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(TIP_RADIUS_M, 0.0, 0.0),
            pos=site.pos,
            contype=0,
            conaffinity=BIT,
            **common,
        )

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Put the plane at its height."""
        rows = size[:, 0] != 0
        plane = fields.batch.model.geom(PLANE).id
        fields.batch.expand("geom_pos")[rows, plane, 2] = self.lowest_m + size[rows, 0] - TIP_RADIUS_M
