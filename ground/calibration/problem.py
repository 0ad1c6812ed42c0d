"""What a calibration is asked: parameters, and a model of how measured poses depend on them.

Nothing in the engine (problem, fit, seen, outliers, judge) knows what a parameter is, nor how many there are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags

UNKNOWN: Final = np.inf
"""The prior sigma of what nothing is known about beforehand."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number to be found, as a difference from what is believed beforehand."""

    name: str
    unit: str
    scale: float
    """A typical size of it, in its unit: so that numbers of different units can be compared."""
    prior_sigma: float = UNKNOWN
    """How far from what is believed it may be expected, one sigma about 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Residuals of all poses at some values of the parameters, and how they change with them.

    Whitened: in units of the noise, which is independent and of variance 1 in every component.
    """

    residual: Array
    """(poses, components)."""
    jacobian: Array
    """Exact derivatives of the residuals, (poses, components, parameters)."""

    @property
    def counted(self) -> Flags:
        """Components that measure anything, (poses, components): what depends on nothing does not."""
        return np.asarray(np.any(self.jacobian != 0.0, axis=-1))

    def at(self, poses: Flags) -> "Linearised":
        """Some of the poses."""
        return Linearised(self.residual[poses], self.jacobian[poses])


Model = Callable[[Array], Linearised]
"""From values (parameters,) to the residuals and their derivatives there."""
