"""Another turret at the end of the arm: a stand-in of calibration, or none."""

from dataclasses import dataclass, replace

import mujoco

from fsw.dictionary.params import Params
from sim.effects.effect import Effect

LEAST_KG = 1e-4
"""MuJoCo wants some mass where there is none."""


@dataclass(frozen=True, slots=True)
class TurretMass(Effect):
    """What hangs on the turret interface has this mass, with its centre where the turret has it."""

    mass_kg: float

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Set the mass and scale the inertia with it."""
        turret = spec.body("turret")
        mass_kg = max(self.mass_kg, LEAST_KG)
        turret.inertia = turret.inertia * (mass_kg / turret.mass)
        turret.mass = mass_kg

    def on_params(self, params: Params) -> Params:
        """The far lump of the last link."""
        link = params.links.arm6
        changed = replace(link, far=replace(link.far, mass_kg=self.mass_kg))
        return replace(params, links=replace(params.links, arm6=changed))
