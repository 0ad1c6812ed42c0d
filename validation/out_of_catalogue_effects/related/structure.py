"""Relatives of catalogue effects, in links and rover, for blind cases with an unknown cause."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from sim.effects.effect import EachCycle, Hardware, ParameterSpec
from sim.plant import SPRING_NAMES, Plant
from sim.record import Disturbance

Link = Literal["link1", "link2", "link3", "link4"]


@dataclass(frozen=True, slots=True)
class TwistUnderBending(EachCycle):
    """Link that twists under a bending load about an axis of its spring, and bends under a twisting one."""

    link: Link
    axis: Literal["y", "z"]
    """Axis of the bending."""
    share: Annotated[float, ParameterSpec(-0.95, 0.95, unit="1", typical=0.2, neutral=0.0)]
    """Coupling as a share of the geometric mean of the two compliances; at 1 the link would buckle."""

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Turn the rest angle about each axis by the present load about the other one."""
        model, at = plant.model, [spring_address(plant, self.link, axis) for axis in ("x", self.axis)]
        stiffness_Nm_rad = model.jnt_stiffness[model.dof_jntid[at]]
        load_Nm = stiffness_Nm_rad * (plant.data.qpos[at] - model.qpos_spring[at])
        compliance_rad_Nm = self.share / np.sqrt(stiffness_Nm_rad.prod())
        model.qpos_spring[at] = compliance_rad_Nm * load_Nm[::-1]
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class OpeningFlange(EachCycle):
    """Bolted flange that opens under load: added bending compliance of a link to one side only."""

    link: Link
    axis: Literal["y", "z"]
    side: Literal["positive", "negative"]
    """Sign of the bending at which it opens."""
    compliance_rad_Nm: Annotated[float, ParameterSpec(0.0, 1e-3, unit="rad/(N m)", typical=1e-5, neutral=0.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        """Return the stiffness as built."""
        bend = spring_address(plant, self.link, self.axis)
        return float(plant.model.jnt_stiffness[plant.model.dof_jntid[bend]])

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        """Set the stiffness for the side to which the link is bent, with the compliance in series."""
        bend, sign = spring_address(plant, self.link, self.axis), 1.0 if self.side == "positive" else -1.0
        opens = sign * float(plant.data.qpos[bend] - plant.model.qpos_spring[bend]) > 0.0
        softer = 1.0 + self.compliance_rad_Nm * state * opens
        plant.model.jnt_stiffness[plant.model.dof_jntid[bend]] = state / softer
        return state, Disturbance()


@dataclass(frozen=True, slots=True)
class LiftingWheel(EachCycle):
    """Rover with a wheel that lifts under load: added compliance of its body beyond a moment only."""

    axis: Literal["x", "y"]
    compliance_rad_Nm: Annotated[float, ParameterSpec(0.0, 1e-3, unit="rad/(N m)", typical=1e-5, neutral=0.0)]
    moment_Nm: Annotated[float, ParameterSpec(1.0, 1e4, unit="N m", typical=60.0)] = 60.0
    """Moment of either sign at which the wheel lifts."""

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        """Return the stiffness as built."""
        at = spring_address(plant, "rover", self.axis)
        return float(plant.model.jnt_stiffness[plant.model.dof_jntid[at]])

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        """Set stiffness and rest angle for the present load, so that it is continuous at the moment."""
        at, stiffness_Nm_rad, rest_rad = spring_address(plant, "rover", self.axis), state, 0.0
        angle_rad = float(plant.data.qpos[at])
        if abs(angle_rad) > self.moment_Nm / state:
            stiffness_Nm_rad = state / (1.0 + self.compliance_rad_Nm * state)
            rest_rad = -self.compliance_rad_Nm * self.moment_Nm * float(np.sign(angle_rad))
        plant.model.jnt_stiffness[plant.model.dof_jntid[at]] = stiffness_Nm_rad
        plant.model.qpos_spring[at] = rest_rad
        return state, Disturbance()


def spring_address(plant: Plant, spring: str, axis: str) -> int:
    """Return the index among MuJoCo's positions of the angle of a spring, of a link or the rover."""
    return int(plant.at.springs[SPRING_NAMES.index(spring)]["xyz".index(axis)])
