"""Effects on joints: cables and springs, gears, hardstops, resolvers, motors and their controllers."""

from dataclasses import dataclass, replace
from typing import Annotated

import mujoco
import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array
from sim.effects.effect import (
    EachCycle,
    EachMove,
    Effect,
    Factor,
    Hardware,
    ParameterSpec,
    SmallAngle,
    joint_of,
    scale_joint,
    with_joint,
)
from sim.mujoco_settings import BUS_V, GAINS, MOTOR_CONSTANT
from sim.plant import Plant
from sim.record import Disturbance, MoveDisturbance, at_joint, no_move_disturbance


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
        angle_rad = float(plant.output_rad()[self.joint])
        torque_Nm = self.cosine_Nm * np.cos(angle_rad) + self.sine_Nm * np.sin(angle_rad)
        return None, Disturbance(output_Nm=at_joint(self.joint, float(torque_Nm)))


@dataclass(frozen=True, slots=True)
class HardstopAngle(Effect):
    """Angle of the negative hardstop beyond that of the drawing; it shifts the encoder zero too."""

    joint: Joint
    shift_rad: SmallAngle

    def on_model(self, spec: mujoco.MjSpec) -> None:
        tendon = spec.tendon(f"{self.joint.name.lower()}_output")
        tendon.springlength = tendon.springlength + np.array([self.shift_rad, 0.0])

    def on_params(self, params: Params) -> Params:
        hardstop_rad = joint_of(params, self.joint).hardstop_rad + self.shift_rad
        return with_joint(params, self.joint, hardstop_rad=hardstop_rad)


@dataclass(frozen=True, slots=True)
class HardstopStiffness(Effect):
    """Factor on the stiffness of the hardstops of a joint."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        tendon = spec.tendon(f"{self.joint.name.lower()}_output")
        tendon.stiffness = tendon.stiffness * self.factor

    def on_params(self, params: Params) -> Params:
        return scale_joint(params, self.joint, "hardstop_stiffness_Nm_rad", self.factor)


@dataclass(frozen=True, slots=True)
class ResolverBias(Effect):
    """Constant error of a resolver."""

    joint: Joint
    bias_rad: SmallAngle

    def on_hardware(self, hardware: Hardware) -> Hardware:
        bias_rad = hardware.resolver_bias_rad + at_joint(self.joint, self.bias_rad)
        return replace(hardware, resolver_bias_rad=bias_rad)


@dataclass(frozen=True, slots=True)
class BacklashWidth(Effect):
    """Factor on the backlash of a gear."""

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.0, 5.0, unit="1", typical=0.1, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        tendon = spec.tendon(f"{self.joint.name.lower()}_gear")
        tendon.springlength = tendon.springlength * self.factor

    def on_params(self, params: Params) -> Params:
        return scale_joint(params, self.joint, "backlash_rad", self.factor)


@dataclass(frozen=True, slots=True)
class GearStiffness(Effect):
    """Factor on the torsional stiffness of a gear."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        tendon = spec.tendon(f"{self.joint.name.lower()}_gear")
        tendon.stiffness = tendon.stiffness * self.factor
        tendon.damping = tendon.damping * self.factor

    def on_params(self, params: Params) -> Params:
        return scale_joint(params, self.joint, "gear_stiffness_Nm_rad", self.factor)


@dataclass(frozen=True, slots=True)
class GearFriction(Effect):
    """Factor on Coulomb and viscous friction of motor and gear."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        motor = spec.joint(f"{self.joint.name.lower()}_motor")
        motor.frictionloss *= self.factor
        motor.damping *= self.factor


Setpoints = tuple[tuple[float, float], ...]
"""Angle and rate of the last cycles, the newest first."""


@dataclass(frozen=True, slots=True)
class MotorConstant(Effect):
    """Factor on the torque that a motor makes of a current; its controller commands currents."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the constant, and also the gains and the limit, which are torques in the model."""
        motor = spec.actuator(self.joint.name.lower())
        _scale(motor, MOTOR_CONSTANT, self.factor)
        _scale(motor, GAINS, self.factor)
        motor.forcerange = motor.forcerange * self.factor

    def on_params(self, params: Params) -> Params:
        return scale_joint(params, self.joint, "torque_constant_Nm_A", self.factor)


@dataclass(frozen=True, slots=True)
class ServoGain(Effect):
    """Factor on all gains of a motor controller."""

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.1, 3.0, unit="1", typical=0.2, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        _scale(spec.actuator(self.joint.name.lower()), GAINS, self.factor)


@dataclass(frozen=True, slots=True)
class CommandDelay(EachCycle):
    """Delay of the set-points of a motor controller, interpolated between cycles."""

    joint: Joint
    delay_s: Annotated[float, ParameterSpec(0.0, 0.5, unit="s", typical=0.03, neutral=0.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> Setpoints:
        """Return a history of the present set-point, which an arm at rest has had for long."""
        return (self._present_setpoint(plant),) * (int(self.delay_s * CYCLE_HZ) + 2)

    def cycle(self, plant: Plant, hardware: Hardware, state: Setpoints) -> tuple[Setpoints, Disturbance]:
        """Add the newest set-point and apply the delayed one; a braked motor has no delay."""
        if plant.data.eq_active[plant.at.brake[self.joint]]:
            return (self._present_setpoint(plant),) * len(state), Disturbance()
        state = (self._present_setpoint(plant), *state[:-1])
        whole, part = divmod(self.delay_s * CYCLE_HZ, 1.0)
        newer, older = (np.array(state[int(whole) + k]) for k in (0, 1))
        plant.data.ctrl[self._inputs()] = (1.0 - part) * newer + part * older
        return state, Disturbance()

    def _present_setpoint(self, plant: Plant) -> tuple[float, float]:
        angle_rad, rate_rad_s = plant.data.ctrl[self._inputs()]
        return float(angle_rad), float(rate_rad_s)

    def _inputs(self) -> slice:
        return slice(2 * self.joint, 2 * self.joint + 2)


@dataclass(frozen=True, slots=True)
class BusSag(EachCycle):
    """Drop of the bus voltage under the currents of all motors, which lowers the gains of their controllers.

    A controller sets the duty cycle of its bridge, so its gains are in proportion to the bus voltage. Its
    integral still reaches the current limit, while the bus can drive that through the winding. The voltage
    of a cycle follows from the currents at its start.
    """

    resistance_Ohm: Annotated[float, ParameterSpec(0.0, 5.0, unit="Ohm", typical=0.5, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        total_A = float(np.abs(plant.motor_current_A()).sum())
        voltage_loss = self.resistance_Ohm * total_A / BUS_V
        return None, Disturbance(servo=np.full(len(Joint), -voltage_loss))


def _scale(motor: mujoco.MjsActuator, which: int | slice, factor: float) -> None:
    gain = motor.gainprm.copy()
    gain[which] *= factor
    motor.gainprm = gain


@dataclass(frozen=True, slots=True)
class Windup(EachMove):
    """Twist of a gear at rest, of either sign, from friction inside it."""

    joint: Joint
    within_rad: Annotated[float, ParameterSpec(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Draw a shift of the dead band of the gear."""
        drawn = no_move_disturbance()
        drawn.gear_rad[self.joint] = _draw_uniform(rng, self.within_rad)
        return drawn


@dataclass(frozen=True, slots=True)
class ServoError(EachMove):
    """Error of a motor angle at rest against its encoder, from lost counts or a badly tuned controller."""

    joint: Joint
    within_rad: Annotated[float, ParameterSpec(0.0, 0.1, unit="rad", typical=1e-4, neutral=0.0)]

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Draw an angle that shifts set-points and readings alike."""
        drawn = no_move_disturbance()
        drawn.motor_rad[self.joint] = _draw_uniform(rng, self.within_rad)
        return drawn


def _draw_uniform(rng: np.random.Generator, bound: float) -> Array:
    return np.asarray(rng.uniform(-bound, bound))
