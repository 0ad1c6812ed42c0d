"""Relatives of catalogue effects, for blind cases with an unknown cause."""

from dataclasses import dataclass, replace
from typing import Annotated, Final, Literal

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.messages import Sensors
from sim.effects.effect import EachCycle, Hardware, ParameterSpec, ReadingError, refuse_first_joint
from sim.effects.gears import MotorSample, mean_speed_rad_s, sample_motor
from sim.plant import SPRING_NAMES, Plant
from sim.record import Disturbance, at_joint

FULL_RAD_S: Final = 0.02
"""Speed of an output at which friction has its amplitude."""
Torque = Annotated[float, ParameterSpec(0.0, 2000.0, unit="N m", typical=20.0, neutral=0.0)]
Setpoint = tuple[float, float]
"""Angle and rate."""


@dataclass(frozen=True, slots=True)
class ChurningGrease(EachCycle):
    """Added friction of motor and gear, proportional to the square of their speed."""

    joint: Joint
    torque_Nm: Torque
    """Friction at an output speed of 0.02 rad/s."""

    def begin(self, plant: Plant, hardware: Hardware) -> MotorSample:
        return sample_motor(plant, self.joint)

    def cycle(self, plant: Plant, hardware: Hardware, state: MotorSample) -> tuple[MotorSample, Disturbance]:
        now = sample_motor(plant, self.joint)
        share = mean_speed_rad_s(state, now) / FULL_RAD_S
        return now, Disturbance(friction_Nm=at_joint(self.joint, self.torque_Nm * share * share))


@dataclass(frozen=True, slots=True)
class SharedSeal(EachCycle):
    """Added friction of motor and gear, proportional to the speed of the next joint towards the rover.

    ValueError if the joint is the first one.
    """

    joint: Joint
    torque_Nm: Torque
    """Friction at a speed of the other output of 0.02 rad/s."""

    def __post_init__(self) -> None:
        refuse_first_joint(self.joint)

    def begin(self, plant: Plant, hardware: Hardware) -> MotorSample:
        return sample_motor(plant, Joint(self.joint - 1))

    def cycle(self, plant: Plant, hardware: Hardware, state: MotorSample) -> tuple[MotorSample, Disturbance]:
        now = sample_motor(plant, Joint(self.joint - 1))
        share = abs(mean_speed_rad_s(state, now)) / FULL_RAD_S
        return now, Disturbance(friction_Nm=at_joint(self.joint, self.torque_Nm * share))


@dataclass(frozen=True, slots=True)
class ChippedTooth(EachCycle):
    """Gear with a chipped tooth, at which the output briefly falls behind in every turn of a stage."""

    joint: Joint
    behind_rad: Annotated[float, ParameterSpec(-0.05, 0.05, unit="rad", typical=5e-4, neutral=0.0)]
    turns: Annotated[int, ParameterSpec(1, 10000, unit="1", typical=110)] = 110
    """Turns of the stage for one of the output."""
    sharp: Annotated[float, ParameterSpec(1.0, 1000.0, unit="1", typical=8.0)] = 8.0

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        from_tooth_rad = self.turns * float(plant.motor_rad()[self.joint])
        pulse = float(np.exp(self.sharp * (np.cos(from_tooth_rad) - 1.0)))
        return None, Disturbance(gear_rad=at_joint(self.joint, -self.behind_rad * pulse))


@dataclass(frozen=True, slots=True)
class UnevenMesh(EachCycle):
    """Gear that winds up more between the teeth of a stage than at them, by a share at most."""

    joint: Joint
    share: Annotated[float, ParameterSpec(0.0, 30.0, unit="1", typical=0.3, neutral=0.0)]
    turns: Annotated[int, ParameterSpec(1, 10000, unit="1", typical=90)] = 90
    """Teeth that pass for one turn of the output."""

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        return float(plant.model.tendon_stiffness[plant.at.gear_tendons[self.joint]])

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        between = 0.5 - 0.5 * float(np.cos(self.turns * plant.motor_rad()[self.joint]))
        plant.model.tendon_stiffness[plant.at.gear_tendons[self.joint]] = state / (1.0 + self.share * between)
        return state, Disturbance()


@dataclass(frozen=True, slots=True)
class TwoJointCable(EachCycle):
    """Cable across a joint and the next one towards the rover, a spring on the sum of their angles.

    ValueError if the joint is the first one.
    """

    joint: Joint
    stiffness_Nm_rad: Annotated[float, ParameterSpec(0.0, 500.0, unit="N m/rad", typical=2.0, neutral=0.0)]
    relaxed_rad: Annotated[float, ParameterSpec(-13.0, 13.0, unit="rad", typical=2.0)] = 2.0
    """Sum of the angles without torque."""

    def __post_init__(self) -> None:
        refuse_first_joint(self.joint)

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        other, angle_rad = Joint(self.joint - 1), plant.output_rad()
        stretch_rad = float(angle_rad[self.joint] + angle_rad[other]) - self.relaxed_rad
        torque_Nm = -self.stiffness_Nm_rad * stretch_rad
        return None, Disturbance(output_Nm=at_joint(self.joint, torque_Nm) + at_joint(other, torque_Nm))


@dataclass(frozen=True, slots=True)
class FilteredSetpoint(EachCycle):
    """Low-pass filter of first order on the set-points of a motor controller."""

    joint: Joint
    lag_s: Annotated[float, ParameterSpec(0.0, 3.0, unit="s", typical=0.03, neutral=0.0)]
    """Time constant."""

    def begin(self, plant: Plant, hardware: Hardware) -> Setpoint:
        return self._present_setpoint(plant)

    def cycle(self, plant: Plant, hardware: Hardware, state: Setpoint) -> tuple[Setpoint, Disturbance]:
        goal = self._present_setpoint(plant)
        if not self.lag_s or plant.data.eq_active[plant.at.brake[self.joint]]:
            return goal, Disturbance()
        left = float(np.exp(-1.0 / (CYCLE_HZ * self.lag_s)))
        angle_rad, rate_rad_s = (new + left * (old - new) for new, old in zip(goal, state, strict=True))
        plant.data.ctrl[2 * self.joint : 2 * self.joint + 2] = angle_rad, rate_rad_s
        return (angle_rad, rate_rad_s), Disturbance()

    def _present_setpoint(self, plant: Plant) -> Setpoint:
        angle_rad, rate_rad_s = plant.data.ctrl[2 * self.joint : 2 * self.joint + 2]
        return float(angle_rad), float(rate_rad_s)


Link = Literal["link1", "link2", "link3", "link4"]


@dataclass(frozen=True, slots=True)
class TwistUnderBending(EachCycle):
    """Link that twists under a bending load about an axis of its spring, and bends under a twisting one."""

    link: Link
    axis: Literal["y", "z"]
    share: Annotated[float, ParameterSpec(-0.95, 0.95, unit="1", typical=0.2, neutral=0.0)]
    """Coupling as a share of the geometric mean of the two compliances; at 1 the link would buckle."""

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
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
        bend = spring_address(plant, self.link, self.axis)
        return float(plant.model.jnt_stiffness[plant.model.dof_jntid[bend]])

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
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
        at = spring_address(plant, "rover", self.axis)
        return float(plant.model.jnt_stiffness[plant.model.dof_jntid[at]])

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        at, stiffness_Nm_rad, rest_rad = spring_address(plant, "rover", self.axis), state, 0.0
        angle_rad = float(plant.data.qpos[at])
        if abs(angle_rad) > self.moment_Nm / state:
            stiffness_Nm_rad = state / (1.0 + self.compliance_rad_Nm * state)
            # the moment is continuous where the wheel lifts
            rest_rad = -self.compliance_rad_Nm * self.moment_Nm * float(np.sign(angle_rad))
        plant.model.jnt_stiffness[plant.model.dof_jntid[at]] = stiffness_Nm_rad
        plant.model.qpos_spring[at] = rest_rad
        return state, Disturbance()


def spring_address(plant: Plant, spring: str, axis: str) -> int:
    """Return the index among MuJoCo's positions of the angle of a spring, of a link or the rover."""
    return int(plant.at.springs[SPRING_NAMES.index(spring)]["xyz".index(axis)])


@dataclass(frozen=True, slots=True)
class SaturatingMotor(ReadingError):
    """Motor whose iron saturates: it takes more current for a torque, by a share for each ampere.

    Its controller commands torques, so that nothing but the current changes.
    """

    joint: Joint
    share_1_A: Annotated[float, ParameterSpec(0.0, 10.0, unit="1/A", typical=0.1, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        more = at_joint(self.joint, self.share_1_A * abs(float(sensors.current_A[self.joint])))
        return replace(sensors, current_A=sensors.current_A * (1.0 + more))


@dataclass(frozen=True, slots=True)
class DriftingCurrent(ReadingError):
    """Current sensor whose zero drifts at a constant rate from the begin of a run."""

    joint: Joint
    drift_A_s: Annotated[float, ParameterSpec(-0.6, 0.6, unit="A/s", typical=6e-3, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        drifted_A = self.drift_A_s * sensors.cycle / CYCLE_HZ
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, drifted_A))


@dataclass(frozen=True, slots=True)
class MagneticResolver(ReadingError):
    """Resolver in the stray field of its motor, which shifts its reading in proportion to the current."""

    joint: Joint
    shift_rad_A: Annotated[float, ParameterSpec(-0.01, 0.01, unit="rad/A", typical=1e-4, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        shift_rad = self.shift_rad_A * float(sensors.current_A[self.joint])
        return replace(sensors, resolver_rad=sensors.resolver_rad + at_joint(self.joint, shift_rad))
