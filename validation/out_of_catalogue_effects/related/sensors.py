"""Relatives of catalogue effects, in the readings of sensors, for blind cases with an unknown cause."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.messages import Sensors
from sim.effects.effect import ParameterSpec, ReadingError
from sim.record import at_joint


@dataclass(frozen=True, slots=True)
class SaturatingMotor(ReadingError):
    """Motor whose iron saturates: it takes more current for a torque, by a share for each ampere.

    Its controller commands torques, so that nothing but the current changes.
    """

    joint: Joint
    share_1_A: Annotated[float, ParameterSpec(0.0, 10.0, unit="1/A", typical=0.1, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the current that the motor takes."""
        more = at_joint(self.joint, self.share_1_A * abs(float(sensors.current_A[self.joint])))
        return replace(sensors, current_A=sensors.current_A * (1.0 + more))


@dataclass(frozen=True, slots=True)
class DriftingCurrent(ReadingError):
    """Current sensor whose zero drifts at a constant rate from the begin of a run."""

    joint: Joint
    drift_A_s: Annotated[float, ParameterSpec(-0.6, 0.6, unit="A/s", typical=6e-3, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the drift so far."""
        drifted_A = self.drift_A_s * sensors.cycle / CYCLE_HZ
        return replace(sensors, current_A=sensors.current_A + at_joint(self.joint, drifted_A))


@dataclass(frozen=True, slots=True)
class MagneticResolver(ReadingError):
    """Resolver in the stray field of its motor, which shifts its reading in proportion to the current."""

    joint: Joint
    shift_rad_A: Annotated[float, ParameterSpec(-0.01, 0.01, unit="rad/A", typical=1e-4, neutral=0.0)]

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return readings with the shifted angle."""
        shift_rad = self.shift_rad_A * float(sensors.current_A[self.joint])
        return replace(sensors, resolver_rad=sensors.resolver_rad + at_joint(self.joint, shift_rad))
