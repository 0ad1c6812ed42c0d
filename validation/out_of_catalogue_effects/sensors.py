"""Effects of sensors that the catalogue lacks, for blind cases with an unknown cause."""

from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from sim.disturbance import at_joint
from sim.effects.effect import Effect, Hardware, ParameterSpec, nominal_hardware

RAD_PER_COUNT: Final = nominal_hardware().rad_per_count


@dataclass(frozen=True, slots=True)
class _Reading(Effect):
    """Effect that changes the readings of sensors."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the sensors."""
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, self))

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return the wrong readings in place of the right ones."""
        raise NotImplementedError

    def update(self, sensors: Sensors) -> "_Reading":
        """Return the next state: unchanged, unless a subclass overrides it."""
        return self


@dataclass(frozen=True, slots=True)
class TorqueRipple(_Reading):
    """Motor whose torque constant varies with its angle."""

    joint: Joint
    share: Annotated[float, ParameterSpec(0.0, 0.8, unit="1", typical=0.05, neutral=0.0)]
    turns: Annotated[int, ParameterSpec(1, 10000, unit="1", typical=150)] = 150

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the current that the motor takes at its encoder angle."""
        angle = self.turns * float(sensors.encoder_count[self.joint] * RAD_PER_COUNT[self.joint])
        more = at_joint(self.joint, self.share * float(np.sin(angle)))
        return replace(sensors, current_A=sensors.current_A * (1.0 + more))


@dataclass(frozen=True, slots=True)
class DeadCurrent(_Reading):
    """Current sensor with a dead zone around zero."""

    joint: Joint
    dead_A: Annotated[float, ParameterSpec(0.0, 2.0, unit="A", typical=0.05, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the current beyond the dead zone."""
        current_A = float(sensors.current_A[self.joint])
        lost_A = float(np.clip(current_A, -self.dead_A, self.dead_A))
        return replace(sensors, current_A=sensors.current_A - at_joint(self.joint, lost_A))


@dataclass(frozen=True, slots=True)
class SluggishCurrent(Effect):
    """Current sensor with a first-order lag."""

    joint: Joint
    lag_s: Annotated[float, ParameterSpec(0.0, 10.0, unit="s", typical=0.1, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the sensors; without a lag the readings are exact."""
        if not self.lag_s:
            return hardware
        share = -float(np.expm1(-1.0 / (CYCLE_HZ * self.lag_s)))
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, _Sluggish(self.joint, share)))


@dataclass(frozen=True, slots=True)
class _Sluggish:
    """State of a current sensor with a lag."""

    joint: Joint
    share: float
    """Share of the difference to the true current by which the reading changes in a cycle."""
    last_A: float = 0.0
    """Last reading."""

    def update(self, sensors: Sensors) -> "_Sluggish":
        """Return the state after one cycle, closer to the true current."""
        difference_A = float(sensors.current_A[self.joint]) - self.last_A
        return replace(self, last_A=self.last_A + self.share * difference_A)

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the lagging current."""
        late_A = self.last_A - float(sensors.current_A[self.joint])
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, late_A))


@dataclass(frozen=True, slots=True)
class OvalResolver(Effect):
    """Resolver with an oval rotor, whose error is a sine of twice the angle."""

    joint: Joint
    amplitude_rad: Annotated[float, ParameterSpec(-0.01, 0.01, unit="rad", typical=3e-4, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the resolvers."""
        return replace(hardware, resolver_errors=(*hardware.resolver_errors, self))

    def error_rad(self, output_rad: Array) -> Array:
        """Return the error of each resolver, shape (5,), at output angles of shape (5,)."""
        return at_joint(self.joint, self.amplitude_rad * float(np.sin(2.0 * output_rad[self.joint])))


@dataclass(frozen=True, slots=True)
class LateResolver(Effect):
    """Resolver that is read out late, interpolated between two cycles."""

    joint: Joint
    delay_s: Annotated[float, ParameterSpec(0.0, 0.5, unit="s", typical=0.01, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the sensors."""
        return replace(
            hardware, sensor_errors=(*hardware.sensor_errors, _Late(self.joint, self.delay_s * CYCLE_HZ))
        )


@dataclass(frozen=True, slots=True)
class _Late:
    """State of a late resolver."""

    joint: Joint
    cycles: float
    """Delay in cycles."""
    before_rad: tuple[float, ...] = ()
    """Buffer of true angles, the newest first."""

    def update(self, sensors: Sensors) -> "_Late":
        """Return the state with the present angle, which also fills the buffer in the first cycle."""
        now_rad, whole = float(sensors.resolver_rad[self.joint]), int(self.cycles) + 2
        return replace(self, before_rad=(now_rad, *(self.before_rad or (now_rad,) * whole))[:whole])

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the delayed angle."""
        whole, part = divmod(self.cycles, 1.0)
        newer_rad, older_rad = self.before_rad[int(whole)], self.before_rad[int(whole) + 1]
        then_rad = newer_rad + part * (older_rad - newer_rad)
        late_rad = then_rad - float(sensors.resolver_rad[self.joint])
        return replace(sensors, resolver_rad=sensors.resolver_rad + at_joint(self.joint, late_rad))
