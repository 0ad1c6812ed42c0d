"""Effects of the truth that the catalogue has too: friction and armature."""

import math

import mujoco

from simgap.effects.effect import Family
from validation.robot_cases.truth import Run, TrueEffect


class Armature(TrueEffect):
    """Inertia of the rotor; size [kg m2]."""

    name = "armature"
    family = Family.INERTIA

    def build(self, spec: mujoco.MjSpec) -> None:
        spec.joint(self.place).armature += self.size


class Viscous(TrueEffect):
    """Friction in proportion to the velocity; size [N m s/rad]."""

    name = "viscous friction"
    family = Family.FRICTION

    def torque_Nm(self, run: Run) -> float:
        return -self.size * run.v[self.j]


class Coulomb(TrueEffect):
    """Dry friction; size [N m]."""

    name = "Coulomb friction"
    family = Family.FRICTION

    def friction_Nm(self, run: Run) -> float:
        return self.size


class Stribeck(TrueEffect):
    """Dry friction that is larger near rest; size [N m], shape: Stribeck velocity."""

    name = "Stribeck friction"
    family = Family.FRICTION

    def friction_Nm(self, run: Run) -> float:
        width_rad_s = 0.03 * 5.0**self.shape
        return self.size * math.exp(-((run.v[self.j] / width_rad_s) ** 2))


class LoadFriction(TrueEffect):
    """Dry friction in proportion to the load of the gear; size: share of the load."""

    name = "load-dependent friction"
    family = Family.FRICTION
    needs_load = True

    def friction_Nm(self, run: Run) -> float:
        return self.size * abs(run.load_Nm[self.j])


class AsymmetricFriction(TrueEffect):
    """Dry friction in one direction only, that of the sign; size [N m].

    The range of a friction from -(F + s) to F is one of F + s / 2 beside a constant torque of -s / 2.
    """

    name = "asymmetric friction"
    family = Family.FRICTION

    def friction_Nm(self, run: Run) -> float:
        return 0.5 * abs(self.size)

    def torque_Nm(self, run: Run) -> float:
        return -0.5 * self.size


class TemperatureFriction(TrueEffect):
    """Dry friction of a cold joint; size: [N m] per 10 K below 40 degC."""

    name = "temperature-dependent friction"
    family = Family.FRICTION

    def friction_Nm(self, run: Run) -> float:
        return self.size * (40.0 - run.temperature_degC) / 10.0
