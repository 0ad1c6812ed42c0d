"""Surroundings of the arm: temperature, power, current noise, and the surfaces that it touches."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.effects.effect import Effect, Hardware, ParameterSpec, StartTime


@dataclass(frozen=True, slots=True)
class ContactStiffness(Effect):
    """What is touched is so many times as stiff under a pad."""

    factor: Annotated[float, ParameterSpec(0.05, 20.0, unit="1", typical=0.5, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Pads have their stiffness and damping in MuJoCo's direct format; the damping ratio stays."""
        for geom in spec.geoms:
            if geom.name.endswith("_pad"):
                geom.solref = geom.solref * np.array([self.factor, self.factor**0.5])


@dataclass(frozen=True, slots=True)
class SurfacePosition(Effect):
    """The rock's face is nearer than it was seen, along its normal."""

    offset_m: Annotated[float, ParameterSpec(-0.05, 0.05, unit="m", typical=3e-3, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Shift the rock, if there is one."""
        rock = spec.body("rock")
        if rock is not None:
            R = np.zeros(9)
            mujoco.mju_quat2Mat(R, rock.quat)
            rock.pos = rock.pos + self.offset_m * R.reshape(3, 3)[:, 2]


WARM_C = 20.0
COLD_C = -55.0
COULOMB_COLD = 2.5
"""Times the friction when warm, at the cold end."""
VISCOUS_COLD = 8.0
NO_PADDING_M = 1e3


@dataclass(frozen=True, slots=True)
class Ambient(Effect):
    """The temperature of the actuators: their grease stiffens in the cold, exponentially."""

    temperature_C: Annotated[float, ParameterSpec(-130.0, 50.0, unit="degC", typical=-30.0, neutral=WARM_C)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale Coulomb and viscous friction of motors and gears."""
        share = (WARM_C - self.temperature_C) / (WARM_C - COLD_C)
        for joint in Joint:
            motor = spec.joint(f"{joint.name.lower()}_motor")
            motor.frictionloss *= COULOMB_COLD**share
            motor.damping *= VISCOUS_COLD**share

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Windings begin at this temperature."""
        return replace(hardware, ambient_C=np.full(len(Joint), self.temperature_C))


def default_ambient(effects: Iterable[Effect], temperature_C: float) -> tuple[Effect, ...]:
    """An ambient of this temperature, unless one is among the effects."""
    return () if any(isinstance(effect, Ambient) for effect in effects) else (Ambient(temperature_C),)


@dataclass(frozen=True, slots=True)
class CurrentNoise(Effect):
    """White noise of the current sensors, one sigma."""

    current_A: Annotated[float, ParameterSpec(0.0, 1.0, unit="A", typical=0.02)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """In place of what the sensors have."""
        return replace(hardware, current_noise_A=self.current_A)


@dataclass(frozen=True, slots=True)
class PowerLoss(Effect):
    """The motors lose their power, and the brakes fall in."""

    built_in: ClassVar[bool] = False
    at_s: StartTime

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """From then on, for good."""
        return replace(hardware, power_until_s=self.at_s)


@dataclass(frozen=True, slots=True)
class NothingToTouch(Effect):
    """Rover, ground and rocks give way: for poses that are looked at one by one."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Take every geom out of the contacts."""
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0

    def on_params(self, params: Params) -> Params:
        """Nothing is to be kept clear of."""
        nothing = replace(params.collision, padding_m=-NO_PADDING_M)
        return replace(params, collision=nothing)
