"""What can break in the middle of a run."""

from dataclasses import dataclass, replace
from typing import Annotated, Final, Literal

import numpy as np

from fsw.dictionary.enums import Joint, Switch
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from sim.effects.effect import Hardware, ParameterSpec, Timed, with_element
from sim.effects.environment import PowerLoss
from sim.frames import FLIP, gravity_in_rover
from sim.plant import MOTOR_CONSTANT, Plant

SensorName = Literal[
    "encoder_count", "resolver_rad", "current_A", "winding_C", "switch_closed", "gravity_R_m_s2"
]
SensorFaultKind = Literal["frozen", "biased", "noisy", "nan"]
INTEGER_SENSORS: Final = ("encoder_count", "switch_closed")
CHANNEL_COUNTS: Final = {"switch_closed": len(Switch), "gravity_R_m_s2": 3}
"""Of what is not one for each joint."""
TiltAngle = Annotated[float, ParameterSpec(-0.6, 0.6, unit="rad", typical=0.05)]
"""What a rover stands on without falling over."""
CLOSED_THRESHOLD: Final = 0.5
"""A switch that reads more than this, bias and noise added to 0 or 1, is closed."""


@dataclass(frozen=True, slots=True)
class SensorFault(Timed):
    """A sensor that keeps its reading, reads too much, is noisy (one sigma), or reads no number.

    `index` is which joint, switch or axis; None is all of them. `size` is in the unit of the sensor, of a
    contact switch 1 is from open to closed. ValueError for a count or a switch that is to read no number, for
    an index that there is none of, and for a size that says nothing.
    """

    sensor: SensorName
    kind: SensorFaultKind
    index: int | None = None
    size: Annotated[float, ParameterSpec(-1e6, 1e6, unit="of the sensor", typical=1.0)] = 0.0

    def __post_init__(self) -> None:
        if self.kind == "nan" and self.sensor in INTEGER_SENSORS:
            raise ValueError(f"{self.sensor} cannot read nan; write frozen, biased or noisy")
        last = CHANNEL_COUNTS.get(self.sensor, len(Joint)) - 1
        if self.index is not None and not 0 <= self.index <= last:
            raise ValueError(f"index: {self.index} is outside 0 .. {last}, as there are of {self.sensor}")
        sized = self.kind in ("biased", "noisy")
        if sized and (self.size == 0 or (self.kind == "noisy" and self.size < 0)):
            raise ValueError(f"size: {self.size:g} says nothing of a sensor that is {self.kind}")
        if not sized and self.size != 0:
            raise ValueError(f"size: a sensor that is {self.kind} has none; leave it out")

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """From now on."""
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, ActiveSensorFault(self)))


@dataclass(frozen=True, slots=True, eq=False)
class ActiveSensorFault:
    """A sensor fault that has begun."""

    fault: SensorFault
    initial_reading: Array | None = None
    """What it read when it began."""

    def update(self, sensors: Sensors) -> "ActiveSensorFault":
        """The same, knowing what was read when it began."""
        return self if self.initial_reading is not None else replace(self, initial_reading=self._of(sensors))

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """The readings as they come, of what they would be."""
        true, fault = self._of(sensors), self.fault
        match fault.kind:
            case "frozen":
                wrong = true if self.initial_reading is None else self.initial_reading
            case "biased":
                wrong = true + fault.size
            case "noisy":
                wrong = true + fault.size * rng.standard_normal(true.size)
            case "nan":
                wrong = np.full_like(true, np.nan)
        if fault.index is not None:
            wrong = np.where(np.arange(true.size) == fault.index, wrong, true)
        match fault.sensor:
            case "encoder_count":
                return replace(sensors, encoder_count=np.rint(wrong).astype(np.int64))
            case "switch_closed":
                return replace(sensors, switch_closed=wrong > CLOSED_THRESHOLD)
            case "resolver_rad":
                return replace(sensors, resolver_rad=wrong)
            case "current_A":
                return replace(sensors, current_A=wrong)
            case "winding_C":
                return replace(sensors, winding_C=wrong)
            case "gravity_R_m_s2":
                return replace(sensors, gravity_R_m_s2=wrong)

    def _of(self, sensors: Sensors) -> Array:
        values: Array = np.asarray(getattr(sensors, self.fault.sensor), dtype=float)
        return values


@dataclass(frozen=True, slots=True)
class JointSeized(Timed):
    """A motor that does not turn any more."""

    joint: Joint

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Locked where it is, whatever its brake is asked."""
        plant.brake(self.joint, True)
        return _jam_brake(hardware, self.joint)


@dataclass(frozen=True, slots=True)
class BrakeStuck(Timed):
    """A brake that does not release any more; one that is released still falls in when asked."""

    joint: Joint

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """From the next time that it is on."""
        return _jam_brake(hardware, self.joint)


@dataclass(frozen=True, slots=True)
class WeakMotor(Timed):
    """A motor that turns a current into less torque; its current is read right."""

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.0, 1.0, unit="1", typical=-0.5, neutral=1.0)] = 0.5

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Scale the motor constant."""
        actuator = plant.at.actuators[self.joint]
        plant.model.actuator_gainprm[actuator, MOTOR_CONSTANT] *= self.factor
        plant.model.actuator_forcerange[actuator] *= self.factor
        constant = plant.torque_constant_Nm_A
        plant.torque_constant_Nm_A = with_element(constant, self.joint, self.factor * constant[self.joint])
        return hardware


@dataclass(frozen=True, slots=True)
class HotMotor(Timed):
    """A motor in surroundings of this temperature: its heater does not go off."""

    joint: Joint
    temperature_C: Annotated[float, ParameterSpec(-150.0, 250.0, unit="degC", typical=100.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """The winding is that much hotter at once."""
        return replace(hardware, ambient_C=with_element(hardware.ambient_C, self.joint, self.temperature_C))


@dataclass(frozen=True, slots=True)
class MissedCycles(Timed):
    """Flight software is not called for some cycles, and the motor controllers hold the last drive."""

    count: Annotated[int, ParameterSpec(1, 6400, unit="cycle", typical=8)]

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """With the next cycle."""
        return replace(hardware, missed_cycles=self.count)


@dataclass(frozen=True, slots=True)
class TiltStep(Timed):
    """The rover slips into another attitude."""

    roll_rad: TiltAngle
    pitch_rad: TiltAngle

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Gravity turns in the rover's frame."""
        gravity = plant.model.opt.gravity
        gravity[:] = FLIP * gravity_in_rover(self.roll_rad, self.pitch_rad, float(np.linalg.norm(gravity)))
        return hardware


@dataclass(frozen=True, slots=True)
class RockGone(Timed):
    """The rock crumbles: nothing is touched any more where its face was."""

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Take the face out of the contacts."""
        face = plant.model.geom("rock_face").id
        plant.model.geom_contype[face] = plant.model.geom_conaffinity[face] = 0
        return hardware


InjectedFault = (
    SensorFault
    | JointSeized
    | BrakeStuck
    | WeakMotor
    | HotMotor
    | MissedCycles
    | TiltStep
    | RockGone
    | PowerLoss
)
"""What can be injected into a run that is under way."""


def _jam_brake(hardware: Hardware, joint: Joint) -> Hardware:
    stuck = hardware.brake_stuck.copy()
    stuck[joint] = True
    return replace(hardware, brake_stuck=stuck)
