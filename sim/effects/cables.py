"""Cables and springs across the joints."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fsw.dictionary.enums import Joint
from sim.disturbance import Disturbance, at_joint
from sim.effects.effect import EachCycle, Hardware, ParameterSpec
from sim.plant import Plant


@dataclass(frozen=True, slots=True)
class FlexCable(EachCycle):
    """Cable across a joint, with a spring torque towards its neutral angle and a drag against motion.

    The drag follows the model of Dahl: after a reversal it approaches its new value within `transition_rad`.
    """

    joint: Joint
    stiffness_Nm_rad: Annotated[float, ParameterSpec(0.0, 50.0, unit="N m/rad", typical=0.5, neutral=0.0)]
    drag_Nm: Annotated[float, ParameterSpec(0.0, 30.0, unit="N m", typical=1.0, neutral=0.0)]
    neutral_rad: Annotated[float, ParameterSpec(-6.5, 6.5, unit="rad", typical=0.0)] = 0.0
    transition_rad: Annotated[float, ParameterSpec(1e-2, 1.0, unit="rad", typical=0.05)] = 0.05

    def begin(self, plant: Plant, hardware: Hardware) -> tuple[float, float]:
        """Return the output angle [rad] and the relative drag, which is 0 after a long rest."""
        return float(plant.output_rad()[self.joint]), 0.0

    def cycle(
        self, plant: Plant, hardware: Hardware, state: tuple[float, float]
    ) -> tuple[tuple[float, float], Disturbance]:
        """Compute the torque of the cable from the travel of the output since the last cycle."""
        (before_rad, share), now_rad = state, float(plant.output_rad()[self.joint])
        moved_rad = now_rad - before_rad
        direction = float(np.sign(moved_rad))
        if direction:
            share = direction + (share - direction) * float(np.exp(-abs(moved_rad) / self.transition_rad))
        torque_Nm = -self.stiffness_Nm_rad * (now_rad - self.neutral_rad) - self.drag_Nm * share
        return (now_rad, share), Disturbance(output_Nm=at_joint(self.joint, torque_Nm))


PeriodicTorque = Annotated[float, ParameterSpec(-100.0, 100.0, unit="N m", typical=2.0, neutral=0.0)]


@dataclass(frozen=True, slots=True)
class Counterbalance(EachCycle):
    """Torque on an output with one period per turn, as of a counterweight or an off-centre spring."""

    joint: Joint
    cosine_Nm: PeriodicTorque
    sine_Nm: PeriodicTorque
    """Sine part; with the cosine part it gives any amplitude and phase."""

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Return the torque at the present output angle."""
        angle_rad = float(plant.output_rad()[self.joint])
        torque_Nm = self.cosine_Nm * np.cos(angle_rad) + self.sine_Nm * np.sin(angle_rad)
        return None, Disturbance(output_Nm=at_joint(self.joint, float(torque_Nm)))
