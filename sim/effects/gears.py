"""Gears that lose torque, that give back less than they take, and that do not turn evenly."""

from dataclasses import dataclass, replace
from typing import Annotated

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.effects.effect import EachCycle, Effect, Hardware
from sim.effects.pace import Pace, pace_now, speed_rad_s
from sim.effects.size import Size
from sim.effects.told import joint_of, with_joint
from sim.influence import Influence, at_joint
from sim.plant import Plant

Wave = Annotated[float, Size(-0.01, 0.01, unit="rad", typical=3e-4, neutral=0.0)]
Turns = Annotated[int, Size(1, 100, unit="1", typical=1)]


@dataclass(frozen=True, slots=True)
class GearHysteresis(Effect):
    """A gear winds up and back along two curves: friction between motor and output, beside its spring."""

    joint: Joint
    torque_Nm: Annotated[float, Size(0.0, 200.0, unit="N m", typical=10.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """On the gear's tendon, as hard as that of the output is."""
        if self.torque_Nm:
            name = self.joint.name.lower()
            gear, output = spec.tendon(f"{name}_gear"), spec.tendon(f"{name}_output")
            gear.frictionloss += self.torque_Nm
            gear.solref_friction, gear.solimp_friction = output.solref_friction, output.solimp_friction

    def on_params(self, params: Params) -> Params:
        """At rest it holds an output against its motor as friction of the output does."""
        joint = joint_of(params, self.joint)
        friction_Nm = joint.output_friction_Nm + self.torque_Nm
        return with_joint(params, self.joint, replace(joint, output_friction_Nm=friction_Nm))


@dataclass(frozen=True, slots=True)
class GearEfficiency(EachCycle):
    """The efficiency of a gear, times a factor: it loses torque against its load, and holds it up with it."""

    joint: Joint
    factor: Annotated[float, Size(0.3, 1.2, unit="1", typical=-0.1, neutral=1.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> Pace:
        """From where the motor stands."""
        return pace_now(plant, self.joint)

    def cycle(self, plant: Plant, hardware: Hardware, state: Pace) -> tuple[Pace, Influence]:
        """Load over efficiency where the motor drives it, load times efficiency where it drives the motor."""
        load_Nm, now = float(plant.gear_torque_Nm()[self.joint]), pace_now(plant, self.joint)
        drives = load_Nm * speed_rad_s(state, now) < 0
        lost = 1.0 / self.factor - 1.0 if drives else 1.0 - self.factor
        return now, Influence(friction_Nm=at_joint(self.joint, lost * abs(load_Nm)))


@dataclass(frozen=True, slots=True)
class TransmissionError(EachCycle):
    """An output is ahead of where its motor should have it by a wave, so many times a turn of the output."""

    joint: Joint
    cosine_rad: Wave
    sine_rad: Wave
    """With the cosine it makes any amplitude and phase."""
    turns: Turns = 1

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Influence]:
        """By the angle at which the motor is."""
        angle = self.turns * float(plant.motor_rad()[self.joint])
        ahead_rad = self.cosine_rad * np.cos(angle) + self.sine_rad * np.sin(angle)
        return None, Influence(gear_rad=at_joint(self.joint, float(ahead_rad)))
