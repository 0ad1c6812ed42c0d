"""What cold does to the actuators, and what noise does to their currents."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.effects.effect import Effect, Hardware
from sim.effects.size import Size, When

WARM_C = 20.0
COLD_C = -55.0
COULOMB_COLD = 2.5
"""Times the friction when warm, at the cold end."""
VISCOUS_COLD = 8.0
FAR_M = 1e3


@dataclass(frozen=True, slots=True)
class Ambient(Effect):
    """The temperature of the actuators: their grease stiffens in the cold, exponentially."""

    temperature_C: Annotated[float, Size(-130.0, 50.0, unit="degC", typical=-30.0, neutral=WARM_C)]

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


def surroundings(effects: Iterable[Effect], temperature_C: float) -> tuple[Effect, ...]:
    """An ambient of this temperature, unless one is among the effects."""
    return () if any(isinstance(effect, Ambient) for effect in effects) else (Ambient(temperature_C),)


@dataclass(frozen=True, slots=True)
class CurrentNoise(Effect):
    """White noise of the current sensors, one sigma."""

    current_A: Annotated[float, Size(0.0, 1.0, unit="A", typical=0.02)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """In place of what the sensors have."""
        return replace(hardware, current_noise_A=self.current_A)


@dataclass(frozen=True, slots=True)
class PowerLoss(Effect):
    """The motors lose their power, and the brakes fall in."""

    of_the_arm: ClassVar[bool] = False
    at_s: When

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
        nothing = replace(params.collision, padding_m=-FAR_M)
        return replace(params, collision=nothing)
