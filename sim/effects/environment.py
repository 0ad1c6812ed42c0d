"""Surroundings of the arm: temperature, power, noise, surfaces to touch, and how the plant is computed."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.arm_model.description import VISCOUS_COLD
from sim.effects.effect import Effect, Hardware, ParameterSpec, StartTime
from sim.setting import WARM_C

COLD_C = -55.0
COULOMB_COLD = 2.5
"""Factor on the friction at WARM_C that gives that at COLD_C."""
NO_PADDING_M = 1e3
FARTHEST_SURFACE_M: Final = 0.05
"""Largest offset of a surface from its measured position."""


@dataclass(frozen=True, slots=True)
class ContactStiffness(Effect):
    """Factor on the stiffness of surfaces under the contact pads."""

    factor: Annotated[float, ParameterSpec(0.05, 20.0, unit="1", typical=0.5, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale stiffness and damping of the pads, at a constant damping ratio.

        They are in MuJoCo's direct format.
        """
        for geom in spec.geoms:
            if geom.name.endswith("_pad"):
                geom.solref = geom.solref * np.array([self.factor, self.factor**0.5])


@dataclass(frozen=True, slots=True)
class Slip(Effect):
    """Share of the friction under the contact pads that is missing: a pressed tool slips aside."""

    share: Annotated[float, ParameterSpec(0.0, 0.95, unit="1", typical=0.4, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        for geom in spec.geoms:
            if geom.name.endswith("_pad"):
                geom.friction[0] *= 1.0 - self.share


@dataclass(frozen=True, slots=True)
class SurfacePosition(Effect):
    """Offset of the true rock face along its normal from its measured position."""

    offset_m: Annotated[
        float, ParameterSpec(-FARTHEST_SURFACE_M, FARTHEST_SURFACE_M, unit="m", typical=3e-3, neutral=0.0)
    ]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Shift the rock, if there is one."""
        rock = spec.body("rock")
        if rock is not None:
            R = np.zeros(9)
            mujoco.mju_quat2Mat(R, rock.quat)
            rock.pos = rock.pos + self.offset_m * R.reshape(3, 3)[:, 2]


@dataclass(frozen=True, slots=True)
class Ambient(Effect):
    """Temperature of actuators and structure.

    The friction of grease grows exponentially in the cold. Links and tools grow in proportion.
    """

    temperature_C: Annotated[float, ParameterSpec(-130.0, 50.0, unit="degC", typical=-30.0, neutral=WARM_C)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        share = (WARM_C - self.temperature_C) / (WARM_C - COLD_C)
        for joint in Joint:
            motor = spec.joint(f"{joint.name.lower()}_motor")
            motor.frictionloss *= COULOMB_COLD**share
            motor.damping *= VISCOUS_COLD**share

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Set the temperature of the structure, and the initial one of the windings."""
        ambient_C = np.full(len(Joint), self.temperature_C)
        return replace(hardware, ambient_C=ambient_C, structure_C=self.temperature_C)


@dataclass(frozen=True, slots=True)
class StructureTemperature(Effect):
    """Temperature of links and tools, where heaters keep the actuators at another."""

    temperature_C: Annotated[float, ParameterSpec(-130.0, 70.0, unit="degC", typical=-30.0, neutral=WARM_C)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        return replace(hardware, structure_C=self.temperature_C)


def default_ambient(effects: Iterable[Effect], temperature_C: float) -> tuple[Effect, ...]:
    """Return an ambient of this temperature, or nothing if the effects contain one."""
    return () if any(isinstance(effect, Ambient) for effect in effects) else (Ambient(temperature_C),)


@dataclass(frozen=True, slots=True)
class CurrentNoise(Effect):
    """White noise of the current sensors, one sigma."""

    current_A: Annotated[float, ParameterSpec(0.0, 1.0, unit="A", typical=0.02)]

    def on_hardware(self, hardware: Hardware) -> Hardware:
        return replace(hardware, current_noise_A=self.current_A)


@dataclass(frozen=True, slots=True)
class PowerLoss(Effect):
    """Loss of the motor power for the rest of the run; the brakes engage."""

    built_in: ClassVar[bool] = False
    at_s: StartTime

    def on_hardware(self, hardware: Hardware) -> Hardware:
        return replace(hardware, power_until_s=self.at_s)


@dataclass(frozen=True, slots=True)
class NothingToTouch(Effect):
    """Removal of all contacts with rover, ground and rocks, for poses in free air."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0

    def on_params(self, params: Params) -> Params:
        """Disable the collision check by a large negative padding."""
        nothing = replace(params.collision, padding_m=-NO_PADDING_M)
        return replace(params, collision=nothing)


SOLVER_ITERATIONS: Final = 30
"""Iterations of the dual solver, which always uses all; three times as many change single counts."""

LEAST_EXPLICIT_SUBSTEPS: Final = 6
"""The explicit scheme diverges with fewer."""


@dataclass(frozen=True, slots=True)
class Numerics(Effect):
    """Shorter time step of the plant, and another integration scheme for gears and motors.

    MuJoCo's discrete integrator evaluates springs and dampers at the end of a step.
    With the dual solver it does so for single hinges only.
    Gears, outputs and motors are then evaluated at the start of the step.
    """

    scheme: Literal["implicit", "explicit"]
    substeps: Annotated[int, ParameterSpec(2, 20, unit="1", typical=6)] = LEAST_EXPLICIT_SUBSTEPS
    """Steps per step of the model."""

    def __post_init__(self) -> None:
        if self.scheme == "explicit" and self.substeps < LEAST_EXPLICIT_SUBSTEPS:
            least = LEAST_EXPLICIT_SUBSTEPS
            raise ValueError(
                f"substeps: {self.substeps} diverges; the explicit scheme takes at least {least}"
            )

    def on_model(self, spec: mujoco.MjSpec) -> None:
        spec.option.timestep /= self.substeps
        if self.scheme == "explicit":
            spec.option.solver = mujoco.mjtSolver.mjSOL_PGS
            spec.option.iterations = SOLVER_ITERATIONS
