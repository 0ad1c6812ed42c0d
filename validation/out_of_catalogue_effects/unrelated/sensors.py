"""Effects unlike any of the catalogue, in the readings of sensors, for blind cases of unknown cause."""

from dataclasses import dataclass, replace
from typing import Annotated, Final, Literal

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from sim.effects.effect import Effect, Hardware, ParameterSpec, ReadingError, nominal_hardware
from sim.record import at_joint

RAD_PER_COUNT: Final = nominal_hardware().rad_per_count
FULL_RAD_S: Final = 0.02
"""Speed of an output at which the vibration of its motor has its amplitude."""


@dataclass(frozen=True, slots=True)
class HeaterOnLine(ReadingError):
    """Heater behind the current sensor of a motor, which a thermostat switches on and off."""

    joint: Joint
    heater_A: Annotated[float, ParameterSpec(-5.0, 5.0, unit="A", typical=0.05, neutral=0.0)]
    """Current of the heater, which flows through the sensor beside that of the motor."""
    period_s: Annotated[float, ParameterSpec(0.1, 1e4, unit="s", typical=5.0)] = 5.0
    """Time from one switching on to the next; it is off in the first half."""

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the current of the heater while it is on."""
        is_on = sensors.cycle / (CYCLE_HZ * self.period_s) % 1.0 >= 0.5
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, self.heater_A * is_on))


@dataclass(frozen=True, slots=True)
class RemanentCore(Effect):
    """Current sensor whose core stays magnetised, so that it reads more after a larger current."""

    joint: Joint
    remanence_A: Annotated[float, ParameterSpec(0.0, 5.0, unit="A", typical=0.05, neutral=0.0)]
    """Error to either side."""
    reversal_A: Annotated[float, ParameterSpec(0.01, 10.0, unit="A", typical=0.2)] = 0.2
    """Half the change of the current that reverses the error."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the sensors."""
        core = _Core(self.joint, self.remanence_A, self.reversal_A)
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, core))


@dataclass(frozen=True, slots=True)
class _Core:
    """State of a current sensor with a remanent core."""

    joint: Joint
    remanence_A: float
    reversal_A: float
    centre_A: float = 0.0
    """Current at which the present error would be zero."""

    def update(self, sensors: Sensors) -> "_Core":
        """Return the state in which the centre follows the current within the reversal."""
        current_A = float(sensors.current_A[self.joint])
        low_A, high_A = current_A - self.reversal_A, current_A + self.reversal_A
        return replace(self, centre_A=min(max(self.centre_A, low_A), high_A))

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the error of the core."""
        share = (self.centre_A - float(sensors.current_A[self.joint])) / self.reversal_A
        more_A = at_joint(self.joint, self.remanence_A * share)
        return replace(sensors, current_A=sensors.current_A + more_A)


@dataclass(frozen=True, slots=True)
class WrongBit(Effect):
    """Resolver whose converter has a bit of wrong weight, which adds an error where the bit is set."""

    joint: Joint
    error_rad: Annotated[float, ParameterSpec(-0.05, 0.05, unit="rad", typical=3e-4, neutral=0.0)]
    bit: Annotated[int, ParameterSpec(1, 16, unit="1", typical=7)] = 7
    """Number of the bit, of which the first is half a turn."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the resolvers."""
        converter = _Converter(self.joint, self.error_rad, 2.0 * np.pi / 2**self.bit)
        return replace(hardware, resolver_errors=(*hardware.resolver_errors, converter))


@dataclass(frozen=True, slots=True)
class _Converter:
    """Error of a converter with a bit of wrong weight."""

    joint: Joint
    more_rad: float
    weight_rad: float

    def error_rad(self, output_rad: Array) -> Array:
        """Return the error of each resolver, shape (5,), at output angles of shape (5,)."""
        is_set = int(np.floor(output_rad[self.joint] / self.weight_rad)) % 2
        return at_joint(self.joint, self.more_rad * is_set)


@dataclass(frozen=True, slots=True)
class VibratedImu(Effect):
    """IMU of the rover whose reading shifts with the vibration of the motors, the square of their speeds."""

    axis: Literal["x", "y", "z"]
    shift_m_s2: Annotated[float, ParameterSpec(-1.0, 1.0, unit="m/s2", typical=2e-3, neutral=0.0)]
    """Shift for each motor whose output moves at 0.02 rad/s."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the sensors."""
        shaken = _Shaken("xyz".index(self.axis), self.shift_m_s2)
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, shaken))


@dataclass(frozen=True, slots=True)
class _Shaken:
    """State of an IMU under vibration."""

    axis: int
    shift_m_s2: float
    last_count: tuple[int, ...] = ()
    """Counts of the last cycle; none before the first one."""
    power: float = 0.0
    """Sum of the squares of the speeds, relative to the full speed."""

    def update(self, sensors: Sensors) -> "_Shaken":
        """Return the state with the speeds since the last cycle."""
        now = tuple(int(count) for count in sensors.encoder_count)
        moved = np.array(now) - np.array(self.last_count or now)
        share = moved * RAD_PER_COUNT * CYCLE_HZ / FULL_RAD_S
        return replace(self, last_count=now, power=float(share @ share))

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the shift along the axis."""
        gravity_R_m_s2 = sensors.gravity_R_m_s2.copy()
        gravity_R_m_s2[self.axis] += self.shift_m_s2 * self.power
        return replace(sensors, gravity_R_m_s2=gravity_R_m_s2)
