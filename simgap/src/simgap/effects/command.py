"""Changes of a command on its way to the loop, and errors of sensors: delay, limits, clamp, scale, zero."""

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from simgap.arrays import Array
from simgap.effects.actuation import limit_of
from simgap.effects.effect import Effect, Family, Fields, JointEffect, Size
from simgap.robot import ControlMode, Robot

PROFILE_STEP_S: Final = 1e-3
"""Step in which a profile is computed, as in a servo. In steps of a control period of 4 ms, a weak limit is
late by 2 ms, which looks like a delay."""


@dataclass(frozen=True, slots=True)
class CommandDelay(JointEffect):
    """The command arrives late."""

    name: ClassVar[str] = "command delay"
    family: ClassVar[Family] = Family.TIMING

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Delay, up to the command that a window keeps before its start."""
        return (self.size_of("delay_s", 0.0, 0.2, 0.01),)

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Shift the command; a fraction of a period is the mean of a command that changes within it."""
        position = np.clip(np.arange(command.shape[1]) - size[:, :1] / period_s, 0.0, None)
        low = np.floor(position).astype(int)
        share = position - low
        row = np.arange(command.shape[0])[:, None]
        high = np.minimum(low + 1, command.shape[1] - 1)
        return np.asarray((1.0 - share) * command[row, low] + share * command[row, high])


@dataclass(frozen=True, slots=True)
class VelocityLimit(JointEffect):
    """The servo follows the command with a limited speed, as a profile does."""

    name: ClassVar[str] = "velocity limit"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Inverse of the limit, down to a tenth of the logged speed."""
        speed = self.scales.speed_rad_s
        return (self.size_of("inverse_speed_s_rad", 0.0, 10.0 / speed, 1.0 / speed),)

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Follow the command from its first value."""
        step, last = period_s * limit_of(size[:, 0]), command[:, 0]
        followed = command.copy()
        for k in range(1, command.shape[1]):
            followed[:, k], last = self._follow(command[:, k], last, step)
        return followed

    def next_command(self, size: Array, command: Array, period_s: float, memory: dict[str, Array]) -> Array:
        """Follow the command from where the last period ended."""
        step = period_s * limit_of(size[:, 0])
        followed, memory["end"] = self._follow(command, memory.get("end", command), step)
        return followed

    def _follow(self, command: Array, last: Array, step: Array) -> tuple[Array, Array]:
        """Return the mean over a control period, and the end, of a ramp that stops at the command.

        The profile of a servo runs faster than commands come, so a limit acts within a period. A ramp from d
        that may go by a step s in a period covers r = min(|d|, s), and its mean is r^2 / 2s before its end.
        """
        end = np.clip(command, last - step, last + step)
        return end - (end - last) * np.abs(end - last) / (2.0 * step), end

    def describe(self, size: Array) -> str:
        """Return the limit."""
        return f"velocity limit {float(limit_of(size)[0]):.4g} {self.joint.unit}/s"


@dataclass(frozen=True, slots=True)
class AccelerationLimit(JointEffect):
    """The servo follows the command with a limited acceleration, as a trapezoidal profile does."""

    name: ClassVar[str] = "acceleration limit"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Inverse of the limit, down to a tenth of the logged acceleration."""
        acceleration = self.scales.acceleration_rad_s2
        return (self.size_of("inverse_acceleration_s2_rad", 0.0, 10.0 / acceleration, 1.0 / acceleration),)

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Follow the command from its first value, at rest."""
        limited = np.flatnonzero(size[:, 0] > 0.0)
        followed = command.copy()
        limit, last, speed = limit_of(size[limited, 0]), command[limited, 0], np.zeros(limited.size)
        for k in range(1, command.shape[1] if limited.size else 0):
            followed[limited, k], last, speed = self._follow(
                command[limited, k], last, speed, limit, period_s
            )
        return followed

    def next_command(self, size: Array, command: Array, period_s: float, memory: dict[str, Array]) -> Array:
        """Follow the command from where the last period ended, with its speed."""
        last, speed = memory.get("end", command), memory.get("speed", np.zeros_like(command))
        limit = limit_of(size[:, 0])
        followed, memory["end"], memory["speed"] = self._follow(command, last, speed, limit, period_s)
        return followed

    def _follow(
        self, command: Array, last: Array, speed: Array, limit: Array, period_s: float
    ) -> tuple[Array, Array, Array]:
        """Return the mean over a control period, and end and speed at its end, of a profile.

        The profile speeds up, and brakes in time to stop at the command. From a distance d it can still stop
        from the speed that the quadratic law gives; in steps T the law is v (v + a T) / 2a = d, so that it
        ends without overshoot.
        """
        n = max(1, round(period_s / PROFILE_STEP_S))
        step_s, mean = period_s / n, np.zeros_like(last)
        change = limit * step_s
        for _ in range(n):
            distance = np.abs(command - last)
            fastest = (np.sqrt(change**2 + 8.0 * limit * distance) - change) / 2.0
            wanted = np.sign(command - last) * np.minimum(fastest, distance / step_s)
            speed = np.clip(wanted, speed - change, speed + change)
            mean += (last + 0.5 * step_s * speed) / n
            last = last + step_s * speed
        return mean, last, speed

    def describe(self, size: Array) -> str:
        """Return the limit."""
        return f"acceleration limit {float(limit_of(size)[0]):.4g} {self.joint.unit}/s2"


@dataclass(frozen=True, slots=True)
class _Clamp(JointEffect):
    family: ClassVar[Family] = Family.ACTUATION
    is_low: ClassVar[bool]

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Length that is cut off from the commanded range: at most half of it."""
        span = max(self.scales.command_high - self.scales.command_low, 1e-6)
        return (self.size_of("cut_rad", 0.0, 0.5 * span, 0.1 * span),)

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Cut commands off; at size 0 also those pass that no fitted motion had."""
        cut = (np.maximum if self.is_low else np.minimum)(command, self._end(size[:, :1]))
        return np.asarray(np.where(size[:, :1] > 0.0, cut, command))

    def describe(self, size: Array) -> str:
        """Return the end."""
        return f"commands {'below' if self.is_low else 'above'} {float(self._end(size)[0]):.4g} are cut off"

    def _end(self, size: Array) -> Array:
        return self.scales.command_low + size if self.is_low else self.scales.command_high - size


@dataclass(frozen=True, slots=True)
class ClampLow(_Clamp):
    """Commands are cut off at a lower end."""

    name: ClassVar[str] = "command clamp, low"
    is_low: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class ClampHigh(_Clamp):
    """Commands are cut off at an upper end."""

    name: ClassVar[str] = "command clamp, high"
    is_low: ClassVar[bool] = False


@dataclass(frozen=True, slots=True)
class MeasurementDelay(JointEffect):
    """Positions are older than their time stamps say.

    The delay of one joint is a skew between joints. It does not depend on the simulation.
    """

    name: ClassVar[str] = "measurement delay"
    family: ClassVar[Family] = Family.TIMING

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Delay; negative if samples are younger than their stamps."""
        return (self.size_of("delay_s", -0.1, 0.1, 0.01),)

    def sample_delay_s(self, size: Array) -> Array:
        """Return the delay."""
        return np.asarray(size[:, 0])


@dataclass(frozen=True, slots=True)
class _CommonDelay(Effect):
    """One delay of all joints.

    A robot that gets its commands later by a time does the same later, and one whose positions are older than
    their stamps is seen to do it later. From a measured start no log of positions tells these two apart, so
    they are simulated alike.
    """

    family: ClassVar[Family] = Family.TIMING
    at_joints: tuple[JointEffect, ...]
    """The delay of each joint alone; a file of effects needs its class, so a kind of delay names it."""
    period_s: float
    place: str = "all joints"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Delay, the same at each joint."""
        return self.at_joints[0].sizes

    @property
    def parts(self) -> tuple[Effect, ...]:
        """Delays of the joints."""
        return tuple(
            _SharedDelay(one.place, one.index, one.joint, one.scales, period_s=self.period_s)
            for one in self.at_joints
        )

    def overrides(self, *hooks: str) -> bool:
        """Return whether the delay of a joint has its own version of any of these hooks."""
        return self.at_joints[0].overrides(*hooks)


@dataclass(frozen=True, slots=True)
class CommonCommandDelay(_CommonDelay):
    """The commands of all joints arrive late by one time, as over a bus."""

    name: ClassVar[str] = CommandDelay.name
    at_joints: tuple[CommandDelay, ...]


@dataclass(frozen=True, slots=True)
class CommonMeasurementDelay(_CommonDelay):
    """The positions of all joints are older than their time stamps by one time, as with another clock."""

    name: ClassVar[str] = MeasurementDelay.name
    at_joints: tuple[MeasurementDelay, ...]


@dataclass(frozen=True, slots=True)
class _SharedDelay(CommandDelay):
    """Delay of all joints at one of them: of its command by whole periods, and of its samples by the rest.

    The mean of the command in a period would be no delay by a part of it where a torque is at its limit: a
    part of a step takes it there as well as the whole step.
    """

    period_s: float = 1.0

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Shift the command by whole periods."""
        return CommandDelay.shape_command(self, size - self.sample_delay_s(size)[:, None], command, period_s)

    def sample_delay_s(self, size: Array) -> Array:
        """Return what whole periods leave of the delay; all of it if it is negative."""
        whole = np.floor(np.maximum(size[:, 0], 0.0) / self.period_s + 1e-9)
        return np.asarray(size[:, 0] - self.period_s * whole)


@dataclass(frozen=True, slots=True)
class EncoderScale(JointEffect):
    """The encoder shows an angle that is too large in proportion."""

    name: ClassVar[str] = "encoder scale"
    family: ClassVar[Family] = Family.TIMING

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Relative error; a tenth is already another gear."""
        return (self.size_of("scale_ratio", -0.1, 0.1, 0.01),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Scale the gains: the servo compares shown angles, the simulation true ones."""
        if self.joint.mode is ControlMode.POSITION:
            fields.kp_Nm_rad[:, self.index] *= 1.0 + size[:, 0]
            fields.kd_Nms_rad[:, self.index] *= 1.0 + size[:, 0]

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Scale the angle."""
        return np.asarray(q_rad * (1.0 + size[:, :1]))

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Scale it back."""
        return np.asarray(shown_rad / (1.0 + size[:, :1]))


@dataclass(frozen=True, slots=True)
class JointZero(JointEffect):
    """The encoder shows an angle with a constant error."""

    name: ClassVar[str] = "joint zero"
    family: ClassVar[Family] = Family.GEOMETRY

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Angle that the encoder shows at the zero of the model; 10 degrees are seen by the eye."""
        per_rad = self.joint.per_rad
        return (self.size_of("zero_rad", -0.175 * per_rad, 0.175 * per_rad, 0.02 * per_rad),)

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Add the error."""
        return np.asarray(q_rad + size[:, :1])

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Subtract it."""
        return np.asarray(shown_rad - size[:, :1])
