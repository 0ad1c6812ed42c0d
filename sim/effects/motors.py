"""Effects on motors, their controllers and their supply voltage."""

from dataclasses import dataclass, replace
from typing import Annotated

import mujoco
import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.disturbance import Disturbance
from sim.effects.effect import EachCycle, Effect, Factor, Hardware, ParameterSpec
from sim.effects.flight_params import joint_of, with_joint
from sim.plant import Plant
from sim.servos import BUS_V, GAINS, MOTOR_CONSTANT

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
        """Set the true constant."""
        joint = joint_of(params, self.joint)
        constant = joint.torque_constant_Nm_A * self.factor
        return with_joint(params, self.joint, replace(joint, torque_constant_Nm_A=constant))


@dataclass(frozen=True, slots=True)
class ServoGain(Effect):
    """Factor on all gains of a motor controller."""

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.1, 3.0, unit="1", typical=0.2, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the gains of position, integral and rate."""
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
        """Compute the loss of gain from the present currents."""
        total_A = float(np.abs(plant.motor_current_A()).sum())
        voltage_loss = self.resistance_Ohm * total_A / BUS_V
        return None, Disturbance(servo=np.full(len(Joint), -voltage_loss))


def _scale(motor: mujoco.MjsActuator, which: int | slice, factor: float) -> None:
    gain = motor.gainprm.copy()
    gain[which] *= factor
    motor.gainprm = gain
