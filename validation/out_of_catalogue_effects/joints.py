"""Effects of joints that the catalogue lacks, for blind cases with an unknown cause."""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from sim.disturbance import Disturbance, at_joint
from sim.effects.effect import EachCycle, Hardware, ParameterSpec
from sim.plant import Plant

Torque = Annotated[float, ParameterSpec(0.0, 400.0, unit="N m", typical=20.0, neutral=0.0)]
LOAD_NM: Final = 100.0


@dataclass(frozen=True, slots=True)
class TightSpots(EachCycle):
    """Bearing with periodic tight spots, where friction rises to a torque."""

    joint: Joint
    torque_Nm: Torque
    apart_rad: Annotated[float, ParameterSpec(1e-3, 6.3, unit="rad", typical=0.06)] = 0.06

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Return the friction at the present output angle."""
        share = np.sin(np.pi * float(plant.output_rad()[self.joint]) / self.apart_rad) ** 4
        return None, Disturbance(friction_Nm=at_joint(self.joint, self.torque_Nm * float(share)))


@dataclass(frozen=True, slots=True)
class DraggingBrake(EachCycle):
    """Brake that drags after its release, with a torque that decays."""

    joint: Joint
    torque_Nm: Torque
    fades_s: Annotated[float, ParameterSpec(0.01, 100.0, unit="s", typical=1.5)] = 1.5

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        """Return the torque with which it drags: the full one while it is applied."""
        return self.torque_Nm

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        """Return the friction, and the torque of the next cycle."""
        if plant.data.eq_active[plant.at.brake[self.joint]]:
            return self.torque_Nm, Disturbance()
        return state * float(np.exp(-1.0 / (CYCLE_HZ * self.fades_s))), Disturbance(
            friction_Nm=at_joint(self.joint, state)
        )


@dataclass(frozen=True, slots=True)
class GreaseAside(EachCycle):
    """Grease that has set overnight: friction is larger until motion has displaced it."""

    joint: Joint
    torque_Nm: Torque
    way_rad: Annotated[float, ParameterSpec(1e-3, 6.3, unit="rad", typical=0.04)] = 0.04

    def begin(self, plant: Plant, hardware: Hardware) -> tuple[float, float]:
        """Return the motor angle and the distance travelled, zero."""
        return float(plant.motor_rad()[self.joint]), 0.0

    def cycle(
        self, plant: Plant, hardware: Hardware, state: tuple[float, float]
    ) -> tuple[tuple[float, float], Disturbance]:
        """Return the friction for the distance travelled so far, in either direction."""
        (before_rad, way_rad), now_rad = state, float(plant.motor_rad()[self.joint])
        way_rad += abs(now_rad - before_rad)
        more_Nm = self.torque_Nm * float(np.exp(-way_rad / self.way_rad))
        return (now_rad, way_rad), Disturbance(friction_Nm=at_joint(self.joint, more_Nm))


@dataclass(frozen=True, slots=True)
class StiffeningGear(EachCycle):
    """Gear that stiffens under load: wind-up is less by a share at 100 N m, by twice the share at 200 N m."""

    joint: Joint
    share: Annotated[float, ParameterSpec(0.0, 1.0, unit="1", typical=0.1, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Return the part of the wind-up that the stiffening takes back."""
        torque_Nm = float(plant.gear_torque_Nm()[self.joint])
        wind_up_rad = torque_Nm / float(plant.model.tendon_stiffness[plant.at.gear_tendons[self.joint]])
        less_rad = -wind_up_rad * self.share * min(abs(torque_Nm) / LOAD_NM, 3.0)
        return None, Disturbance(gear_rad=at_joint(self.joint, less_rad))


@dataclass(frozen=True, slots=True)
class SnaggingCable(EachCycle):
    """Cable that becomes taut at an output angle, and acts as a spring beyond it."""

    joint: Joint
    stiffness_Nm_rad: Annotated[float, ParameterSpec(0.0, 500.0, unit="N m/rad", typical=10.0, neutral=0.0)]
    taut_rad: Annotated[float, ParameterSpec(-6.5, 6.5, unit="rad", typical=1.5)] = 1.5

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Return the torque for the angle beyond the taut angle."""
        beyond_rad = max(float(plant.output_rad()[self.joint]) - self.taut_rad, 0.0)
        return None, Disturbance(output_Nm=at_joint(self.joint, -self.stiffness_Nm_rad * beyond_rad))


@dataclass(frozen=True, slots=True)
class LeakyIntegral(EachCycle):
    """Integral of a motor controller that decays at a rate per second."""

    joint: Joint
    leak_1_s: Annotated[float, ParameterSpec(0.0, 20.0, unit="1/s", typical=0.2, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Reduce the integral by the decay of one cycle."""
        if self.leak_1_s:
            at = plant.model.actuator_actadr[plant.at.actuators[self.joint]]
            plant.data.act[at] *= float(np.exp(-self.leak_1_s / CYCLE_HZ))
        return None, Disturbance()
