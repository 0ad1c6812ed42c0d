"""Faults of a servo: of its gains and its torque."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import (
    QUANTILE,
    AddedNumber,
    Effect,
    Family,
    Fields,
    JointEffect,
    JointScales,
    Size,
    Tick,
)
from simgap.logs import Motion
from simgap.robot import ControlMode, Robot


@dataclass(frozen=True, slots=True)
class GainError(JointEffect):
    """Stiffness and damping of the loop are other than nominal, in the same ratio."""

    name: ClassVar[str] = "gain error"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Relative change; a loop with less than a twentieth of its gain is a loop that is off."""
        return (self.size_of("gain_ratio", -0.95, 4.0, 0.2),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Scale the gains."""
        fields.kp_Nm_rad[:, self.index] *= 1.0 + size[:, 0]
        fields.kd_Nms_rad[:, self.index] *= 1.0 + size[:, 0]


@dataclass(frozen=True, slots=True)
class DampingGain(AddedNumber):
    """Damping of the loop is other than nominal.

    What is added to a position loop is back-EMF: it acts under power, and outside the limit of the torque,
    which is one of the voltage. So the largest torque falls with the speed, and under power it is viscous
    friction.
    """

    name: ClassVar[str] = "damping gain"
    family: ClassVar[Family] = Family.ACTUATION
    number: ClassVar[str] = "kd_Nms_rad"

    @property
    def nominal(self) -> float:
        """Gain of the robot file."""
        return self.joint.kd_Nms_rad

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Damping beside the nominal one: at most what takes the whole torque at the highest speed."""
        scale = self.scales.torque_Nm / self.scales.speed_rad_s
        return (self.size_of("kd_Nms_rad", -self.nominal, scale, 0.05 * scale),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add back-EMF to a position loop. Less than the nominal gain is none: that acts inside the limit."""
        is_added = (size[:, 0] > 0.0) & (self.joint.mode is ControlMode.POSITION)
        fields.back_emf_Nms_rad[:, self.index] += np.where(is_added, size[:, 0], 0.0)
        fields.kd_Nms_rad[:, self.index] += np.where(is_added, 0.0, size[:, 0])


@dataclass(frozen=True, slots=True)
class TorqueConstant(JointEffect):
    """The motor makes more or less torque than it should, gains and limit alike."""

    name: ClassVar[str] = "torque constant"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Relative change; a motor with less than a tenth of its torque is a motor that is off."""
        return (self.size_of("torque_ratio", -0.9, 1.0, 0.1),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Scale gains and limit."""
        for values in (fields.kp_Nm_rad, fields.kd_Nms_rad, fields.torque_limit_Nm):
            values[:, self.index] *= 1.0 + size[:, 0]


@dataclass(frozen=True, slots=True)
class CurrentScale(JointEffect):
    """The torque of a logged current is other than its torque constant says."""

    name: ClassVar[str] = "scale of the current"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def nominal(self) -> float:
        """Constant of the robot file."""
        return self.joint.torque_constant_Nm_A

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Constant beside the given one: a tenth of it to five times as much."""
        given = self.nominal
        return (self.size_of("torque_constant_Nm_A", -0.9 * given, 4.0 * given, 0.1 * given),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Scale the logged torque, and that of commands if they are currents."""
        factor = 1.0 + size[:, 0] / self.nominal
        fields.torque_scale[:, self.index] *= factor
        if self.joint.mode is ControlMode.CURRENT:
            fields.kp_Nm_rad[:, self.index] *= factor


@dataclass(frozen=True, slots=True)
class TorqueLimit(JointEffect):
    """The motor makes less than its largest torque."""

    name: ClassVar[str] = "torque limit"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Inverse of the limit, from the nominal one down to a twentieth of the torque in use."""
        torque = self.scales.torque_Nm
        return (self.size_of("inverse_limit_1_Nm", 0.0, 20.0 / torque, 2.0 / torque),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Lower the limit."""
        limit = fields.torque_limit_Nm[:, self.index]
        fields.torque_limit_Nm[:, self.index] = np.minimum(limit, limit_of(size[:, 0]))

    def describe(self, size: Array) -> str:
        """Return the limit."""
        return f"torque limit {float(limit_of(size)[0]):.4g} {self.joint.effort_unit}"


@dataclass(frozen=True, slots=True)
class BackEmf(JointEffect):
    """The largest torque falls with the speed, to 0 at the no-load speed; in braking it grows."""

    name: ClassVar[str] = "back-EMF"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Inverse of the no-load speed; at most the motor could only just reach half the logged speed."""
        speed = self.scales.speed_rad_s
        return (self.size_of("inverse_no_load_s_rad", 0.0, 2.0 / speed, 0.5 / speed),)

    def act(self, size: Array, tick: Tick) -> None:
        """Lower the limit where the motor drives, and raise it where the motor brakes."""
        j, joint = self.index, self.joint
        q_rad, v_rad_s = tick.state.q_rad[:, j], tick.state.v_rad_s[:, j]
        # only its sign counts, and where the limit acts, nominal gains give that of the torque
        request = tick.command[:, j]
        if joint.mode is ControlMode.POSITION:
            request = joint.kp_Nm_rad * (request - q_rad) - joint.kd_Nms_rad * v_rad_s
        elif joint.mode is ControlMode.VELOCITY:
            request = request - v_rad_s
        driving = np.sign(request) * v_rad_s
        # a factor of 0 would make NaN of a torque without a limit, which stays so
        tick.torque_limit_Nm[:, j] *= np.maximum(1.0 - size[:, 0] * driving, np.finfo(float).tiny)

    def describe(self, size: Array) -> str:
        """Return the no-load speed."""
        return f"no-load speed {float(limit_of(size)[0]):.4g} {self.joint.unit}/s"


@dataclass(frozen=True, slots=True)
class DeadZone(JointEffect):
    """The loop makes no torque for small errors."""

    name: ClassVar[str] = "dead zone"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Error without torque, on each side: at most a tenth of the range."""
        range_rad = max(self.scales.high_rad - self.scales.low_rad, 1e-3)
        return (self.size_of("dead_rad", 0.0, 0.1 * range_rad, 0.005 * range_rad),)

    def act(self, size: Array, tick: Tick) -> None:
        """Take the dead zone off the error, by way of the command."""
        command = tick.command[:, self.index]
        error = command - tick.state.q_rad[:, self.index]
        tick.command[:, self.index] = command - np.clip(error, -size[:, 0], size[:, 0])


@dataclass(frozen=True, slots=True)
class LeakyIntegral(JointEffect):
    """The loop has an integral term that forgets: d(integral)/dt = error - leak integral."""

    name: ClassVar[str] = "integral leak"
    family: ClassVar[Family] = Family.ACTUATION
    has_shape: ClassVar[bool] = True

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Integral gain over stiffness, and leak; ten a second is the bandwidth of a servo."""
        return (self.size_of("integral_1_s", 0.0, 10.0, 1.0), self.size_of("leak_1_s", 0.0, 10.0, 1.0))

    def act(self, size: Array, tick: Tick) -> None:
        """Add the integral to the command, bounded by the range so that it does not wind up."""
        error = tick.command[:, self.index] - tick.state.q_rad[:, self.index]
        integral = tick.memory.get("integral", np.zeros_like(error))
        tick.command[:, self.index] += size[:, 0] * integral
        bound = self.scales.high_rad - self.scales.low_rad
        change = tick.period_s * (error - size[:, 1] * integral)
        tick.memory["integral"] = np.clip(integral + change, -bound, bound)


@dataclass(frozen=True, slots=True)
class SupplySag(Effect):
    """The supply gives way: limits and gains of all joints fall with the sum of their torques."""

    name: ClassVar[str] = "supply sag"
    family: ClassVar[Family] = Family.ACTUATION
    place: str = "supply"
    torque_Nm_all: tuple[float, ...] = field(default=())
    """Torque scales of the joints."""
    high: float = 1.0
    """Largest share by which the voltage can fall."""

    @classmethod
    def of(cls, robot: Robot, scales: Mapping[str, JointScales], motions: Sequence[Motion] = ()) -> Self:
        """Return the effect for a robot; a voltage that the fitted motions log bounds it."""
        torques = tuple(scales[joint.name].torque_Nm for joint in robot.joints)
        return cls(torque_Nm_all=torques, high=largest_sag(motions))

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Share by which the voltage falls when every joint has its largest torque."""
        return (Size("sag_ratio", 0.0, self.high, min(0.2, self.high)),)

    def act(self, size: Array, tick: Tick) -> None:
        """Scale limits and gains by the voltage under the load of the last step."""
        torque_Nm = np.array(self.torque_Nm_all)
        load = np.sum(np.abs(tick.motor_Nm) / torque_Nm, axis=1) / torque_Nm.size
        voltage = np.maximum(1.0 - size[:, 0] * load, 0.0)[:, None]
        tick.torque_limit_Nm *= voltage
        tick.gain *= voltage


def largest_sag(motions: Sequence[Motion]) -> float:
    """Return the largest share by which the supply can fall; 1 if no voltage is logged.

    A logged voltage shows how far it fell. The logs may have had half of the largest torques only, so that
    twice as much is possible.
    """
    logs = [
        log.voltage.value for motion in motions for log in motion.joints.values() if log.voltage is not None
    ]
    volts = np.concatenate([np.empty(0), *logs])
    volts = volts[np.isfinite(volts)]
    usual_V = float(np.median(volts)) if volts.size else 0.0
    if usual_V <= 0.0:
        return 1.0
    fall = 1.0 - float(np.quantile(volts, 1.0 - QUANTILE)) / usual_V
    return min(max(2.0 * fall, 0.0), 1.0)


def limit_of(size: Array) -> Array:
    """Return 1/size, (n,), with the unit inverse to that of the size; infinite at 0."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.abs(size))
