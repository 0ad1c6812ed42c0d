"""Faults of a servo: of its gains, its torque and its command."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from diagnosis.arrays import Array
from diagnosis.effects.effect import Family, Fields, Size
from diagnosis.effects.joint import JointEffect
from diagnosis.robot import Robot


@dataclass(frozen=True, slots=True)
class GainError(JointEffect):
    """Stiffness and damping of the loop are other than nominal, in the same ratio."""

    name: ClassVar[str] = "gain error"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Relative change; a loop with less than a twentieth of its gain is a loop that is off."""
        return (Size("gain_ratio", -0.95, 4.0, 0.2),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Scale the gains."""
        fields.kp_Nm_rad[:, self.index] *= 1.0 + size[:, 0]
        fields.kd_Nms_rad[:, self.index] *= 1.0 + size[:, 0]


@dataclass(frozen=True, slots=True)
class CommandDelay(JointEffect):
    """The command arrives late."""

    name: ClassVar[str] = "command delay"
    family: ClassVar[Family] = Family.ACTUATION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Delay, up to the command that a window keeps before its start."""
        return (Size("delay_s", 0.0, 0.2, 0.01),)

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Shift the command; a fraction of a period is the mean of a command that changes within it."""
        position = np.clip(np.arange(command.shape[1]) - size[:, :1] / period_s, 0.0, None)
        low = np.floor(position).astype(int)
        share = position - low
        row = np.arange(command.shape[0])[:, None]
        high = np.minimum(low + 1, command.shape[1] - 1)
        return np.asarray((1.0 - share) * command[row, low] + share * command[row, high])
