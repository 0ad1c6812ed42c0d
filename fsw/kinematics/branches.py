"""The branches of the inverse kinematics: their names, and which of them a pose is on."""

from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import OrthogonalArm
from fsw.kinematics.transforms import Array, Integers

BRANCHES: Final = tuple(
    f"shoulder-{shoulder} elbow-{elbow} wrist-{wrist}"
    for shoulder in ("out", "in")
    for elbow in ("up", "down")
    for wrist in ("up", "down")
)


def slot_name(slot: int) -> str:
    """The branch of a slot; where a branch has several roots, those after the first are numbered."""
    count, branch = divmod(slot, len(BRANCHES))
    return BRANCHES[branch] if count == 0 else f"{BRANCHES[branch]}, root {count + 1}"


def fold_distances(s: OrthogonalArm, output_rad: Array) -> Array:
    """How clearly poses (5, ...) are on either side of each fold, (3, ...): shoulder, elbow, wrist.

    Negative is out, up, up: the turret axis' foot ahead of the azimuth axis [m], the elbow above the line
    from shoulder to wrist (sine of its bend), the turret axis on that side of the approach (sine). The elbow
    also changes its name, without a fold, where the wrist joint passes over or under the elevation joint.
    """
    q = output_rad + s.theta_rad.reshape(5, *(1,) * (output_rad.ndim - 1))
    upper, fore = q[Joint.ELEVATION], q[Joint.ELEVATION] + q[Joint.ELBOW]
    pitch = fore + q[Joint.WRIST]
    x = s.upper_m * np.cos(upper) + s.fore_m * np.cos(fore)
    ahead = s.out_m + x + s.wrist_m * np.cos(pitch) - s.along_m * np.sin(pitch)
    elbow = np.sin(q[Joint.ELBOW])
    return np.stack([-ahead, np.where(x >= 0, -elbow, elbow), np.cos(q[Joint.TURRET] + s.clock_rad)])


def branch_index(signs: Array) -> Integers:
    """The index into BRANCHES for signs (3, ...)."""
    index: Integers = (signs >= 0).astype(np.int64).T @ np.array([4, 2, 1])
    return index.T
