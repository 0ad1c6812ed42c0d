"""Faults that can begin during a run."""

from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from sim.effects.effect import Hardware, ParameterSpec, Timed, with_element
from sim.effects.environment import PowerLoss
from sim.frames import FLIP, gravity_in_rover
from sim.mujoco_settings import LEAST_GAIN_SHARE, MOTOR_CONSTANT
from sim.plant import Plant

SensorName = Literal[
    "encoder_count",
    "resolver_rad",
    "current_A",
    "winding_C",
    "structure_C",
    "switch_closed",
    "gravity_R_m_s2",
]
SensorFaultKind = Literal["frozen", "biased", "noisy", "nan"]
INTEGER_SENSORS: Final = ("encoder_count", "switch_closed")
MAX_SWITCHES: Final = 32
CHANNEL_COUNTS: Final = {"switch_closed": MAX_SWITCHES, "gravity_R_m_s2": 3, "structure_C": 1}
"""Most channels of the sensors that do not have one for each joint."""
TiltAngle = Annotated[float, ParameterSpec(-0.6, 0.6, unit="rad", typical=0.05)]
"""Angle at which a rover can stand."""
CLOSED_THRESHOLD: Final = 0.5
"""Reading above which a switch is closed, after bias and noise are added to 0 or 1."""


@dataclass(frozen=True, slots=True)
class SensorFault(Timed):
    """Sensor whose reading is frozen, biased, noisy (one sigma), or not a number.

    `index` is the joint, switch or axis; None means all of them. `size` is in the unit of the sensor. For a
    contact switch, 1 is the difference between open and closed.

    Raises:
        ValueError: a count or a switch cannot be NaN, or `index` or `size` does not fit the sensor.
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
            raise ValueError(f"index: {self.index} is outside 0 .. {last}, the range of {self.sensor}")
        sized = self.kind in ("biased", "noisy")
        if sized and (self.size == 0 or (self.kind == "noisy" and self.size < 0)):
            raise ValueError(
                f"size: {self.size:g} has no meaning for a sensor that is {self.kind}; write another size"
            )
        if not sized and self.size != 0:
            raise ValueError(f"size: a sensor that is {self.kind} has none; leave it out")

    def find_misfit(self, params: Params) -> str | None:
        """Return why the arm of these parameters cannot have this fault, None if it can."""
        count = len(params.switches)
        if self.sensor != "switch_closed" or self.index is None or self.index < count:
            return None
        if not count:
            return "index: this arm has no contact switch"
        return f"index: {self.index} is outside 0 .. {count - 1}, the range of {self.sensor} of this arm"

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, ActiveSensorFault(self)))


@dataclass(frozen=True, slots=True, eq=False)
class ActiveSensorFault:
    """Sensor fault that has begun."""

    fault: SensorFault
    initial_reading: Array | None = None
    """Reading when the fault began."""

    def update(self, sensors: Sensors) -> "ActiveSensorFault":
        """Return the same fault with the reading of its first cycle."""
        return self if self.initial_reading is not None else replace(self, initial_reading=self._of(sensors))

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        true, fault = self._of(sensors), self.fault
        match fault.kind:
            case "frozen":
                wrong = true if self.initial_reading is None else self.initial_reading
            case "biased":
                wrong = true + fault.size
            case "noisy":
                wrong = true + fault.size * rng.standard_normal(true.shape)
            case "nan":
                wrong = np.full_like(true, np.nan)
        if fault.sensor == "structure_C":
            return replace(sensors, structure_C=float(wrong))
        if fault.index is not None:
            wrong = np.where(np.arange(true.size) == fault.index, wrong, true)
        match fault.sensor:
            case "encoder_count":
                return replace(sensors, encoder_count=np.rint(wrong).astype(np.int64))
            case "switch_closed":
                return replace(sensors, switch_closed=wrong > CLOSED_THRESHOLD)
            case name:
                found: Any = {name: wrong}
                return replace(sensors, **found)

    def _of(self, sensors: Sensors) -> Array:
        values: Array = np.asarray(getattr(sensors, self.fault.sensor), dtype=float)
        return values


@dataclass(frozen=True, slots=True)
class JointSeized(Timed):
    """Motor that is locked at its present angle."""

    joint: Joint

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Lock the motor, whatever is commanded to its brake."""
        plant.brake(self.joint, True)
        return replace(hardware, brake_stuck=with_element(hardware.brake_stuck, self.joint, True))


@dataclass(frozen=True, slots=True)
class BrakeStuck(Timed):
    """Brake that does not release; a released one still engages on command."""

    joint: Joint

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Keep the brake on from the next time that it engages."""
        return replace(hardware, brake_stuck=with_element(hardware.brake_stuck, self.joint, True))


@dataclass(frozen=True, slots=True)
class WeakMotor(Timed):
    """Motor that makes less torque of a current; the current reading is right.

    At a factor of 0 it makes a billionth: the current is the torque over the constant.
    """

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.0, 1.0, unit="1", typical=-0.5, neutral=1.0)] = 0.5

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        actuator, share = plant.at.actuators[self.joint], max(self.factor, LEAST_GAIN_SHARE)
        plant.model.actuator_gainprm[actuator, MOTOR_CONSTANT] *= share
        plant.model.actuator_forcerange[actuator] *= share
        constant = plant.torque_constant_Nm_A
        plant.torque_constant_Nm_A = with_element(constant, self.joint, share * constant[self.joint])
        return hardware


@dataclass(frozen=True, slots=True)
class HotMotor(Timed):
    """Motor that goes to this ambient temperature, 32 K a second, because its heater stays on."""

    joint: Joint
    temperature_C: Annotated[float, ParameterSpec(-150.0, 250.0, unit="degC", typical=100.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        return replace(hardware, ambient_C=with_element(hardware.ambient_C, self.joint, self.temperature_C))


@dataclass(frozen=True, slots=True)
class MissedCycles(Timed):
    """Cycles in which flight software is not called; the motor controllers hold the last command."""

    count: Annotated[int, ParameterSpec(1, 6400, unit="cycle", typical=8)]

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        return replace(hardware, missed_cycles=self.count)


@dataclass(frozen=True, slots=True)
class TiltStep(Timed):
    """Sudden change of the attitude of the rover."""

    roll_rad: TiltAngle
    pitch_rad: TiltAngle

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        gravity = plant.model.opt.gravity
        gravity[:] = FLIP * gravity_in_rover(self.roll_rad, self.pitch_rad, float(np.linalg.norm(gravity)))
        return hardware


@dataclass(frozen=True, slots=True)
class RockGone(Timed):
    """Loss of the rock face, which no longer makes contact."""

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Exclude the face from the contacts, if there is one."""
        face = mujoco.mj_name2id(plant.model, mujoco.mjtObj.mjOBJ_GEOM, "rock_face")
        if face >= 0:
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
"""Faults that can be injected into a run."""
