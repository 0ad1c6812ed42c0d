"""Motors and their controllers that are not the drawing's."""

from dataclasses import dataclass, replace
from typing import Annotated, Final

import mujoco
import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.disturbance import Disturbance
from sim.effects.effect import EachCycle, Effect, Factor, Hardware, ParameterSpec
from sim.effects.flight_params import joint_of, with_joint
from sim.plant import GAINS, MOTOR_CONSTANT, Plant

BUS_V: Final = 28.0
Setpoints = tuple[tuple[float, float], ...]
"""Angle and rate of some cycles, the newest first."""


@dataclass(frozen=True, slots=True)
class MotorConstant(Effect):
    """The torque that a motor makes of a current, times a factor; its controller commands currents."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the constant, and the gains and the limit, which are in torque."""
        motor = spec.actuator(self.joint.name.lower())
        _scale(motor, MOTOR_CONSTANT, self.factor)
        _scale(motor, GAINS, self.factor)
        motor.forcerange = motor.forcerange * self.factor

    def on_params(self, params: Params) -> Params:
        """The true constant."""
        joint = joint_of(params, self.joint)
        constant = joint.torque_constant_Nm_A * self.factor
        return with_joint(params, self.joint, replace(joint, torque_constant_Nm_A=constant))


@dataclass(frozen=True, slots=True)
class ServoGain(Effect):
    """The gains of a motor controller, all times a factor."""

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.1, 3.0, unit="1", typical=0.2, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale those of position, integral and rate."""
        _scale(spec.actuator(self.joint.name.lower()), GAINS, self.factor)


@dataclass(frozen=True, slots=True)
class CommandDelay(EachCycle):
    """Set-points come to a motor controller late; between two of them it has what lies between."""

    joint: Joint
    delay_s: Annotated[float, ParameterSpec(0.0, 0.5, unit="s", typical=0.03, neutral=0.0)]

    def begin(self, plant: Plant, hardware: Hardware) -> Setpoints:
        """The arm stands: what there is has been there for long."""
        return (self._given(plant),) * (int(self.delay_s * CYCLE_HZ) + 2)

    def cycle(self, plant: Plant, hardware: Hardware, state: Setpoints) -> tuple[Setpoints, Disturbance]:
        """The newest goes in, and one of before goes out; on the brake there is nothing to wait for."""
        if plant.data.eq_active[plant.at.brake[self.joint]]:
            return (self._given(plant),) * len(state), Disturbance()
        state = (self._given(plant), *state[:-1])
        whole, part = divmod(self.delay_s * CYCLE_HZ, 1.0)
        newer, older = (np.array(state[int(whole) + k]) for k in (0, 1))
        plant.data.ctrl[self._inputs()] = (1.0 - part) * newer + part * older
        return state, Disturbance()

    def _given(self, plant: Plant) -> tuple[float, float]:
        angle_rad, rate_rad_s = plant.data.ctrl[self._inputs()]
        return float(angle_rad), float(rate_rad_s)

    def _inputs(self) -> slice:
        return slice(2 * self.joint, 2 * self.joint + 2)


@dataclass(frozen=True, slots=True)
class BusSag(EachCycle):
    """The bus sags under the currents of all motors, and the gains of their controllers with its voltage.

    The voltage of a cycle is that under the currents with which it begins.
    """

    resistance_Ohm: Annotated[float, ParameterSpec(0.0, 5.0, unit="Ohm", typical=0.5, neutral=0.0)]

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """By the currents of this moment."""
        total_A = float(np.abs(plant.motor_current_A()).sum())
        lost = min(self.resistance_Ohm * total_A / BUS_V, 1.0)
        return None, Disturbance(servo=np.full(len(Joint), -lost))


def _scale(motor: mujoco.MjsActuator, which: int | slice, factor: float) -> None:
    gain = motor.gainprm.copy()
    gain[which] *= factor
    motor.gainprm = gain
