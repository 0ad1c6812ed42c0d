"""Coupling of a joint to its neighbour, as where the belt or the cable of one joint runs around another."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, Family, Size, State, Tick


@dataclass(frozen=True, slots=True)
class JointCoupling(Effect):
    """The motor of a joint turns by size times the motion of a neighbour while the joint stands still.

    Motor angle m = q + size * q_neighbour, so by virtual work the load of the joint comes back to the
    neighbour: its motor carries size * load less. A second encoder at the output shows the angle. An encoder
    at the motor is in the loop, which hides the angle, so that a simulation has the torque alone. The torque
    acts at the neighbour, for which inverse dynamics has no hook.
    """

    name: ClassVar[str] = "joint coupling"
    family: ClassVar[Family] = Family.TRANSMISSION
    place: str
    index: int
    neighbour: str
    neighbour_index: int
    typical_ratio: float

    @property
    def key(self) -> str:
        """Name with the neighbour."""
        return f"{self.place}: {self.name} to {self.neighbour}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Turn of the motor per turn of the neighbour; 1 is a joint that keeps its direction in the world."""
        return (Size("coupling_ratio", -1.0, 1.0, self.typical_ratio),)

    def act(self, size: Array, tick: Tick) -> None:
        """Add the torque at the neighbour."""
        tick.applied_Nm[:, self.neighbour_index] += size[:, 0] * tick.state.load_Nm[:, self.index]

    def deflection_rad(self, size: Array, state: State) -> Array:
        """Return the turn of the output that the motor does not make."""
        return np.asarray(-size[:, 0] * state.q_rad[:, self.neighbour_index])
