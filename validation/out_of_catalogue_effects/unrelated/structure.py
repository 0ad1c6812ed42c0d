"""Effects unlike any of the catalogue, on links and rover, for blind cases of unknown cause."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import numpy as np

from fsw.dictionary.enums import Joint
from sim.effects.effect import EachCycle, Hardware, ParameterSpec
from sim.frames import FLIP
from sim.plant import SPRING_NAMES, Plant
from sim.record import Disturbance

ALONG_Z: Final = 5
"""Index of the translation along the axis of a joint among the springs of the link that follows."""


@dataclass(frozen=True, slots=True)
class ScrewingBearing(EachCycle):
    """Bearing that moves along its axis as its joint turns, like a screw.

    Raises:
        ValueError: the joint is the last one, whose link has no spring to shift.
    """

    joint: Joint
    pitch_m_rad: Annotated[float, ParameterSpec(-0.03, 0.03, unit="m/rad", typical=3e-4, neutral=0.0)]

    def __post_init__(self) -> None:
        if self.joint + 1 >= len(SPRING_NAMES):
            raise ValueError("joint: the link after turret is rigid; take another joint")

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Shift the link after the joint by the present output angle."""
        shift_m = self.pitch_m_rad * float(plant.output_rad()[self.joint])
        plant.model.qpos_spring[plant.at.springs[self.joint + 1][ALONG_Z]] = shift_m
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class SteadyWind(EachCycle):
    """Steady wind along an axis of the rover, which pushes on a link with a force."""

    link: Literal["link2", "link3", "link4"]
    axis: Literal["x", "y"]
    force_N: Annotated[float, ParameterSpec(-400.0, 400.0, unit="N", typical=4.0, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Apply the force at the centre of mass of the outer half of the link."""
        axis, body = "xyz".index(self.axis), plant.model.body(f"{self.link}_far").id
        plant.data.xfrc_applied[body, axis] = self.force_N * FLIP[axis]
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class SwayingRover(EachCycle):
    """Rover that sways on its suspension for the whole of a session, by an angle about one of its axes."""

    axis: Literal["x", "y", "z"]
    angle_rad: Annotated[float, ParameterSpec(0.0, 0.02, unit="rad", typical=2e-4, neutral=0.0)]
    frequency_Hz: Annotated[float, ParameterSpec(0.01, 2.0, unit="Hz", typical=0.4)] = 0.4

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Rotate the body of the rover under the arm at the present time."""
        phase_rad = 2.0 * np.pi * self.frequency_Hz * float(plant.data.time)
        turned_rad = self.angle_rad * float(np.sin(phase_rad))
        plant.model.qpos_spring[plant.at.springs[0]["xyz".index(self.axis)]] = turned_rad
        return None, Disturbance()
