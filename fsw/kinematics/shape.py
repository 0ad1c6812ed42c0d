"""The nearest square arm: axes parallel and at right angles, with the lengths of this arm."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Pose, rotation_x, rotation_z

ROUNDING: Final = 1e-12
LEAST_SKEW: Final = 1e-4
MOST_SKEW: Final = 0.02
"""A tool with less offset [m] and lean [cosine] is taken for radial, and aiming off does the rest: for a
square arm, the closed form would lose digits; for another, it is only the place to start from."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """The lengths of the square arm with one tool, as the closed form sees them."""

    X_R1: Pose
    theta_rad: Array
    out_m: float
    down_m: float
    upper_m: float
    fore_m: float
    wrist_m: float
    lateral_m: float
    along_m: float
    """Turret axis: wrist centre to the foot of the tool's offset."""
    radius_m: float
    """Tool point along the boresight from that foot."""
    offset_m: float
    """Distance at which the boresight passes the turret axis; 0 for a radial tool."""
    boresight_z: float
    """Cosine of boresight and turret axis; 0 for a radial tool."""
    clock_rad: float
    is_exact: bool
    """Whether this is the arm itself: its axes are square, and the tool is radial or taken as it is."""


def shape_of(theta_rad: Array, X_LF: Pose, X_FT: Pose) -> Shape:
    """The shape of links that turn by theta (6,) and end in X_LF (batch 6), with a tool in frame Arm6."""
    p = X_LF.p
    (bx, by, bz), (px, py, pz) = X_FT.R[:, 0], X_FT.p
    flat = bx * bx + by * by
    radius = (px * bx + py * by) / flat
    turn = rotation_z(theta_rad[0])
    offset = (py * bx - px * by) / flat
    skew = max(abs(offset), abs(bz))
    is_square = _is_square(X_LF)
    nearly_radial = LEAST_SKEW if is_square else MOST_SKEW
    least = nearly_radial if skew < nearly_radial else ROUNDING
    offset, bz = (0.0 if abs(value) < least else value for value in (offset, bz))
    return Shape(
        X_R1=Pose(turn @ X_LF.R[:, :, 0], turn @ p[:, 0]),
        theta_rad=theta_rad[1:],
        out_m=p[0, 1],
        down_m=p[2, 1],
        upper_m=p[0, 2],
        fore_m=p[0, 3],
        wrist_m=p[0, 4],
        lateral_m=p[2, 2] + p[2, 3] + p[2, 4] - p[1, 1],
        along_m=p[2, 5] + pz - radius * bz,
        radius_m=radius,
        offset_m=offset,
        boresight_z=bz,
        clock_rad=float(np.arctan2(by, bx)),
        is_exact=is_square and not ROUNDING < skew < nearly_radial,
    )


def _is_square(X_LF: Pose) -> bool:
    """Parallel and right-angled axes, no offsets beyond those of Shape."""
    quarter = [np.pi / 2, 0.0, 0.0, -np.pi / 2, 0.0]
    turns = np.stack([rotation_x(np.array(angle)) for angle in quarter], -1)
    offsets = [*X_LF.p[1, 2:], *X_LF.p[0, 5:]]
    return bool(np.abs(X_LF.R[:, :, 1:] - turns).max() < 1e-15 and np.abs(offsets).max() < 1e-15)
