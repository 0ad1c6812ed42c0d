"""Measured poses with their noise: paper equations 15 to 17."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoses:
    """Measured poses with their covariances."""

    X_RT: Pose
    """Turret frame in the rover frame, batch (n,)."""
    covariance: Array
    """Covariance of the screw from true to measured pose, in its axes, rotation first, shape (n, 6, 6)."""

    @property
    def whitener(self) -> Array:
        """Compute the matrices that make this screw independent with unit variance, shape (n, 6, 6)."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))
