"""Effects unlike any of the catalogue, in joints and their controllers, for blind cases of unknown cause."""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from sim.effects.effect import EachCycle, Hardware, ParameterSpec
from sim.mujoco_settings import GAINS
from sim.plant import Plant
from sim.record import Disturbance, at_joint

LOAD_NM: Final = 100.0
"""Load at which slip has its amplitude."""


@dataclass(frozen=True, slots=True)
class DeadBand(EachCycle):
    """Motor controller with a dead band, within which it does not correct the error of its angle."""

    joint: Joint
    band_rad: Annotated[float, ParameterSpec(0.0, 2e-3, unit="rad", typical=1e-5, neutral=0.0)]
    """Error to either side that it does not correct."""

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Move the set-point towards the present angle by the band, but not beyond it."""
        error_rad = float(plant.data.ctrl[2 * self.joint] - plant.motor_rad()[self.joint])
        plant.data.ctrl[2 * self.joint] -= min(max(error_rad, -self.band_rad), self.band_rad)
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class Dither(EachCycle):
    """Motor controller that adds an oscillation to its set-point, against sticking."""

    joint: Joint
    amplitude_rad: Annotated[float, ParameterSpec(0.0, 2e-3, unit="rad", typical=1e-5, neutral=0.0)]
    frequency_Hz: Annotated[float, ParameterSpec(0.1, 31.0, unit="Hz", typical=5.0)] = 5.0

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Add the oscillation at the present time."""
        phase_rad = 2.0 * np.pi * self.frequency_Hz * float(plant.data.time)
        plant.data.ctrl[2 * self.joint] += self.amplitude_rad * float(np.sin(phase_rad))
        return None, Disturbance()


@dataclass(frozen=True, slots=True)
class FeedForward(EachCycle):
    """Motor controller that adds a torque in the direction of its set-point rate."""

    joint: Joint
    torque_Nm: Annotated[float, ParameterSpec(0.0, 1000.0, unit="N m", typical=50.0, neutral=0.0)]
    rate_rad_s: Annotated[float, ParameterSpec(1e-5, 0.1, unit="rad/s", typical=1e-3)] = 1e-3
    """Rate at which it is three quarters of the full torque."""

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        """Return the share of the torque that is applied: none at rest."""
        return 0.0

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        """Add the change of the torque to the integral of the controller, which holds it."""
        share = float(np.tanh(plant.data.ctrl[2 * self.joint + 1] / self.rate_rad_s))
        actuator = plant.at.actuators[self.joint]
        _, integral_gain_Nm_rads, _ = plant.model.actuator_gainprm[actuator, GAINS]
        integral = plant.model.actuator_actadr[actuator]
        plant.data.act[integral] += self.torque_Nm * (share - state) / float(integral_gain_Nm_rads)
        return share, Disturbance()


@dataclass(frozen=True, slots=True)
class KickingBrake(EachCycle):
    """Brake that turns its motor by an angle as it seats, each time that it is applied."""

    joint: Joint
    kick_rad: Annotated[float, ParameterSpec(-5e-3, 5e-3, unit="rad", typical=5e-5, neutral=0.0)]
    seats_s: Annotated[float, ParameterSpec(0.01, 100.0, unit="s", typical=0.2)] = 0.2
    """Time constant."""

    def begin(self, plant: Plant, hardware: Hardware) -> float:
        """Return the turn so far, zero, of a brake that is just applied."""
        return 0.0

    def cycle(self, plant: Plant, hardware: Hardware, state: float) -> tuple[float, Disturbance]:
        """Move the angle at which the brake holds the motor towards that of the seated brake."""
        brake = plant.at.brake[self.joint]
        if not plant.data.eq_active[brake]:
            return 0.0, Disturbance()
        more_rad = (state - self.kick_rad) * float(np.expm1(-1.0 / (CYCLE_HZ * self.seats_s)))
        plant.model.eq_data[brake, 0] += more_rad
        return state + more_rad, Disturbance()


@dataclass(frozen=True, slots=True)
class SlippingBelt(EachCycle):
    """Belt between motor and output that slips under load by a share of the way that it moves."""

    joint: Joint
    share: Annotated[float, ParameterSpec(0.0, 0.5, unit="1", typical=4e-3, neutral=0.0)]
    """Share at a load of 100 N m."""

    def begin(self, plant: Plant, hardware: Hardware) -> tuple[float, float]:
        """Return the motor angle and the slip so far, zero."""
        return float(plant.motor_rad()[self.joint]), 0.0

    def cycle(
        self, plant: Plant, hardware: Hardware, state: tuple[float, float]
    ) -> tuple[tuple[float, float], Disturbance]:
        """Let the output slip in the direction of its load, whichever way the motor moved."""
        (before_rad, slip_rad), now_rad = state, float(plant.motor_rad()[self.joint])
        load = float(plant.gear_torque_Nm()[self.joint]) / LOAD_NM
        slip_rad += self.share * load * abs(now_rad - before_rad)
        return (now_rad, slip_rad), Disturbance(gear_rad=at_joint(self.joint, slip_rad))
