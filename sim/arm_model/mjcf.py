"""MJCF of the plant of an arm and the hull of its rover, from its description and the looks of its parts.

A body linkK is frame ArmK turned by its joint: hinge axis +z, x along the link. A joint is two hinges in
series, the motor side and the gear side; their sum is the output angle. A body linkK_far is carried by the
elastic centre of the link. The names are the same for all arms.
"""

from collections.abc import Iterable
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from fsw.dictionary.params import Transform6
from fsw.dictionary.types import Vector3
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array
from sim.arm_model.description import ArmDescription, Hull, LinkDescription, Lump, Shape, move_shape
from sim.frames import FLIP, P_NR_M

DAMPING_S: Final = 0.005
"""Damping over stiffness of every spring; the first mode then has about 4 % of critical damping."""
DIGITS: Final = 12
"""Decimals of a difference of two lengths; its rounding errors are smaller."""
SCREW_AXES: Final = (
    ("rx", "1 0 0"),
    ("ry", "0 1 0"),
    ("rz", "0 0 1"),
    ("tx", "1 0 0"),
    ("ty", "0 1 0"),
    ("tz", "0 0 1"),
)
HULL: Final = "rover_hull"
"""Body of the hull."""
MATERIAL: Final = "arm_titanium"
"""Material of what looks and names no other; in DEFAULTS."""
SLIDES_FIRST: Final = (3, 4, 5, 0, 1, 2)
PAD_SITE_M: Final = 0.01
"""Radius of the touch site around a pad; it encloses its own pad and no other."""
DEFAULTS: Final = """
<default>
  <default class="arm">
    <joint type="hinge" axis="0 0 1"/>
    <site type="sphere" size="0.012" group="4"/>
    <geom mass="0"/>
    <default class="visual">
      <geom type="cylinder" contype="0" conaffinity="0" group="2" material="arm_titanium"/>
    </default>
    <default class="collision">
      <geom type="capsule" contype="1" conaffinity="2" group="3" rgba="0.2 0.7 1 0.4" friction="0.6"/>
      <default class="pad">
        <geom type="sphere" size="0.006" priority="1" solimp="0.1 0.1 0.001" friction="0.5"/>
      </default>
    </default>
    <default class="hull">
      <geom contype="2" conaffinity="1" group="3" rgba="1 0.5 0.2 0.3"/>
    </default>
    <equality solref="0.004 1" solimp="0.9999 0.9999 0.001"/>
    <default class="motor"><joint solreffriction="0.0004 1" solimpfriction="0.9999 0.9999 0.001"/></default>
    <default class="output"><tendon solreffriction="0.0004 1" solimpfriction="0.9999 0.9999 0.001"/></default>
  </default>
</default>
"""
OPTION: Final = """
<option timestep="0.005208333333333333" integrator="discrete" gravity="0 0 -3.711" tolerance="1e-12"
        cone="elliptic" impratio="1e6"><flag island="disable" midphase="disable"/></option>
"""


def arm_mjcf(arm: ArmDescription, hull: Hull, visual: str | None, shows_hull: bool) -> str:
    """Write the MJCF of an arm and of the hull of its rover.

    Args:
        visual: Looks: materials, and geoms by body; None to show the shapes for collisions instead.
        shows_hull: True to show the shapes of the hull, for a rover that looks do not draw.

    Returns:
        The MJCF; it opens by itself, and scenes include it.

    Raises:
        BadLooks: the looks are no XML, or of bodies that the arm does not have.
    """
    root = Element("mujoco", model=f"{arm.name}_arm")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    root.append(ElementTree.fromstring(OPTION))
    root.append(ElementTree.fromstring(DEFAULTS))
    looks = _Looks(visual)
    root.append(looks.materials)
    world = SubElement(root, "worldbody")
    rmech = SubElement(
        world, "body", name="rmech", pos=_numbers(FLIP * P_NR_M), quat="0 1 0 0", childclass="arm"
    )
    _add_bodies(arm, looks, rmech)
    looks.check_all_used(element.get("name", "") for element in rmech.iter("body"))
    _add_hull(hull, world, ("hull", "visual") if shows_hull else ("hull",))
    _add_tendons(arm, SubElement(root, "tendon"))
    _add_actuators(arm, SubElement(root, "actuator"))
    brakes = SubElement(root, "equality")
    for name in arm.joints.by_name():
        _add(brakes, "joint", "arm", name=f"{name}_brake", joint1=f"{name}_motor", active="false")
    sensors = SubElement(root, "sensor")
    for name in arm.switches:
        SubElement(sensors, "touch", name=name, site=name)
    ElementTree.indent(root, "  ")
    return ElementTree.tostring(root, encoding="unicode") + "\n"


class BadLooks(ValueError):
    """Looks that are refused."""


class _Looks:
    """Geoms of each body that only look."""

    def __init__(self, visual: str | None):
        try:
            root = Element("visual") if visual is None else ElementTree.fromstring(visual)
        except ElementTree.ParseError as error:
            raise BadLooks(f"is not XML: {error}") from error
        materials = root.find("asset")
        self.materials = Element("asset") if materials is None else materials
        if visual is None:
            SubElement(self.materials, "material", name=MATERIAL, rgba="0.72 0.73 0.75 1")
        if all(material.get("name") != MATERIAL for material in self.materials):
            raise BadLooks(f"asset: has no material {MATERIAL}, that of geoms without one")
        self._bodies = {body.get("name", ""): body for body in root.findall("body")}
        self.shows_shapes = visual is None

    def add_to(self, body: Element, shapes: Iterable[Shape]) -> None:
        """Add the looks of a body; without looks, its shapes."""
        for part in self._bodies.get(body.get("name", ""), ()):
            for geom in part.iter("geom"):
                geom.set("class", "visual")
            body.append(part)
        if self.shows_shapes:
            for shape in shapes:
                if shape.of != "plant":
                    _add_shape(body, shape, "visual")

    def check_all_used(self, bodies: Iterable[str]) -> None:
        """Refuse looks of bodies that the arm does not have."""
        there = list(bodies)
        unknown = sorted(set(self._bodies) - set(there))
        if unknown:
            raise BadLooks(f"body {unknown[0]!r} is not one of the arm; there are {', '.join(there)}")


def _add_bodies(arm: ArmDescription, looks: _Looks, rmech: Element) -> None:
    links, joints = arm.links.in_order(), list(arm.joints.by_name())
    rover = links[0]
    parent = _body(rmech, "arm1", rover.transform, (0.0, 0.0, 0.0))
    _add_spring(parent, "rover", rover)
    _add_mass(parent, rover.far, rover.elastic_centre_m)
    looks.add_to(parent, ())
    start, centre = Transform6(), (0.0, 0.0, 0.0)
    for k, (link, joint) in enumerate(zip(links[1:], joints, strict=True), start=1):
        body = _body(parent, f"link{k}", start, centre)
        actuator = arm.actuator_of(joint)
        motor = _add(body, "joint", "motor", name=f"{joint}_motor", armature=actuator.armature_kg_m2)
        _set(motor, frictionloss=actuator.friction_Nm, damping=actuator.damping_Nms_rad)
        SubElement(body, "joint", name=f"{joint}_gear")
        if link.near is not None:
            _add_mass(body, link.near, (0.0, 0.0, 0.0))
        shapes = arm.shapes.get(f"link{k}", ())
        looks.add_to(body, shapes)
        _add_shapes(body, shapes)
        if any(link.stiffness):
            centre = link.elastic_centre_m
            body = SubElement(body, "body", name=f"link{k}_far", pos=_numbers(centre))
            _add_spring(body, f"link{k}", link)
            _add_mass(body, link.far, centre)
            looks.add_to(body, ())
        else:
            centre = (0.0, 0.0, 0.0)
        parent, start = body, link.transform
    turret = _body(parent, "turret", start, centre)
    end = transform6_to_pose(start)
    far = links[-1].far
    com = end.R.T @ (np.array(far.com_m) - end.p)
    _add_mass(
        turret, Lump(far.mass_kg, (float(com[0]), float(com[1]), float(com[2])), far.inertia_kg_m2), centre
    )
    SubElement(turret, "site", name="arm6")
    looks.add_to(turret, arm.shapes["turret"])
    _add_shapes(turret, arm.shapes["turret"])
    for name in arm.tools:
        _add_tool(arm, name, looks, turret)


def _add_hull(hull: Hull, world: Element, kinds: Iterable[str]) -> None:
    """Add the shapes of the rover, in RNAV.

    They are a body of their own, because MuJoCo's broad phase goes through every geom of a body that has one
    that collides.
    """
    body = SubElement(world, "body", name=HULL, quat="0 1 0 0", childclass="arm")
    for kind in kinds:
        for part, shapes in hull.items():
            for k, shape in enumerate(shapes, start=1):
                geom = _add_shape(body, move_shape(shape, P_NR_M), kind)
                if kind == "hull":
                    geom.set("name", part if k == 1 else f"{part}_{k}")


def _add_tool(arm: ArmDescription, name: str, looks: _Looks, turret: Element) -> None:
    tool = arm.tools[name]
    body = _body(turret, name, tool.transform, (0.0, 0.0, 0.0))
    SubElement(body, "site", name=name)
    looks.add_to(body, arm.shapes[name])
    _add_shapes(body, arm.shapes[name])
    for pad, switch in arm.switches.items():
        if switch.tool == name:
            _add(body, "geom", "pad", name=f"{pad}_pad", solref=tool.pad_solref, pos=switch.p_m)
            _add(body, "site", name=pad, pos=switch.p_m, size=PAD_SITE_M)


def _body(parent: Element, name: str, X: Transform6, centre: Vector3) -> Element:
    """Add a body at the end of a transform, whose start is at minus `centre` in the parent."""
    pose = transform6_to_pose(X)
    body = SubElement(parent, "body", name=name, pos=_numbers(_difference(pose.p, centre)))
    quat = _quaternion(X)
    if not np.array_equal(quat, (1.0, 0.0, 0.0, 0.0)):
        body.set("quat", _numbers(quat))
    return body


def _quaternion(X: Transform6) -> Array:
    """Return the turn of a transform, Rz(theta) Ry(beta) Rx(alpha), as a unit quaternion."""
    quat, turn = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(4)
    for angle, axis in ((X.theta_rad, (0, 0, 1)), (X.beta_rad, (0, 1, 0)), (X.alpha_rad, (1, 0, 0))):
        c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
        if abs(angle) == 0.5 * np.pi:  # sine and cosine of 45 degrees differ by rounding
            s = np.copysign(c, angle)
        turn[:] = c, *(s * np.array(axis, float))
        quat = _multiply(quat, turn)
    return quat


def _multiply(p: Array, q: Array) -> Array:
    """Return the product of two quaternions w, x, y, z, shape (4,), rounded as by MuJoCo."""
    return np.array(
        [
            p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
            p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
            p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
        ]
    )


def _add_mass(body: Element, lump: Lump, centre: Vector3) -> None:
    pos = _difference(np.array(lump.com_m), centre)
    _add(body, "inertial", pos=pos, mass=lump.mass_kg, diaginertia=lump.inertia_kg_m2)


def _add_spring(body: Element, name: str, link: LinkDescription) -> None:
    """Add three slides and three hinges with the stiffness of a link; they come before its mass and looks."""
    for k in SLIDES_FIRST:
        axis, direction = SCREW_AXES[k]
        joint = SubElement(body, "joint", name=f"{name}_{axis}", axis=direction)
        if k >= 3:
            joint.set("type", "slide")
        _set(joint, stiffness=link.stiffness[k], damping=round(DAMPING_S * link.stiffness[k], 6))


def _add_shapes(body: Element, shapes: Iterable[Shape]) -> None:
    for shape in shapes:
        if shape.of != "flight":
            _add_shape(body, shape, "collision")


def _add_shape(body: Element, shape: Shape, kind: str) -> Element:
    geom = SubElement(body, "geom", attrib={"class": kind})
    if shape.kind == "capsule":
        if shape.from_m == shape.to_m:
            return _set(geom, type="sphere", size=shape.radius_m, pos=shape.from_m)
        if kind != "collision":
            geom.set("type", "capsule")
        return _set(geom, size=shape.radius_m, fromto=f"{_numbers(shape.from_m)} {_numbers(shape.to_m)}")
    size = shape.half_m if shape.kind == "box" else (shape.radius_m, shape.half_length_m)
    _set(geom, type=str(shape.kind), size=size, pos=shape.centre_m)
    if shape.turn_rad:
        geom.set("euler", f"0 0 {_numbers(shape.turn_rad)}")
    return geom


def _add_tendons(arm: ArmDescription, tendons: Element) -> None:
    for name in arm.joints.by_name():
        actuator = arm.actuator_of(name)
        half = 0.5 * actuator.backlash_rad
        gear = _add(tendons, "fixed", name=f"{name}_gear", springlength=(-half, half))
        stiffness = actuator.gear_stiffness_Nm_rad
        _set(gear, stiffness=stiffness, damping=round(DAMPING_S * stiffness, 6))
        SubElement(gear, "joint", joint=f"{name}_gear", coef="1")
    for name, joint in arm.joints.by_name().items():
        output = _add(tendons, "fixed", "output", name=f"{name}_output", springlength=joint.hardstops_rad)
        friction = arm.actuator_of(name).output_friction_Nm
        _set(output, frictionloss=friction, stiffness=joint.hardstop_stiffness_Nm_rad)
        SubElement(output, "joint", joint=f"{name}_motor", coef="1")
        SubElement(output, "joint", joint=f"{name}_gear", coef="1")


def _add_actuators(arm: ArmDescription, actuators: Element) -> None:
    for group, name in enumerate(arm.joints.by_name(), start=1):
        motor = arm.actuator_of(name)
        gains = (motor.position_gain_Nm_rad, motor.integral_gain_Nm_rads, motor.rate_gain_Nms_rad)
        added = _add(
            actuators, "dcmotor", name=name, joint=f"{name}_motor", group=str(group), input="pos vel"
        )
        _set(added, motorconst=(motor.torque_constant_Nm_A, 0.0), resistance=motor.resistance_Ohm)
        _set(added, saturation=(0.0, motor.current_limit_A, 0.0))
        _set(added, controller=(*gains, 0.0, motor.integral_limit_rads, 0.0))


def _add(parent: Element, tag: str, default: str = "", **values: object) -> Element:
    """Add an element of a class of defaults, with these texts and numbers."""
    return _set(SubElement(parent, tag, attrib={"class": default} if default else {}), **values)


def _set(element: Element, **values: object) -> Element:
    for name, value in values.items():
        element.set(name, value if isinstance(value, str) else _numbers(value))
    return element


def _difference(p_m: Array, centre_m: Vector3) -> Array:
    difference: Array = p_m - np.array(centre_m)
    return np.asarray(np.round(difference, DIGITS)) if any(centre_m) else difference


def _numbers(values: object) -> str:
    """Write numbers so that they read back exactly."""
    numbers = np.atleast_1d(np.asarray(values, float)) + 0.0  # no negative zero
    return " ".join(repr(float(number)).removesuffix(".0") for number in numbers)
