"""Effects of inertia and geometry: armature, payload, numbers of a link, and the direction of gravity."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from simgap.arrays import Array, Flags
from simgap.effects.effect import AddedNumber, Effect, Family, Fields, Size
from simgap.robot import Robot


@dataclass(frozen=True, slots=True)
class Armature(AddedNumber):
    """Inertia of the rotor, seen at the joint, beside that of the model."""

    name: ClassVar[str] = "armature"
    family: ClassVar[Family] = Family.INERTIA
    number: ClassVar[str] = "armature_kgm2"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Inertia: at most what takes the whole torque at the highest acceleration, at least none at all."""
        scale = self.scales.torque_Nm / self.scales.acceleration_rad_s2
        return (self.size_of("armature_kgm2", -self.nominal, scale, 0.05 * scale),)


@dataclass(frozen=True, slots=True)
class Payload(Effect):
    """Point mass fixed to the link of a joint, such as a tool that the model does not have."""

    name: ClassVar[str] = "payload"
    family: ClassVar[Family] = Family.INERTIA
    place: str
    site: str
    """Site from which the mass is displaced; empty: the centre of mass of the link."""
    typical_kg: float
    high_kg: float
    reach_m: float
    """Largest displacement along an axis of the site."""
    axes: str = "xyz"
    """Axes of the site along which a displacement can be seen."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Mass, and its centre along the axes of the site; a fifth of the reach is worth a name."""
        mass = Size("payload_kg", 0.0, self.high_kg, self.typical_kg)
        return (
            mass,
            *(Size(f"{axis}_m", -self.reach_m, self.reach_m, 0.2 * self.reach_m) for axis in self.axes),
        )

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add the point mass to mass, centre and inertia of the body."""
        rows = np.asarray(size[:, 0] != 0)
        if not rows.any():
            return
        model, added_kg, at_m = fields.batch.model, size[rows, 0], np.zeros((int(rows.sum()), 3))
        at_m[:, ["xyz".index(axis) for axis in self.axes]] = size[rows, 1:]
        body = _body(fields, robot, self.place)
        if self.site:
            site = model.site(self.site).id
            body = int(model.site_bodyid[site])
            axes = Rotation.from_quat(model.site_quat[site], scalar_first=True)
            at_m = model.site_pos[site] + axes.apply(at_m)
        else:
            at_m = fields.batch.expand("body_ipos")[rows, body] + at_m
        _add_point_mass(fields, body, rows, added_kg, at_m)


@dataclass(frozen=True, slots=True)
class LinkMass(Effect):
    """Mass of a link with the density changed: its inertia grows in proportion, its centre stays."""

    name: ClassVar[str] = "link mass"
    family: ClassVar[Family] = Family.INERTIA
    place: str
    nominal_kg: float

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Mass above that of the model; 10 % is worth a name, half the mass may be missing."""
        return (Size("added_mass_kg", -0.5 * self.nominal_kg, 2.0 * self.nominal_kg, 0.1 * self.nominal_kg),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Scale mass and inertia."""
        rows, body = size[:, 0] != 0, _body(fields, robot, self.place)
        mass_kg, inertia_kgm2 = fields.batch.expand("body_mass"), fields.batch.expand("body_inertia")
        factor = 1 + size[rows, 0] / mass_kg[rows, body]
        mass_kg[rows, body] *= factor
        inertia_kgm2[rows, body] *= factor[:, None]


@dataclass(frozen=True, slots=True)
class LinkCentre(Effect):
    """Centre of mass of a link, displaced in the plane that its joint turns.

    Displaced along the joint axis it changes no torque at this joint, so there is no size for it.
    """

    name: ClassVar[str] = "link centre"
    family: ClassVar[Family] = Family.INERTIA
    place: str
    length_m: float
    """Length of the link: scale of the sizes."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Displacement away from the joint axis, and around it; 5 % of the length is worth a name."""
        bound_m, typical_m = 0.5 * self.length_m, 0.05 * self.length_m
        return (
            Size("outward_m", -bound_m, bound_m, typical_m),
            Size("sideward_m", -bound_m, bound_m, typical_m),
        )

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Displace the centre; the inertia about the centre stays."""
        rows = np.asarray(size.any(axis=1))
        if not rows.any():
            return
        body = _body(fields, robot, self.place)
        centre_m = fields.batch.expand("body_ipos")
        centre_m[rows, body] += size[rows] @ _outward_and_sideward(fields, robot, self.place)
        _drop_shortcuts(fields, body, rows)


@dataclass(frozen=True, slots=True)
class LinkInertia(Effect):
    """Inertia of a link about its centre, the same about each axis.

    At a single joint it equals armature; further joints that turn the same link tell them apart.
    """

    name: ClassVar[str] = "link inertia"
    family: ClassVar[Family] = Family.INERTIA
    place: str
    low_kgm2: float
    """Most that can be taken away: minus the smallest principal inertia."""
    joint_kgm2: float
    """Inertia that the joint moves: scale of the size."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Inertia above that of the model; 10 % of what the joint moves is worth a name."""
        return (Size("added_inertia_kgm2", self.low_kgm2, 2.0 * self.joint_kgm2, 0.1 * self.joint_kgm2),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add to the principal inertias."""
        rows = size[:, 0] != 0
        fields.batch.expand("body_inertia")[rows, _body(fields, robot, self.place)] += size[rows]


def _body(fields: Fields, robot: Robot, place: str) -> int:
    model = fields.batch.model
    return int(model.jnt_bodyid[model.joint(robot.mjcf_joint(place)).id])


def _outward_and_sideward(fields: Fields, robot: Robot, place: str) -> Array:
    """Return two unit vectors in the body frame, (2, 3): from the joint axis to the centre, and across."""
    model = fields.batch.model
    k, body = model.joint(robot.mjcf_joint(place)).id, _body(fields, robot, place)
    axis = np.array(model.jnt_axis[k])
    arm_m = model.body_ipos[body] - model.jnt_pos[k]
    arm_m = arm_m - axis * (axis @ arm_m)
    if np.linalg.norm(arm_m) < 1e-9:  # centre on the axis: any direction across it is outward
        arm_m = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    outward = arm_m / np.linalg.norm(arm_m)
    return np.array((outward, np.cross(axis, outward)))


def _add_point_mass(fields: Fields, body: int, rows: Flags, added_kg: Array, at_m: Array) -> None:
    """Combine a body with a point mass: centre, inertia about the new centre, and its principal axes."""
    batch = fields.batch
    mass_kg, centre_m = batch.expand("body_mass"), batch.expand("body_ipos")
    inertia_kgm2, axes = batch.expand("body_inertia"), batch.expand("body_iquat")
    old_kg, old_m = mass_kg[rows, body], centre_m[rows, body]
    total_kg = old_kg + added_kg
    new_m = (old_kg[:, None] * old_m + added_kg[:, None] * at_m) / total_kg[:, None]
    rotation = Rotation.from_quat(axes[rows, body], scalar_first=True).as_matrix()
    tensor = np.einsum("nij,nj,nkj->nik", rotation, inertia_kgm2[rows, body], rotation)
    tensor += _about(old_kg, old_m - new_m) + _about(added_kg, at_m - new_m)
    principal, turned = np.linalg.eigh(tensor)
    turned[:, :, 2] *= np.sign(np.linalg.det(turned))[:, None]  # eigenvectors may be left-handed
    mass_kg[rows, body], centre_m[rows, body] = total_kg, new_m
    inertia_kgm2[rows, body], axes[rows, body] = (
        principal,
        Rotation.from_matrix(turned).as_quat(scalar_first=True),
    )
    _drop_shortcuts(fields, body, rows)


def _about(mass_kg: Array, offset_m: Array) -> Array:
    """Return the inertia of point masses, (n,), at offsets, (n, 3), from the origin: (n, 3, 3)."""
    square = np.einsum("ni,ni->n", offset_m, offset_m)
    outer = np.einsum("ni,nj->nij", offset_m, offset_m)
    return np.asarray(mass_kg[:, None, None] * (square[:, None, None] * np.eye(3) - outer))


def _drop_shortcuts(fields: Fields, body: int, rows: Flags) -> None:
    """Clear the flags with which MuJoCo skips terms for a body whose centre is on its frame."""
    model, batch = fields.batch.model, fields.batch
    batch.expand("body_simple")[rows, body] = 0
    if model.body_simple[body]:
        first, number = int(model.body_dofadr[body]), int(model.body_dofnum[body])
        batch.expand("dof_simplenum")[rows, : first + number] = 0


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
        body = int(model.jnt_bodyid[model.joint(robot.mjcf_joint(self.next_joint)).id])
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
    """Return two unit vectors, (2, 3), across gravity (3,): x and y of the world where gravity is along z."""
    down = gravity_m_s2 / np.linalg.norm(gravity_m_s2)
    first = np.eye(3)[0] if abs(down[0]) < 0.9 else np.eye(3)[1]
    first = first - down * (down @ first)
    first /= np.linalg.norm(first)
    return np.array((first, np.cross(-down, first)))
