"""Effects on the readings of the sensors."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final, Literal

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array, rotation_x, rotation_y
from fsw.messages import Sensors
from sim.effects.effect import (
    Effect,
    Factor,
    Hardware,
    ParameterSpec,
    ReadingError,
    SmallAngle,
    link_of,
    refuse_first_joint,
    scale_joint,
    with_element,
    with_link,
)
from sim.effects.gears import WaveAmplitude
from sim.record import at_joint

_ROTATION_ABOUT: Final = {"x": rotation_x, "y": rotation_y}


@dataclass(frozen=True, slots=True)
class CurrentGain(ReadingError):
    """Factor on the reading of a current sensor."""

    joint: Joint
    factor: Factor

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        factor = 1.0 + at_joint(self.joint, self.factor - 1.0)
        return replace(sensors, current_A=sensors.current_A * factor)


@dataclass(frozen=True, slots=True)
class CurrentBias(ReadingError):
    """Constant error of a current sensor."""

    joint: Joint
    current_A: Annotated[float, ParameterSpec(-2.0, 2.0, unit="A", typical=0.05, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, self.current_A))


@dataclass(frozen=True, slots=True)
class CurrentCrosstalk(ReadingError):
    """Share of the current of the next joint towards the rover in the reading of a current sensor.

    Raises:
        ValueError: the joint is the first one.
    """

    joint: Joint
    share: Annotated[float, ParameterSpec(-0.5, 0.5, unit="1", typical=0.05, neutral=0.0)]

    def __post_init__(self) -> None:
        refuse_first_joint(self.joint)

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        more_A = self.share * float(sensors.current_A[self.joint - 1])
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, more_A))


@dataclass(frozen=True, slots=True)
class EncoderScale(Effect):
    """Relative error of the counts of an encoder for a turn of its output."""

    joint: Joint
    error: Annotated[float, ParameterSpec(-0.05, 0.05, unit="1", typical=1e-3, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        scale = 1.0 + at_joint(self.joint, self.error)
        return replace(hardware, rad_per_count=hardware.rad_per_count / scale)

    def on_params(self, params: Params) -> Params:
        return scale_joint(params, self.joint, "gear_ratio", 1.0 + self.error)


@dataclass(frozen=True, slots=True)
class EncoderZero(Effect):
    """Constant error of an encoder since its homing, from lost counts."""

    built_in: ClassVar[bool] = False
    joint: Joint
    offset_rad: SmallAngle

    def on_hardware(self, hardware: Hardware) -> Hardware:
        return replace(
            hardware, counter_zero_rad=hardware.counter_zero_rad - at_joint(self.joint, self.offset_rad)
        )

    def on_params(self, params: Params) -> Params:
        """Turn the link back: a zero offset is a rotation of the link about its joint."""
        if not self.offset_rad:
            return params
        frame = Frame(self.joint + 1)
        link = link_of(params, frame)
        turned = replace(link.transform, theta_rad=link.transform.theta_rad - self.offset_rad)
        return with_link(params, frame, replace(link, transform=turned))


@dataclass(frozen=True, slots=True)
class CounterStart(Effect):
    """Motor angle at which the counter of an encoder started, before the homing of its joint."""

    joint: Joint
    angle_rad: Annotated[float, ParameterSpec(-6.5, 6.5, unit="rad", typical=1.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        zero = with_element(hardware.counter_zero_rad, self.joint, self.angle_rad)
        return replace(hardware, counter_zero_rad=zero)


@dataclass(frozen=True, slots=True)
class ResolverEccentricity(Effect):
    """Periodic error of a resolver off its axis, with one period per output turn."""

    joint: Joint
    cosine_rad: WaveAmplitude
    sine_rad: WaveAmplitude
    """Sine part; with the cosine part it gives any amplitude and phase."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        return replace(hardware, resolver_errors=(*hardware.resolver_errors, self))

    def error_rad(self, output_rad: Array) -> Array:
        angle = float(output_rad[self.joint])
        return at_joint(self.joint, float(self.cosine_rad * np.cos(angle) + self.sine_rad * np.sin(angle)))


@dataclass(frozen=True, slots=True)
class ResolverScale(Effect):
    """Error of a resolver in proportion to its angle."""

    joint: Joint
    error: Annotated[float, ParameterSpec(-0.05, 0.05, unit="1", typical=3e-4, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        return replace(hardware, resolver_errors=(*hardware.resolver_errors, self))

    def error_rad(self, output_rad: Array) -> Array:
        return at_joint(self.joint, self.error * float(output_rad[self.joint]))


@dataclass(frozen=True, slots=True)
class GravityDirection(ReadingError):
    """Misalignment of the IMU of the rover about an axis, which rotates the measured gravity."""

    axis: Literal["x", "y"]
    angle_rad: Annotated[float, ParameterSpec(-0.1, 0.1, unit="rad", typical=5e-3, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        R = _ROTATION_ABOUT[self.axis](np.array(self.angle_rad))
        return replace(sensors, gravity_R_m_s2=R @ sensors.gravity_R_m_s2)


@dataclass(frozen=True, slots=True)
class StructureSensor(Effect):
    """Offset of the temperature that the sensor of the structure reads."""

    offset_K: Annotated[float, ParameterSpec(-20.0, 20.0, unit="K", typical=0.3, neutral=0.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        return replace(hardware, structure_offset_K=hardware.structure_offset_K + self.offset_K)

    def on_params(self, params: Params) -> Params:
        """Set what the sensor reads at the temperature of the calibration."""
        calibration_C = params.heat.calibration_C + self.offset_K
        return replace(params, heat=replace(params.heat, calibration_C=calibration_C))
