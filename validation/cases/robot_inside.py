"""Effects of the truth that the catalogue has too, written a second time: motor, controller and friction."""

import math

import mujoco

from simgap.effects.effect import Family
from validation.cases.robot_truth import Run, TrueEffect


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
        most = math.copysign(
            math.sqrt(2.0 * limit * abs(left) + (0.5 * limit * h) ** 2) - 0.5 * limit * h, left
        )
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
