"""Another turret at the end of the arm: a stand-in of calibration, none, or one that is not as drawn."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params, PointMass
from fsw.dictionary.types import vector3
from fsw.kinematics.transforms import Array
from sim.effects.effect import Effect
from sim.effects.size import Size
from sim.effects.told import link_of, with_link

LEAST_KG = 1e-4
"""MuJoCo wants some mass where there is none."""


@dataclass(frozen=True, slots=True)
class StandInTurret(Effect):
    """What hangs on the turret interface has this mass, with its centre where the turret has it."""

    mass_kg: Annotated[float, Size(0.0, 60.0, unit="kg", typical=19.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Set the mass and scale the inertia with it."""
        _set_mass(spec, self.mass_kg)

    def on_params(self, params: Params) -> Params:
        """The far lump of the last link."""
        return _with_lump(params, replace(_lump(params), mass_kg=self.mass_kg))


@dataclass(frozen=True, slots=True)
class TurretMass(Effect):
    """The turret is heavier, with its centre where it was."""

    extra_kg: Annotated[float, Size(-20.0, 20.0, unit="kg", typical=1.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Add to the mass, and scale the inertia with it."""
        _set_mass(spec, float(spec.body("turret").mass) + self.extra_kg)

    def on_params(self, params: Params) -> Params:
        """The far lump of the last link."""
        lump = _lump(params)
        return _with_lump(params, replace(lump, mass_kg=lump.mass_kg + self.extra_kg))


@dataclass(frozen=True, slots=True)
class TurretCentre(Effect):
    """The turret's centre of mass is farther along an axis of frame Arm6."""

    axis: Literal["x", "y", "z"]
    shift_m: Annotated[float, Size(-0.1, 0.1, unit="m", typical=5e-3, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Shift the mass."""
        turret = spec.body("turret")
        turret.ipos = turret.ipos + self._shift()

    def on_params(self, params: Params) -> Params:
        """The far lump of the last link."""
        lump = _lump(params)
        return _with_lump(params, replace(lump, com_m=vector3(np.array(lump.com_m) + self._shift())))

    def _shift(self) -> Array:
        return np.array([self.shift_m * (self.axis == axis) for axis in "xyz"])


def hung_with(params: Params, stand_in_kg: float | None) -> Params:
    """Flight parameters of the arm with a stand-in of this mass; None for its own turret."""
    return params if stand_in_kg is None else StandInTurret(stand_in_kg).on_params(params)


def _set_mass(spec: mujoco.MjSpec, mass_kg: float) -> None:
    turret, mass_kg = spec.body("turret"), max(mass_kg, LEAST_KG)
    turret.inertia = turret.inertia * (mass_kg / turret.mass)
    turret.mass = mass_kg


def _lump(params: Params) -> PointMass:
    return link_of(params, Frame.ARM6).far


def _with_lump(params: Params, lump: PointMass) -> Params:
    return with_link(params, Frame.ARM6, replace(link_of(params, Frame.ARM6), far=lump))
