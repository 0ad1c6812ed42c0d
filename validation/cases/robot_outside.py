"""Effects of the truth that no catalogue has, each with the places and families that a verdict may give."""

import math
from collections import deque

from simgap.effects.effect import Family
from validation.cases.robot_truth import Run, TrueEffect

F = Family


class CreepingLink(
    TrueEffect, name="creeping link", family=F.TRANSMISSION, also=(F.GEOMETRY,), needs_load=True
):
    """Mount of the encoder that yields to the load within seconds; size [rad/(N m)], shape: time constant."""

    def begin(self, run: Run) -> None:
        self.slow_Nm: float | None = None

    def shows(self, run: Run, q_rad: float) -> float:
        load = run.load_Nm[self.j]
        self.slow_Nm = load if self.slow_Nm is None else self.slow_Nm
        self.slow_Nm += run.step_s * (load - self.slow_Nm) / (0.6 + 2.0 * self.shape)
        return q_rad + self.size * self.slow_Nm


class DriftingTorque(TrueEffect, name="drifting torque", family=F.EXTERNAL):
    """Torque that depends on the time alone; size [N m], shape: period and phase."""

    def begin(self, run: Run) -> None:
        self.phase = float(run.rng.uniform(0.0, 2.0 * math.pi))

    def torque_Nm(self, run: Run) -> float:
        return self.size * math.sin(2.0 * math.pi * run.time_s / (1.5 + 3.0 * self.shape) + self.phase)


class Hysteresis(TrueEffect, name="hysteresis", family=F.FRICTION, also=(F.TRANSMISSION, F.EXTERNAL)):
    """Bouc-Wen hysteresis; size: torque when it has yielded [N m], shape: angle of yielding."""

    def begin(self, run: Run) -> None:
        self.z = 0.0

    def torque_Nm(self, run: Run) -> float:
        v, z = run.v[self.j], self.z
        rate = v - 0.5 * (abs(v) * abs(z) * z + v * z * z)
        self.z += run.step_s * rate / (0.05 + 0.25 * self.shape)
        return -self.size * self.z


class WobblingBase(TrueEffect, name="wobbling base", family=F.TRANSMISSION, also=(F.GEOMETRY, F.EXTERNAL)):
    """Base that tilts and swings under the reaction of the first joint; size [rad/(N m)]."""

    def begin(self, run: Run) -> None:
        self.tilt, self.rate = 0.0, 0.0
        run.model.opt.gravity[:] = (0.0, 0.0, -9.81)

    def act(self, run: Run) -> None:
        omega, j = 2.0 * math.pi * (1.5 + 2.0 * self.shape), min(1, len(run.q) - 1)
        j = j if len(run.q) > 2 else 0  # the first joint that gravity loads
        push = self.size * run.motor_Nm[j] - self.tilt
        self.rate += run.step_s * (omega * omega * push - 0.1 * omega * self.rate)
        self.tilt += run.step_s * self.rate
        tilt = min(max(self.tilt, -0.5), 0.5)
        run.model.opt.gravity[:] = (9.81 * math.sin(tilt), 0.0, -9.81 * math.cos(tilt))


class Cogging(TrueEffect, name="cogging", family=F.EXTERNAL, also=(F.ACTUATION,)):
    """Torque ripple of three high orders at once; size [N m], shape: phases."""

    def torque_Nm(self, run: Run) -> float:
        q, turn = run.q[self.j], 6.0 * self.shape
        return self.size * (
            math.sin(19.0 * q + turn) + 0.8 * math.sin(31.0 * q) + 0.6 * math.sin(67.0 * q - turn)
        )


class CommandDropout(TrueEffect, name="command dropout", family=F.TIMING, also=(F.ACTUATION,)):
    """Commands that are lost at random; the last one stays; size: mean time of a gap [s]."""

    def begin(self, run: Run) -> None:
        self.until_s, self.held = -1e9, 0.0

    def command(self, run: Run, command: float) -> float:
        if run.time_s < self.until_s:
            return self.held
        if run.time_s > 0.0 and run.rng.random() < 1.5 * run.step_s:
            self.until_s, self.held = run.time_s + float(run.rng.uniform(0.5, 1.5)) * self.size, command
        return command


class StickySpot(TrueEffect, name="sticky spot", family=F.FRICTION):
    """Friction that is larger at one place; size [N m], shape: the place."""

    def friction_Nm(self, run: Run) -> float:
        return self.size * math.exp(-(((run.q[self.j] - self.middle_rad) / 0.06) ** 2))

    @property
    def middle_rad(self) -> float:
        """Return the place: within the middle half of the commands."""
        low, high = self.scene.low_rad[self.j], self.scene.high_rad[self.j]
        return low + (0.25 + 0.5 * self.shape) * (high - low)


class OneWayFriction(TrueEffect, name="one-way friction", family=F.FRICTION):
    """Friction of one direction that varies with the position; size [N m], shape: phase."""

    def friction_Nm(self, run: Run) -> float:
        if run.v[self.j] <= 0.0:
            return 0.0
        return self.size * (1.0 + math.sin(4.0 * run.q[self.j] + 6.0 * self.shape))


class EccentricGear(TrueEffect, name="eccentric gear", family=F.ACTUATION, also=(F.TRANSMISSION,)):
    """Torque constant that varies with the angle; size: share, shape: phase."""

    def servo(self, run: Run, torque_Nm: float) -> float:
        return torque_Nm * (1.0 + self.size * math.sin(5.0 * run.q[self.j] + 6.0 * self.shape))


class ThermalGain(TrueEffect, name="thermal gain", family=F.ACTUATION):
    """Torque constant that falls as the motor heats; size: share at the full torque, shape: time constant."""

    def begin(self, run: Run) -> None:
        self.heat: float | None = None

    def servo(self, run: Run, torque_Nm: float) -> float:
        power = (torque_Nm / self.robot.joints[self.j].torque_limit_Nm) ** 2
        self.heat = power if self.heat is None else self.heat
        self.heat += run.step_s * (power - self.heat) / (2.0 + 4.0 * self.shape)
        return torque_Nm * max(1.0 - self.size * self.heat, 0.2)


class SlackCable(TrueEffect, name="slack cable", family=F.EXTERNAL):
    """Cable that pulls when it is taut; size [N m/rad], shape: where, and to which side."""

    def torque_Nm(self, run: Run) -> float:
        low, high = self.scene.low_rad[self.j], self.scene.high_rad[self.j]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        side = 1.0 if self.shape < 0.5 else -1.0
        return -side * self.size * max(side * (run.q[self.j] - middle) - 0.4 * half, 0.0)


class QuantisedTorque(TrueEffect, name="quantised torque", family=F.ACTUATION):
    """Torque in steps; size: the step [N m]."""

    def servo(self, run: Run, torque_Nm: float) -> float:
        return self.size * math.trunc(torque_Nm / self.size)


class HiddenMode(TrueEffect, name="hidden mode", family=F.TRANSMISSION, also=(F.INERTIA,)):
    """Mass on a spring within a link; size: its inertia [kg m2], shape: frequency."""

    def begin(self, run: Run) -> None:
        self.at: float | None = None
        self.rate = 0.0

    def torque_Nm(self, run: Run) -> float:
        omega, q = 2.0 * math.pi * (2.0 + 3.0 * self.shape), run.q[self.j]
        self.at = q if self.at is None else self.at
        pull = omega * omega * (q - self.at) + 0.06 * omega * (run.v[self.j] - self.rate)
        self.rate += run.step_s * pull
        self.at += run.step_s * self.rate
        return -self.size * pull


class AgeingFriction(TrueEffect, name="ageing friction", family=F.FRICTION):
    """Dry friction that grows while the joint rests and is gone once it moves; size [N m] per decade."""

    def begin(self, run: Run) -> None:
        self.rest_s = 0.0

    def friction_Nm(self, run: Run) -> float:
        travel = abs(run.v[self.j]) * run.step_s
        self.rest_s = (self.rest_s + run.step_s) * math.exp(-travel / 0.004)
        return self.size * math.log10(1.0 + self.rest_s / 0.01)


class WanderingDelay(TrueEffect, name="wandering delay", family=F.TIMING, also=(F.ACTUATION,)):
    """Command delay that comes and goes with the time; size: its largest [s], shape: period."""

    def begin(self, run: Run) -> None:
        self.past: deque[float] = deque(maxlen=1 + round(self.size / run.step_s))

    def command(self, run: Run, command: float) -> float:
        self.past.appendleft(command)
        share = 0.5 - 0.5 * math.cos(2.0 * math.pi * run.time_s / (0.8 + 1.5 * self.shape))
        return self.past[min(round(share * self.size / run.step_s), len(self.past) - 1)]


class OneWayGain(TrueEffect, name="one-way gain", family=F.ACTUATION):
    """Torque constant that differs by the sign of the torque; size: share."""

    def servo(self, run: Run, torque_Nm: float) -> float:
        return torque_Nm * (1.0 + self.size) if torque_Nm > 0.0 else torque_Nm
