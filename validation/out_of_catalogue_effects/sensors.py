"""What a sensor may do that no effect of the catalogue says."""

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
    """An effect on what is read."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """From the beginning."""
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, self))

    def update(self, sensors: Sensors) -> "_Reading":
        """Nothing is remembered, unless overridden."""
        return self


@dataclass(frozen=True, slots=True)
class TorqueRipple(_Reading):
    """A motor makes more torque of a current at some angles of its gear's wave than at others."""

    joint: Joint
    share: Annotated[float, ParameterSpec(0.0, 0.8, unit="1", typical=0.05, neutral=0.0)]
    turns: Annotated[int, ParameterSpec(1, 10000, unit="1", typical=150)] = 150

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """The current that it takes, by the angle that the encoder counts."""
        angle = self.turns * float(sensors.encoder_count[self.joint] * RAD_PER_COUNT[self.joint])
        more = at_joint(self.joint, self.share * float(np.sin(angle)))
        return replace(sensors, current_A=sensors.current_A * (1.0 + more))


@dataclass(frozen=True, slots=True)
class DeadCurrent(_Reading):
    """A current sensor reads nothing of the first part of a current, either way."""

    joint: Joint
    dead_A: Annotated[float, ParameterSpec(0.0, 2.0, unit="A", typical=0.05, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """What is beyond."""
        current_A = float(sensors.current_A[self.joint])
        lost_A = float(np.clip(current_A, -self.dead_A, self.dead_A))
        return replace(sensors, current_A=sensors.current_A - at_joint(self.joint, lost_A))


@dataclass(frozen=True, slots=True)
class SluggishCurrent(Effect):
    """A current sensor follows with a time constant."""

    joint: Joint
    lag_s: Annotated[float, ParameterSpec(0.0, 10.0, unit="s", typical=0.1, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """From the beginning; a sensor without a lag reads what is, bit for bit."""
        if not self.lag_s:
            return hardware
        share = -float(np.expm1(-1.0 / (CYCLE_HZ * self.lag_s)))
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, _Sluggish(self.joint, share)))


@dataclass(frozen=True, slots=True)
class _Sluggish:
    """What such a sensor has come to, and by which share of the rest it moves in a cycle."""

    joint: Joint
    share: float
    last_A: float = 0.0

    def update(self, sensors: Sensors) -> "_Sluggish":
        """A step nearer to what it is."""
        rest_A = float(sensors.current_A[self.joint]) - self.last_A
        return replace(self, last_A=self.last_A + self.share * rest_A)

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """What it has come to."""
        late_A = self.last_A - float(sensors.current_A[self.joint])
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, late_A))


@dataclass(frozen=True, slots=True)
class OvalResolver(Effect):
    """A resolver's rotor is oval: it reads too much by a wave twice a turn."""

    joint: Joint
    amplitude_rad: Annotated[float, ParameterSpec(-0.01, 0.01, unit="rad", typical=3e-4, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """From the beginning."""
        return replace(hardware, resolver_errors=(*hardware.resolver_errors, self))

    def error_rad(self, output_rad: Array) -> Array:
        """What each resolver (5) reads too much at these outputs (5)."""
        return at_joint(self.joint, self.amplitude_rad * float(np.sin(2.0 * output_rad[self.joint])))


@dataclass(frozen=True, slots=True)
class LateResolver(Effect):
    """A resolver is read out late; between two readings it says what lies between."""

    joint: Joint
    delay_s: Annotated[float, ParameterSpec(0.0, 0.5, unit="s", typical=0.01, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """From the beginning."""
        return replace(
            hardware, sensor_errors=(*hardware.sensor_errors, _Late(self.joint, self.delay_s * CYCLE_HZ))
        )


@dataclass(frozen=True, slots=True)
class _Late:
    """What such a resolver has to say yet, the newest first."""

    joint: Joint
    cycles: float
    before_rad: tuple[float, ...] = ()

    def update(self, sensors: Sensors) -> "_Late":
        """One more; the arm stood before the first."""
        now_rad, whole = float(sensors.resolver_rad[self.joint]), int(self.cycles) + 2
        return replace(self, before_rad=(now_rad, *(self.before_rad or (now_rad,) * whole))[:whole])

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """What there was then."""
        whole, part = divmod(self.cycles, 1.0)
        newer_rad, older_rad = self.before_rad[int(whole)], self.before_rad[int(whole) + 1]
        then_rad = newer_rad + part * (older_rad - newer_rad)
        late_rad = then_rad - float(sensors.resolver_rad[self.joint])
        return replace(sensors, resolver_rad=sensors.resolver_rad + at_joint(self.joint, late_rad))
