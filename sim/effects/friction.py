"""Friction of motors, gears and outputs that is not the drawing's; torques and speeds are output side."""

from dataclasses import dataclass, replace
from typing import Annotated

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.effects.effect import EachCycle, Effect, Hardware
from sim.effects.environment import COLD_C, WARM_C
from sim.effects.pace import Pace, pace_now, speed_rad_s
from sim.effects.size import Size
from sim.effects.told import joint_of, with_joint
from sim.influence import Influence, at_joint
from sim.plant import Plant


@dataclass(frozen=True, slots=True)
class CoulombFriction(Effect):
    """Motor and gear resist with so much more torque, whatever their speed."""

    joint: Joint
    torque_Nm: Annotated[float, Size(-100.0, 400.0, unit="N m", typical=20.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """On the motor hinge; what is taken off leaves at least nothing."""
        motor = spec.joint(f"{self.joint.name.lower()}_motor")
        motor.frictionloss = max(motor.frictionloss + self.torque_Nm, 0.0)


@dataclass(frozen=True, slots=True)
class ViscousFriction(Effect):
    """Motor and gear resist with so much more torque for their speed."""

    joint: Joint
    damping_Nms_rad: Annotated[float, Size(-200.0, 2e4, unit="N m s/rad", typical=300.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """On the motor hinge; what is taken off leaves at least nothing."""
        motor = spec.joint(f"{self.joint.name.lower()}_motor")
        motor.damping[0] = max(motor.damping[0] + self.damping_Nms_rad, 0.0)


@dataclass(frozen=True, slots=True)
class StribeckFriction(EachCycle):
    """Motor and gear resist more while they are slow: so much more at rest, a factor e less at the speed."""

    joint: Joint
    torque_Nm: Annotated[float, Size(-100.0, 200.0, unit="N m", typical=20.0, neutral=0.0)]
    speed_rad_s: Annotated[float, Size(1e-4, 0.1, unit="rad/s", typical=2e-3)] = 2e-3

    def begin(self, plant: Plant, hardware: Hardware) -> Pace:
        """From where the motor stands."""
        return pace_now(plant, self.joint)

    def cycle(self, plant: Plant, hardware: Hardware, state: Pace) -> tuple[Pace, Influence]:
        """At the speed of the cycle that has passed."""
        now = pace_now(plant, self.joint)
        slow = float(np.exp(-((speed_rad_s(state, now) / self.speed_rad_s) ** 2)))
        return now, Influence(friction_Nm=at_joint(self.joint, self.torque_Nm * slow))


@dataclass(frozen=True, slots=True)
class LoadFriction(EachCycle):
    """Motor and gear resist with a share of the torque that the gear carries."""

    joint: Joint
    share: Annotated[float, Size(0.0, 1.0, unit="1", typical=0.1, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Influence]:
        """Under the load of this moment."""
        load_Nm = abs(float(plant.gear_torque_Nm()[self.joint]))
        return None, Influence(friction_Nm=at_joint(self.joint, self.share * load_Nm))


@dataclass(frozen=True, slots=True)
class ColdFriction(EachCycle):
    """In the cold motor and gear resist more than the drawing says: at -55 degC times a factor."""

    joint: Joint
    factor: Annotated[float, Size(0.1, 10.0, unit="1", typical=0.3, neutral=1.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> Influence:
        """By the temperature around the motor, exponentially, of what the drawing has there."""
        share = (WARM_C - float(hardware.ambient_C[self.joint])) / (WARM_C - COLD_C)
        more = self.factor**share - 1.0
        friction_Nm, damping_Nms_rad = plant.built_friction()
        return Influence(
            friction_Nm=at_joint(self.joint, more * float(friction_Nm[self.joint])),
            damping_Nms_rad=at_joint(self.joint, more * float(damping_Nms_rad[self.joint])),
        )

    def cycle(self, plant: Plant, hardware: Hardware, state: Influence) -> tuple[Influence, Influence]:
        """Grease keeps the temperature that it began with."""
        return state, state


@dataclass(frozen=True, slots=True)
class OutputFriction(Effect):
    """Bearing and seal of an output resist with so much more torque, beyond the gear."""

    joint: Joint
    torque_Nm: Annotated[float, Size(-3.0, 100.0, unit="N m", typical=5.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """On motor and gear hinge together."""
        output = spec.tendon(f"{self.joint.name.lower()}_output")
        output.frictionloss = max(output.frictionloss + self.torque_Nm, 0.0)

    def on_params(self, params: Params) -> Params:
        """The true friction of the output."""
        joint = joint_of(params, self.joint)
        friction_Nm = max(joint.output_friction_Nm + self.torque_Nm, 0.0)
        return with_joint(params, self.joint, replace(joint, output_friction_Nm=friction_Nm))
