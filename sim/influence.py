"""What effects do to the plant while it runs: set anew for every control cycle."""

from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array


def _none() -> Array:
    return np.zeros(len(Joint))


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """By how much each joint differs in this cycle from how it was built, (5,); influences add up."""

    friction_Nm: Array = field(default_factory=_none)
    """Coulomb friction of motor and gear, output side; together with what was built it is not negative."""
    damping_Nms_rad: Array = field(default_factory=_none)
    """Viscous friction of motor and gear, likewise."""
    gear_rad: Array = field(default_factory=_none)
    """Outputs beyond backlash and wind-up."""
    output_Nm: Array = field(default_factory=_none)
    """Torque on the outputs."""
    servo: Array = field(default_factory=_none)
    """Gains of the motor controllers, as a share of what they are."""

    def __add__(self, other: "Influence") -> "Influence":
        return Influence(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


NO_INFLUENCE: Final = Influence()


def at_joint(joint: Joint, value: float) -> Array:
    """The value at one joint, 0 at the others."""
    values = np.zeros(len(Joint))
    values[joint] = value
    return values
