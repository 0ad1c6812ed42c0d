"""Friction of motors, gears and outputs; hysteresis, efficiency, errors and coupling of gears.

Torques and speeds are those of the output side.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.effects.effect import (
    EachCycle,
    Effect,
    Hardware,
    ParameterSpec,
    joint_of,
    refuse_first_joint,
    with_joint,
)
from sim.effects.environment import COLD_C
from sim.plant import Plant
from sim.record import Disturbance, at_joint
from sim.setting import WARM_C

WaveAmplitude = Annotated[float, ParameterSpec(-0.01, 0.01, unit="rad", typical=3e-4, neutral=0.0)]
WavesPerTurn = Annotated[int, ParameterSpec(1, 100, unit="1", typical=1)]


@dataclass(frozen=True, slots=True)
class MotorSample:
    """Time and angle of a motor in the last cycle."""

    time_s: float
    angle_rad: float


def sample_motor(plant: Plant, joint: Joint) -> MotorSample:
    """Return the present time and angle of a motor."""
    return MotorSample(float(plant.data.time), float(plant.motor_rad()[joint]))


def mean_speed_rad_s(before: MotorSample, now: MotorSample) -> float:
    """Compute the mean speed between two samples, output side; 0 if no time has passed.

    A set-point is held for a cycle, which makes the speed of the motor ripple within the cycle.
    The speed at one time of the cycle is therefore not the mean speed.
    """
    elapsed_s = now.time_s - before.time_s
    return (now.angle_rad - before.angle_rad) / elapsed_s if elapsed_s > 0 else 0.0


@dataclass(frozen=True, slots=True)
class _AtSpeed(EachCycle):
    """Effect that depends on the mean speed of a motor in the last cycle."""

    joint: Joint

    def begin(self, plant: Plant, hardware: Hardware) -> MotorSample:
        return sample_motor(plant, self.joint)


@dataclass(frozen=True, slots=True)
class CoulombFriction(Effect):
    """Added friction torque of motor and gear, independent of their speed."""

    joint: Joint
    torque_Nm: Annotated[float, ParameterSpec(-100.0, 400.0, unit="N m", typical=20.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Add to the friction of the motor hinge; the sum is at least 0."""
        motor = spec.joint(f"{self.joint.name.lower()}_motor")
        motor.frictionloss = max(motor.frictionloss + self.torque_Nm, 0.0)


@dataclass(frozen=True, slots=True)
class AsymmetricFriction(_AtSpeed):
    """Added friction torque of motor and gear in one direction of motion only."""

    direction: Literal["positive", "negative"]
    torque_Nm: Annotated[float, ParameterSpec(-100.0, 400.0, unit="N m", typical=20.0, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: MotorSample) -> tuple[MotorSample, Disturbance]:
        """Return the friction for the direction of the last cycle; none at rest."""
        now, sign = sample_motor(plant, self.joint), 1.0 if self.direction == "positive" else -1.0
        acts = sign * mean_speed_rad_s(state, now) > 0.0
        return now, Disturbance(friction_Nm=at_joint(self.joint, self.torque_Nm * acts))


@dataclass(frozen=True, slots=True)
class ViscousFriction(Effect):
    """Added friction torque of motor and gear, proportional to their speed."""

    joint: Joint
    damping_Nms_rad: Annotated[
        float, ParameterSpec(-200.0, 2e4, unit="N m s/rad", typical=300.0, neutral=0.0)
    ]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Add to the damping of the motor hinge; the sum is at least 0."""
        motor = spec.joint(f"{self.joint.name.lower()}_motor")
        motor.damping[0] = max(motor.damping[0] + self.damping_Nms_rad, 0.0)


@dataclass(frozen=True, slots=True)
class StribeckFriction(_AtSpeed):
    """Added friction of motor and gear at low speed; it falls by a factor e at the given speed."""

    torque_Nm: Annotated[float, ParameterSpec(-100.0, 200.0, unit="N m", typical=20.0, neutral=0.0)]
    speed_rad_s: Annotated[float, ParameterSpec(1e-4, 0.1, unit="rad/s", typical=2e-3)] = 2e-3

    def cycle(self, plant: Plant, hardware: Hardware, state: MotorSample) -> tuple[MotorSample, Disturbance]:
        """Compute the friction at the mean speed of the last cycle."""
        now = sample_motor(plant, self.joint)
        slow = float(np.exp(-((mean_speed_rad_s(state, now) / self.speed_rad_s) ** 2)))
        return now, Disturbance(friction_Nm=at_joint(self.joint, self.torque_Nm * slow))


@dataclass(frozen=True, slots=True)
class LoadFriction(EachCycle):
    """Added friction of motor and gear, proportional to the torque in the gear."""

    joint: Joint
    share: Annotated[float, ParameterSpec(0.0, 1.0, unit="1", typical=0.1, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        load_Nm = abs(float(plant.gear_torque_Nm()[self.joint]))
        return None, Disturbance(friction_Nm=at_joint(self.joint, self.share * load_Nm))


@dataclass(frozen=True, slots=True)
class ColdFriction(EachCycle):
    """Factor on the friction of motor and gear at -55 degC, against that of the drawing."""

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.1, 10.0, unit="1", typical=0.3, neutral=1.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> Disturbance:
        """Compute the added friction, exponential in the temperature around the motor."""
        share = (WARM_C - float(hardware.ambient_C[self.joint])) / (WARM_C - COLD_C)
        increase = self.factor**share - 1.0
        friction_Nm, damping_Nms_rad = plant.built_friction()
        return Disturbance(
            friction_Nm=at_joint(self.joint, increase * float(friction_Nm[self.joint])),
            damping_Nms_rad=at_joint(self.joint, increase * float(damping_Nms_rad[self.joint])),
        )

    def cycle(self, plant: Plant, hardware: Hardware, state: Disturbance) -> tuple[Disturbance, Disturbance]:
        """Return the friction of the first cycle: the grease keeps its temperature."""
        return state, state


@dataclass(frozen=True, slots=True)
class OutputFriction(Effect):
    """Added friction torque of bearing and seal of an output."""

    joint: Joint
    torque_Nm: Annotated[float, ParameterSpec(-3.0, 100.0, unit="N m", typical=5.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Add to the friction of the output tendon; the sum is at least 0."""
        output = spec.tendon(f"{self.joint.name.lower()}_output")
        output.frictionloss = max(output.frictionloss + self.torque_Nm, 0.0)

    def on_params(self, params: Params) -> Params:
        friction_Nm = max(joint_of(params, self.joint).output_friction_Nm + self.torque_Nm, 0.0)
        return with_joint(params, self.joint, output_friction_Nm=friction_Nm)


@dataclass(frozen=True, slots=True)
class GearHysteresis(Effect):
    """Friction parallel to the spring of a gear, so that wind-up follows two curves."""

    joint: Joint
    torque_Nm: Annotated[float, ParameterSpec(0.0, 200.0, unit="N m", typical=10.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Add friction to the gear tendon, as hard as that of the output tendon."""
        if self.torque_Nm:
            name = self.joint.name.lower()
            gear, output = spec.tendon(f"{name}_gear"), spec.tendon(f"{name}_output")
            gear.frictionloss += self.torque_Nm
            gear.solref_friction, gear.solimp_friction = output.solref_friction, output.solimp_friction

    def on_params(self, params: Params) -> Params:
        """Add to the friction of the output, which holds an output at rest in the same way."""
        friction_Nm = joint_of(params, self.joint).output_friction_Nm + self.torque_Nm
        return with_joint(params, self.joint, output_friction_Nm=friction_Nm)


@dataclass(frozen=True, slots=True)
class GearEfficiency(_AtSpeed):
    """Factor on the efficiency of a gear; losses oppose a driven load and support an overhauling one."""

    factor: Annotated[float, ParameterSpec(0.3, 1.2, unit="1", typical=-0.1, neutral=1.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: MotorSample) -> tuple[MotorSample, Disturbance]:
        """Compute the loss: load over efficiency if the motor drives, else load times efficiency."""
        load_Nm, now = float(plant.gear_torque_Nm()[self.joint]), sample_motor(plant, self.joint)
        motor_drives = load_Nm * mean_speed_rad_s(state, now) < 0
        lost = 1.0 / self.factor - 1.0 if motor_drives else 1.0 - self.factor
        return now, Disturbance(friction_Nm=at_joint(self.joint, lost * abs(load_Nm)))


@dataclass(frozen=True, slots=True)
class TransmissionError(EachCycle):
    """Periodic error of an output against its motor, with a number of periods per output turn."""

    joint: Joint
    cosine_rad: WaveAmplitude
    sine_rad: WaveAmplitude
    """Sine part; with the cosine part it gives any amplitude and phase."""
    turns: WavesPerTurn = 1

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        angle = self.turns * float(plant.motor_rad()[self.joint])
        ahead_rad = self.cosine_rad * np.cos(angle) + self.sine_rad * np.sin(angle)
        return None, Disturbance(gear_rad=at_joint(self.joint, float(ahead_rad)))


@dataclass(frozen=True, slots=True)
class JointCoupling(EachCycle):
    """Coupling of a joint to the next one towards the rover, whose motion turns its output too.

    Raises:
        ValueError: the joint is the first one.
    """

    joint: Joint
    ratio: Annotated[float, ParameterSpec(-0.1, 0.1, unit="1", typical=2e-3, neutral=0.0)]

    def __post_init__(self) -> None:
        refuse_first_joint(self.joint)

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        turn_rad = self.ratio * float(plant.motor_rad()[self.joint - 1])
        return None, Disturbance(gear_rad=at_joint(self.joint, turn_rad))
