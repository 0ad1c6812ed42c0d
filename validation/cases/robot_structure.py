"""Effects of the truth that the catalogue has too: gears, links, gravity, external torque, encoders."""

import math

import mujoco
import numpy as np

from simgap.effects.effect import Family
from simgap.robot import Robot
from validation.cases.robot_truth import GEAR, Run, Scene, TrueEffect


def add_gear(spec: mujoco.MjSpec, place: str) -> mujoco.MjsJoint:
    """Add the hinge between motor and link, after the motor's; it has the same axis."""
    motor = spec.joint(place)
    return motor.parent.add_joint(
        name=place + GEAR, type=mujoco.mjtJoint.mjJNT_HINGE, axis=motor.axis, pos=motor.pos
    )


def scale(values: object, factor: float) -> np.ndarray:
    """Return an array times a factor."""
    return np.asarray(values, float) * factor


class Compliance(TrueEffect, name="joint compliance", family=Family.TRANSMISSION):
    """Spring between motor and link; size: 1 / stiffness [rad/(N m)]. Its damping is 2 ms of that."""

    def build(self, spec: mujoco.MjSpec) -> None:
        gear = add_gear(spec, self.place)
        gear.stiffness, gear.damping = scale(gear.stiffness, 0.0), scale(gear.damping, 0.0)
        gear.stiffness[0], gear.damping[0] = 1.0 / self.size, 0.002 / self.size


class Backlash(TrueEffect, name="backlash", family=Family.TRANSMISSION):
    """Free angle between motor and link; size [rad]. The flanks are forty times as stiff as the servo."""

    def build(self, spec: mujoco.MjSpec) -> None:
        add_gear(spec, self.place)
        stiffness = 40.0 * self.robot.joint(self.place).kp_Nm_rad
        tendon = spec.add_tendon(name=self.place + GEAR)
        tendon.wrap_joint(self.place + GEAR, 1.0)
        tendon.stiffness[0] = stiffness
        tendon.damping[0] = 0.002 * stiffness
        tendon.springlength = [-0.5 * self.size, 0.5 * self.size]


class Payload(TrueEffect, name="payload", family=Family.INERTIA):
    """Mass at the tool; size [kg]."""

    def build(self, spec: mujoco.MjSpec) -> None:
        site = spec.site(self.robot.tool_site)
        site.parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], pos=site.pos, mass=self.size,
            contype=0, conaffinity=0,
        )  # fmt: skip


class LinkMass(TrueEffect, name="link mass", family=Family.INERTIA):
    """Mass and inertia of a link, times 1 + size."""

    def build(self, spec: mujoco.MjSpec) -> None:
        for geom in link_of(spec, self.place).geoms:
            geom.mass *= 1.0 + self.size


class LinkCentre(TrueEffect, name="link centre", family=Family.INERTIA):
    """Centre of mass of a link that is farther along it; size [m]."""

    def build(self, spec: mujoco.MjSpec) -> None:
        along = link_direction(self.robot, self.place)
        for geom in link_of(spec, self.place).geoms:
            if not np.isnan(geom.fromto[0]):
                geom.fromto = np.asarray(geom.fromto) + self.size * np.tile(along, 2)
            else:
                geom.pos = np.asarray(geom.pos) + self.size * along


class LinkLength(TrueEffect, name="link length", family=Family.GEOMETRY):
    """Link that is longer: its child sits farther out; size [m]."""

    def build(self, spec: mujoco.MjSpec) -> None:
        along = link_direction(self.robot, self.place)
        for child in link_of(spec, self.place).bodies:
            child.pos = np.asarray(child.pos) + self.size * along


def link_of(spec: mujoco.MjSpec, joint: str) -> mujoco.MjsBody:
    """Return the body that a joint moves."""
    return spec.joint(joint).parent


def link_direction(robot: Robot, joint: str) -> np.ndarray:
    """Return the unit vector from a joint to the centre of mass of its link, (3,)."""
    centre = robot.model.body(int(robot.model.dof_bodyid[robot.joint(joint).dof_index])).ipos
    return np.asarray(centre / np.linalg.norm(centre))


class JointZero(TrueEffect, name="joint zero", family=Family.GEOMETRY):
    """Encoder zero that is wrong; size [rad], with a sign."""

    def shows(self, run: Run, q_rad: float) -> float:
        return q_rad + self.size


class GravityDirection(TrueEffect, name="gravity direction", family=Family.GEOMETRY):
    """Base that is tilted; size [rad], shape: direction of the tilt."""

    def build(self, spec: mujoco.MjSpec) -> None:
        # about y (shape 0) tilts the plane of the arms; the part about x is at most as large
        turn = 0.25 * math.pi * (2.0 * self.shape - 1.0)
        tilt = math.tan(self.size)
        direction = np.array([tilt * math.cos(turn), tilt * math.sin(turn), -1.0])
        spec.option.gravity = 9.81 * direction / np.linalg.norm(direction)


class Spring(TrueEffect, name="spring", family=Family.EXTERNAL):
    """Spring at a joint; size [N m/rad], shape: angle at which it is at rest."""

    def torque_Nm(self, run: Run) -> float:
        return -self.size * (run.q[self.j] - 0.8 * (2.0 * self.shape - 1.0))


class PositionTorque(TrueEffect, name="position-dependent torque", family=Family.EXTERNAL):
    """Torque that varies with the position as a sine with one to two turns; size [N m]."""

    def torque_Nm(self, run: Run) -> float:
        return self.size * math.sin((1.0 + round(self.shape)) * run.q[self.j] + 6.0 * self.shape)


class ConstantTorque(TrueEffect, name="constant torque", family=Family.EXTERNAL):
    """Constant torque at a joint; size [N m], with a sign."""

    def torque_Nm(self, run: Run) -> float:
        return self.size


class Plane(TrueEffect, name="contact with a plane", family=Family.CONTACT):
    """Horizontal plane that the tool touches; size: height over where the tool was lowest [m]."""

    def build(self, spec: mujoco.MjSpec) -> None:
        site = spec.site(self.robot.tool_site)
        site.parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.002, 0, 0], pos=site.pos, mass=0.0,
            contype=2, conaffinity=2, solref=[0.005, 1.0], friction=[0.3, 0.005, 0.0001],
        )  # fmt: skip
        height_m = self.scene.lowest_m + self.size
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], pos=[0, 0, height_m - 0.002],
            contype=2, conaffinity=2, solref=[0.005, 1.0],
        )  # fmt: skip


class PeriodicError(TrueEffect, name="periodic joint error", family=Family.GEOMETRY):
    """Encoder error that repeats with a turn; size [rad], shape: order from 2 to 12."""

    def shows(self, run: Run, q_rad: float) -> float:
        order = 2 + int(11 * min(self.shape, 0.999))
        return q_rad + self.size * math.sin(order * q_rad + 20.0 * self.shape)


class EncoderScale(TrueEffect, name="encoder scale", family=Family.TIMING):
    """Encoder that shows 1 + size times the angle."""

    def shows(self, run: Run, q_rad: float) -> float:
        return q_rad * (1.0 + self.size)


class Coupling(TrueEffect, name="joint coupling", family=Family.TRANSMISSION, needs_load=True):
    """Gear that turns with the neighbour towards the base too: its load comes back there; size: ratio."""

    def __init__(self, scene: Scene, place: str, size: float, shape: float = 0.5) -> None:
        super().__init__(scene, place, size, shape)
        self.acts_on = self.j - 1

    def torque_Nm(self, run: Run) -> float:
        return self.size * run.load_Nm[self.j]
