"""A fit judged by poses that had no part in it."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.calibration.fit import Fit
from ground.calibration.problem import Linearised


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What fresh poses were off by, and what noise and the fit's covariance let expect; whitened.

    Components that measure nothing are 0 in both.
    """

    residual: Array
    """(poses, components)."""
    variance: Array
    """Expected, (poses, components)."""

    @property
    def ratio(self) -> float:
        """Root mean square over what was expected."""
        return float(np.sqrt(np.sum(self.residual**2) / np.sum(self.variance)))


def judged(fitted: Fit, fresh: Linearised) -> Judged:
    """Judge by poses linearised at the fit's values."""
    J = fresh.jacobian
    learnt = np.einsum("nij,jk,nik->ni", J, fitted.covariance, J, optimize=True)
    return Judged(fresh.residual, fresh.counted + learnt)
