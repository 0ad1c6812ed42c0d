"""Sensors that read something else than what is."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final, Literal

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array, rotation_x, rotation_y
from fsw.messages import Sensors
from sim.disturbance import at_joint
from sim.effects.effect import Effect, Factor, Hardware, ParameterSpec, SmallAngle, with_element
from sim.effects.flight_params import link_of, with_link
from sim.effects.gears import WaveAmplitude

_ROTATION_ABOUT: Final = {"x": rotation_x, "y": rotation_y}


@dataclass(frozen=True, slots=True)
class _ReadingError(Effect):
    """An effect on what is read, noise and all."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """From the beginning."""
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, self))

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """The readings as they come, of what they would be."""
        raise NotImplementedError

    def update(self, sensors: Sensors) -> "_ReadingError":
        """The same: nothing is remembered."""
        return self


@dataclass(frozen=True, slots=True)
class CurrentGain(_ReadingError):
    """A current sensor reads so many times the current."""

    joint: Joint
    factor: Factor

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Scaled."""
        factor = 1.0 + at_joint(self.joint, self.factor - 1.0)
        return replace(sensors, current_A=sensors.current_A * factor)


@dataclass(frozen=True, slots=True)
class CurrentBias(_ReadingError):
    """A current sensor reads too much by a current."""

    joint: Joint
    current_A: Annotated[float, ParameterSpec(-2.0, 2.0, unit="A", typical=0.05, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Shifted."""
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, self.current_A))


@dataclass(frozen=True, slots=True)
class EncoderZero(Effect):
    """An encoder lost count since its joint was at its hardstop: it reads too much, by an angle."""

    built_in: ClassVar[bool] = False
    joint: Joint
    offset_rad: SmallAngle

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """The counter reads 0 at another angle."""
        return replace(
            hardware, counter_zero_rad=hardware.counter_zero_rad - at_joint(self.joint, self.offset_rad)
        )

    def on_params(self, params: Params) -> Params:
        """The link turned back by as much: a zero offset is a turn of the link about its joint."""
        if not self.offset_rad:
            return params
        frame = Frame(self.joint + 1)
        link = link_of(params, frame)
        turned = replace(link.transform, theta_rad=link.transform.theta_rad - self.offset_rad)
        return with_link(params, frame, replace(link, transform=turned))


@dataclass(frozen=True, slots=True)
class CounterStart(Effect):
    """An encoder's counter began at another angle of its motor; its joint has been at its hardstop since."""

    joint: Joint
    angle_rad: Annotated[float, ParameterSpec(-6.5, 6.5, unit="rad", typical=1.0)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """The counter reads 0 there."""
        zero = with_element(hardware.counter_zero_rad, self.joint, self.angle_rad)
        return replace(hardware, counter_zero_rad=zero)


@dataclass(frozen=True, slots=True)
class ResolverEccentricity(Effect):
    """A resolver is off its axis: it reads too much by a wave, once a turn of the output."""

    joint: Joint
    cosine_rad: WaveAmplitude
    sine_rad: WaveAmplitude
    """With the cosine it makes any amplitude and phase."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """From the beginning."""
        return replace(hardware, resolver_errors=(*hardware.resolver_errors, self))

    def error_rad(self, output_rad: Array) -> Array:
        """What each resolver (5) reads too much at these outputs (5)."""
        angle = float(output_rad[self.joint])
        return at_joint(self.joint, float(self.cosine_rad * np.cos(angle) + self.sine_rad * np.sin(angle)))


@dataclass(frozen=True, slots=True)
class GravityDirection(_ReadingError):
    """The rover's IMU is mounted askew: it sees gravity turned about an axis of the rover."""

    axis: Literal["x", "y"]
    angle_rad: Annotated[float, ParameterSpec(-0.1, 0.1, unit="rad", typical=5e-3, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Turned."""
        R = _ROTATION_ABOUT[self.axis](np.array(self.angle_rad))
        return replace(sensors, gravity_R_m_s2=R @ sensors.gravity_R_m_s2)
