"""Effects of rover and links that the catalogue lacks, for blind cases with an unknown cause."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import numpy as np

from sim.disturbance import Disturbance
from sim.effects.effect import EachCycle, Hardware, ParameterSpec
from sim.plant import SPRING_NAMES, Plant

STRONG_M_S2: Final = 3.711
Angle = Annotated[float, ParameterSpec(-0.02, 0.02, unit="rad", typical=2e-4, neutral=0.0)]


@dataclass(frozen=True, slots=True)
class SettlingRover(EachCycle):
    """Ground that settles under the rover: its body rotates by an angle from the beginning of a session."""

    axis: Literal["x", "y", "z"]
    angle_rad: Angle
    settles_s: Annotated[float, ParameterSpec(0.1, 1e4, unit="s", typical=8.0)] = 8.0

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Rotate the body, exponentially slower with time."""
        turned_rad = -self.angle_rad * float(np.expm1(-plant.data.time / self.settles_s))
        plant.model.qpos_spring[plant.at.springs[0]["xyz".index(self.axis)]] = turned_rad
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class RockingLink(EachCycle):
    """Loose fitting that lets a link tilt by an angle, to the side to which gravity pulls it."""

    link: Literal["link1", "link2", "link3", "link4"]
    axis: Literal["y", "z"]
    play_rad: Angle
    sharp: Annotated[float, ParameterSpec(0.1, 100.0, unit="1", typical=8.0)] = 8.0

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Tilt the link by the full angle, smoothed where gravity has nearly no component to a side."""
        body = plant.model.body(f"{self.link}_far").id
        pull_B = plant.data.xmat[body].reshape(3, 3).T @ plant.model.opt.gravity
        across = float(pull_B["xyz".index("z" if self.axis == "y" else "y")])
        side = float(np.tanh(self.sharp * across / STRONG_M_S2))
        spring = plant.at.springs[SPRING_NAMES.index(self.link)]["xyz".index(self.axis)]
        plant.model.qpos_spring[spring] = self.play_rad * side
        return None, Disturbance()
