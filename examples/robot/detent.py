"""Detents of a joint, as an effect of one's own for `--effects detent.py`."""

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from simgap import Array, Family, JointEffect, Size, State

DETENTS: Final = 12
"""Per turn of the joint."""


@dataclass(frozen=True, slots=True)
class Detents(JointEffect):
    """Magnetic detents: a torque that pulls the joint to the nearest of 12 angles."""

    name: ClassVar[str] = "magnetic detents"
    family: ClassVar[Family] = Family.EXTERNAL

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Largest torque of a detent; 5 % of the torque of the joint is worth a name."""
        return (Size("detent_Nm", 0.0, self.scales.torque_Nm, 0.05 * self.scales.torque_Nm),)

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the torque at the angle of the joint."""
        return np.asarray(-size[:, 0] * np.sin(DETENTS * state.q_rad[:, self.index]))
