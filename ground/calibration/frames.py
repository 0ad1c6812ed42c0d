"""Frames built from the targets that were seen: weighted rigid fits, and rover motion taken out."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Pose, adjoint, inverse, skew
from sim.tracker import TargetReadings, TrackerTargets

FEWEST: Final = 3
"""Targets that a frame can be built from, if they are not on one line."""
LINE: Final = 1e-3
"""Targets are on one line if they are this close to it, as a share of their spread."""


class FewTargets(ValueError):
    """Too few targets were seen to build a frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    """Where a body is."""

    X_WB: Pose
    covariance: Array
    """Of the screw from the true to the measured pose, in body axes, rotation first, (6, 6)."""
    misfit: Array
    """Where targets are beside where the rigid body has them, in units of their noise, (3, k)."""
    count: int


def built_frame(targets: TrackerTargets, shots: TargetReadings, name: str) -> Built:
    """The body's frame in the tracker's, from the targets seen: weighted least squares (Kabsch).

    Raises:
        FewTargets: fewer than three, or all on one line.
    """
    seen = shots.visible
    b, q, weight = targets.p_BoQ_B_m[:, seen], shots.p_WoQ_W_m[:, seen], shots.sigma_m[seen] ** -2
    count = int(np.count_nonzero(seen))
    if count < FEWEST:
        raise FewTargets(f"{name}: {count} targets seen; {FEWEST} that are not on one line are the least")
    mid_b, mid_q = (np.average(p, axis=1, weights=weight) for p in (b, q))
    b_about, q_about = b - mid_b[:, None], q - mid_q[:, None]
    spread = np.linalg.svd(b_about * np.sqrt(weight), compute_uv=False)
    if spread[1] < LINE * spread[0]:
        raise FewTargets(f"{name}: the {count} targets seen are on one line; one beside it is needed")
    U, _, Vt = np.linalg.svd((q_about * weight) @ b_about.T)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    p = mid_q - R @ mid_b
    A = np.concatenate([-skew(b), np.repeat(np.eye(3)[:, :, None], count, axis=2)], axis=1)
    information = np.einsum("ijk,ilk,k->jl", A, A, weight)
    misfit = (q - (R @ b + p[:, None])) * np.sqrt(weight)
    return Built(Pose(R, p), np.linalg.inv(information), misfit, count)


def seen_from(rover: Built, turret: Built, X_NR: Pose) -> tuple[Pose, Array]:
    """X_RT with its covariance, in axes of T: the rover's motion is taken out with its frame.

    The rover's targets are known in RNAV; X_NR leads from there to RMECH.
    """
    X_NT = inverse(rover.X_WB) @ turret.X_WB
    from_N = adjoint(inverse(X_NT))
    covariance = turret.covariance + from_N @ rover.covariance @ from_N.T
    return inverse(X_NR) @ X_NT, covariance
