"""Effects of the truth that the catalogue has too, written a second time."""

import math

import mujoco
import numpy as np

from simgap.effects.effect import Family
from simgap.robot import Robot
from validation.cases.robot_truth import GEAR, Run, Scene, TrueEffect


class CommandDelay(TrueEffect, name="command delay", family=Family.TIMING):
    """Command that arrives late; size [s]."""

    @property
    def command_delay_s(self) -> float:
        return self.size


class MeasurementDelay(TrueEffect, name="measurement delay", family=Family.TIMING):
    """Logged position that is old; size [s]."""

    @property
    def log_delay_s(self) -> float:
        return self.size


class VelocityLimit(TrueEffect, name="velocity limit", family=Family.ACTUATION):
    """Set-point that follows the command at a limited velocity; size 1 / limit [s/rad]."""

    at: float | None

    def begin(self, run: Run) -> None:
        self.at = None

    def command(self, run: Run, command: float) -> float:
        if self.at is None:
            self.at = command
        step = run.step_s / self.size
        self.at += min(max(command - self.at, -step), step)
        return self.at


class AccelerationLimit(TrueEffect, name="acceleration limit", family=Family.ACTUATION):
    """Set-point that follows the command at a limited acceleration; size 1 / limit [s2/rad]."""

    at: float | None
    speed: float

    def begin(self, run: Run) -> None:
        self.at, self.speed = None, 0.0

    def command(self, run: Run, command: float) -> float:
        if self.at is None:
            self.at = command
        limit, h = 1.0 / self.size, run.step_s
        left = command - self.at
        # the speed from which the limit just stops at the command within whole steps
        root = math.sqrt(2.0 * limit * abs(left) + (0.5 * limit * h) ** 2)
        most = math.copysign(root - 0.5 * limit * h, left)
        if abs(left) < limit * h * h and abs(self.speed) <= limit * h:
            self.at, self.speed = command, 0.0
            return command
        self.speed += min(max(most - self.speed, -limit * h), limit * h)
        self.at += self.speed * h
        return self.at


class TorqueLimit(TrueEffect, name="torque limit", family=Family.ACTUATION):
    """Torque limit below the stated one; size 1 / limit less 1 / stated limit [1/(N m)]."""

    def limited(self, run: Run, torque_Nm: float, limit_Nm: float) -> float:
        limit = 1.0 / (1.0 / limit_Nm + self.size)
        return min(max(torque_Nm, -limit), limit)


class ClampLow(TrueEffect, name="command clamp, low", family=Family.ACTUATION):
    """Commands that are cut off at the lower end; size: length of the range that is lost [rad]."""

    def command(self, run: Run, command: float) -> float:
        return max(command, self.scene.low_rad[self.j] + self.size)


class ClampHigh(TrueEffect, name="command clamp, high", family=Family.ACTUATION):
    """Commands that are cut off at the upper end; size: length of the range that is lost [rad]."""

    def command(self, run: Run, command: float) -> float:
        return min(command, self.scene.high_rad[self.j] - self.size)


class GainError(TrueEffect, name="gain error", family=Family.ACTUATION):
    """Gain of the position loop and its damping, times 1 + size."""

    def servo(self, run: Run, torque_Nm: float) -> float:
        return torque_Nm * (1.0 + self.size)


class DeadZone(TrueEffect, name="dead zone", family=Family.ACTUATION):
    """Position errors below the size [rad] give no torque."""

    def error(self, run: Run, error: float) -> float:
        return math.copysign(max(abs(error) - self.size, 0.0), error)


class Integral(TrueEffect, name="integral leak", family=Family.ACTUATION):
    """Integral of the error, with a leak; size: integral over position gain [1/s]."""

    sum_rad_s: float

    def begin(self, run: Run) -> None:
        self.sum_rad_s = 0.0

    def error(self, run: Run, error: float) -> float:
        leak_s = 0.2 + 0.6 * self.shape
        self.sum_rad_s += run.step_s * (error - self.sum_rad_s / leak_s)
        return error + self.size * self.sum_rad_s


class BackEmf(TrueEffect, name="back-EMF", family=Family.ACTUATION):
    """Torque limit that falls with the speed; size: share of the limit per rad/s [s/rad]."""

    def limited(self, run: Run, torque_Nm: float, limit_Nm: float) -> float:
        speed = run.v[self.j]
        high, low = limit_Nm * (1.0 - self.size * speed), limit_Nm * (1.0 + self.size * speed)
        return min(max(torque_Nm, -max(low, 0.0)), max(high, 0.0))


class SupplySag(TrueEffect, name="supply sag", family=Family.ACTUATION, is_everywhere=True):
    """Supply that gives way for all joints; size: fall of all torques when each motor has its largest."""

    def limited(self, run: Run, torque_Nm: float, limit_Nm: float) -> float:
        joints = self.robot.joints
        load = sum(abs(t) / one.torque_limit_Nm for t, one in zip(run.motor_Nm, joints, strict=True))
        return torque_Nm * max(1.0 - self.size * load / len(joints), 0.0)


class Armature(TrueEffect, name="armature", family=Family.INERTIA):
    """Inertia of the rotor; size [kg m2]."""

    def build(self, spec: mujoco.MjSpec) -> None:
        spec.joint(self.place).armature += self.size


class Viscous(TrueEffect, name="viscous friction", family=Family.FRICTION):
    """Friction in proportion to the velocity; size [N m s/rad]."""

    def torque_Nm(self, run: Run) -> float:
        return -self.size * run.v[self.j]


class Coulomb(TrueEffect, name="Coulomb friction", family=Family.FRICTION):
    """Dry friction; size [N m]."""

    def friction_Nm(self, run: Run) -> float:
        return self.size


class Stribeck(TrueEffect, name="Stribeck friction", family=Family.FRICTION):
    """Dry friction that is larger near rest; size [N m], shape: Stribeck velocity."""

    def friction_Nm(self, run: Run) -> float:
        width_rad_s = 0.03 * 5.0**self.shape
        return self.size * math.exp(-((run.v[self.j] / width_rad_s) ** 2))


class LoadFriction(TrueEffect, name="load-dependent friction", family=Family.FRICTION, needs_load=True):
    """Dry friction in proportion to the load of the gear; size: share of the load."""

    def friction_Nm(self, run: Run) -> float:
        return self.size * abs(run.load_Nm[self.j])


class AsymmetricFriction(TrueEffect, name="asymmetric friction", family=Family.FRICTION):
    """Dry friction in one direction only, that of the sign; size [N m].

    The range of a friction from -(F + s) to F is one of F + s / 2 beside a constant torque of -s / 2.
    """

    def friction_Nm(self, run: Run) -> float:
        return 0.5 * abs(self.size)

    def torque_Nm(self, run: Run) -> float:
        return -0.5 * self.size


class TemperatureFriction(TrueEffect, name="temperature-dependent friction", family=Family.FRICTION):
    """Dry friction of a cold joint; size: [N m] per 10 K below 40 degC."""

    def friction_Nm(self, run: Run) -> float:
        return self.size * (40.0 - run.temperature_degC) / 10.0


def add_gear(spec: mujoco.MjSpec, place: str) -> mujoco.MjsJoint:
    """Add the hinge between motor and link, after the motor's; it has the same axis."""
    motor = spec.joint(place)
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return motor.parent.add_joint(name=place + GEAR, type=hinge, axis=motor.axis, pos=motor.pos)


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
