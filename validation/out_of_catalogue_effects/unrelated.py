"""Effects unlike any of the catalogue, for blind cases of unknown cause."""

from dataclasses import dataclass, replace
from typing import Annotated, Final, Literal

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from sim.effects.effect import EachCycle, Effect, Hardware, ParameterSpec, ReadingError, nominal_hardware
from sim.frames import FLIP
from sim.mujoco_settings import GAINS
from sim.plant import SPRING_NAMES, Plant
from sim.record import Disturbance, at_joint

LOAD_NM: Final = 100.0
"""Load at which slip has its amplitude."""


@dataclass(frozen=True, slots=True)
class DeadBand(EachCycle):
    """Motor controller with a dead band, within which it does not correct the error of its angle."""

    joint: Joint
    band_rad: Annotated[float, ParameterSpec(0.0, 2e-3, unit="rad", typical=1e-5, neutral=0.0)]
    """Error to either side that it does not correct."""

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        error_rad = float(plant.data.ctrl[2 * self.joint] - plant.motor_rad()[self.joint])
        plant.data.ctrl[2 * self.joint] -= min(max(error_rad, -self.band_rad), self.band_rad)
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class Dither(EachCycle):
    """Motor controller that adds an oscillation to its set-point, against sticking."""

    joint: Joint
    amplitude_rad: Annotated[float, ParameterSpec(0.0, 2e-3, unit="rad", typical=1e-5, neutral=0.0)]
    frequency_Hz: Annotated[float, ParameterSpec(0.1, 31.0, unit="Hz", typical=5.0)] = 5.0

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        phase_rad = 2.0 * np.pi * self.frequency_Hz * float(plant.data.time)
        plant.data.ctrl[2 * self.joint] += self.amplitude_rad * float(np.sin(phase_rad))
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class FeedForward(EachCycle):
    """Motor controller that adds a torque in the direction of its set-point rate."""

    joint: Joint
    torque_Nm: Annotated[float, ParameterSpec(0.0, 1000.0, unit="N m", typical=50.0, neutral=0.0)]
    rate_rad_s: Annotated[float, ParameterSpec(1e-5, 0.1, unit="rad/s", typical=1e-3)] = 1e-3
    """Rate at which it is three quarters of the full torque."""

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        return 0.0

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        share = float(np.tanh(plant.data.ctrl[2 * self.joint + 1] / self.rate_rad_s))
        actuator = plant.at.actuators[self.joint]
        _, integral_gain_Nm_rads, _ = plant.model.actuator_gainprm[actuator, GAINS]
        integral = plant.model.actuator_actadr[actuator]
        plant.data.act[integral] += self.torque_Nm * (share - state) / float(integral_gain_Nm_rads)
        return share, Disturbance()


@dataclass(frozen=True, slots=True)
class KickingBrake(EachCycle):
    """Brake that turns its motor by an angle as it seats, each time that it is applied."""

    joint: Joint
    kick_rad: Annotated[float, ParameterSpec(-5e-3, 5e-3, unit="rad", typical=5e-5, neutral=0.0)]
    seats_s: Annotated[float, ParameterSpec(0.01, 100.0, unit="s", typical=0.2)] = 0.2
    """Time constant."""

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        return 0.0

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        brake = plant.at.brake[self.joint]
        if not plant.data.eq_active[brake]:
            return 0.0, Disturbance()
        more_rad = (state - self.kick_rad) * float(np.expm1(-1.0 / (CYCLE_HZ * self.seats_s)))
        plant.model.eq_data[brake, 0] += more_rad
        return state + more_rad, Disturbance()


@dataclass(frozen=True, slots=True)
class SlippingBelt(EachCycle):
    """Belt between motor and output that slips under load by a share of the way that it moves."""

    joint: Joint
    share: Annotated[float, ParameterSpec(0.0, 0.5, unit="1", typical=4e-3, neutral=0.0)]
    """Share at a load of 100 N m."""

    def begin(self, plant: Plant, hardware: Hardware) -> tuple[float, float]:
        return float(plant.motor_rad()[self.joint]), 0.0

    def cycle(
        self, plant: Plant, hardware: Hardware, state: tuple[float, float]
    ) -> tuple[tuple[float, float], Disturbance]:
        (before_rad, slip_rad), now_rad = state, float(plant.motor_rad()[self.joint])
        load = float(plant.gear_torque_Nm()[self.joint]) / LOAD_NM
        slip_rad += self.share * load * abs(now_rad - before_rad)
        return (now_rad, slip_rad), Disturbance(gear_rad=at_joint(self.joint, slip_rad))


ALONG_Z: Final = 5
"""Index of the translation along the axis of a joint among the springs of the link that follows."""


@dataclass(frozen=True, slots=True)
class ScrewingBearing(EachCycle):
    """Bearing that moves along its axis as its joint turns, like a screw.

    ValueError if the joint is the last one, whose link has no spring to shift.
    """

    joint: Joint
    pitch_m_rad: Annotated[float, ParameterSpec(-0.03, 0.03, unit="m/rad", typical=3e-4, neutral=0.0)]

    def __post_init__(self) -> None:
        if self.joint + 1 >= len(SPRING_NAMES):
            raise ValueError("joint: the link after turret is rigid; take another joint")

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        shift_m = self.pitch_m_rad * float(plant.output_rad()[self.joint])
        plant.model.qpos_spring[plant.at.springs[self.joint + 1][ALONG_Z]] = shift_m
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class SteadyWind(EachCycle):
    """Steady wind along an axis of the rover, which pushes on a link with a force."""

    link: Literal["link2", "link3", "link4"]
    axis: Literal["x", "y"]
    force_N: Annotated[float, ParameterSpec(-400.0, 400.0, unit="N", typical=4.0, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        axis, body = "xyz".index(self.axis), plant.model.body(f"{self.link}_far").id
        plant.data.xfrc_applied[body, axis] = self.force_N * FLIP[axis]
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class SwayingRover(EachCycle):
    """Rover that sways on its suspension for the whole of a session, by an angle about one of its axes."""

    axis: Literal["x", "y", "z"]
    angle_rad: Annotated[float, ParameterSpec(0.0, 0.02, unit="rad", typical=2e-4, neutral=0.0)]
    frequency_Hz: Annotated[float, ParameterSpec(0.01, 2.0, unit="Hz", typical=0.4)] = 0.4

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        phase_rad = 2.0 * np.pi * self.frequency_Hz * float(plant.data.time)
        turned_rad = self.angle_rad * float(np.sin(phase_rad))
        plant.model.qpos_spring[plant.at.springs[0]["xyz".index(self.axis)]] = turned_rad
        return None, Disturbance()


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
        gravity_R_m_s2 = sensors.gravity_R_m_s2.copy()
        gravity_R_m_s2[self.axis] += self.shift_m_s2 * self.power
        return replace(sensors, gravity_R_m_s2=gravity_R_m_s2)
