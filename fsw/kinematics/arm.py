"""The arm as constant arrays, the orthogonal arm, and soft limits: what the parameters determine once.

The orthogonal arm has the lengths of this arm, and axes that are parallel or at right angles. The closed form
of the inverse kinematics solves it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import cos, floor, log10, sin
from typing import Final, NamedTuple

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params, PointMass, Transform6
from fsw.kinematics.transforms import Array, Pose, rotation_x, rotation_z, screw_exp, stack_poses, wrap_angle

ROUNDING: Final = 1e-12
"""Relative rounding error of a length or a cosine."""
MIN_SKEW: Final = 1e-4
MAX_SKEW: Final = 0.02
"""Below this offset [m] and inclination [cosine], the closed form treats a tool as radial.

The fixed-point iteration corrects the difference. MIN_SKEW holds for an orthogonal arm, whose closed form
would lose digits. MAX_SKEW holds for any other arm, where the closed form only gives a start.
"""


@dataclass(frozen=True, slots=True, eq=False)
class OrthogonalArm:
    """Lengths of the orthogonal arm with one tool, as the closed form uses them."""

    X_R1: Pose
    """Frame Arm1 in the rover frame."""
    theta_rad: Array
    """Constant turn of each joint, (5,)."""
    out_m: float
    down_m: float
    upper_m: float
    fore_m: float
    wrist_m: float
    lateral_m: float
    along_m: float
    """Distance along the turret axis from the wrist centre to the foot of the tool's offset."""
    radius_m: float
    """Distance along the boresight from that foot to the tool point."""
    offset_m: float
    """Distance between the boresight and the turret axis; 0 for a radial tool."""
    boresight_z: float
    """Cosine of the angle between boresight and turret axis; 0 for a radial tool."""
    clock_rad: float
    """Angle of the boresight about the turret axis."""
    is_exact: bool
    """True if the arm itself is orthogonal and the tool was not approximated as radial."""


def build_orthogonal_arm(theta_rad: Array, X_LF: Pose, X_FT: Pose) -> OrthogonalArm:
    """Build the orthogonal arm nearest to a chain with one tool.

    Args:
        theta_rad: Constant turn of each link, shape (6,).
        X_LF: Frame at the end of each link in the link frame, batch (6,).
        X_FT: Tool frame in frame Arm6.
    """
    p = X_LF.p
    (bx, by, bz), (px, py, pz) = X_FT.R[:, 0], X_FT.p
    flat = bx * bx + by * by
    radius = (px * bx + py * by) / flat
    turn = rotation_z(theta_rad[0])
    offset = (py * bx - px * by) / flat
    skew = max(abs(offset), abs(bz))
    is_orthogonal = _is_orthogonal(X_LF)
    nearly_radial = MIN_SKEW if is_orthogonal else MAX_SKEW
    least = nearly_radial if skew < nearly_radial else ROUNDING
    offset, bz = (0.0 if abs(value) < least else value for value in (offset, bz))
    return OrthogonalArm(
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
        is_exact=is_orthogonal and not ROUNDING < skew < nearly_radial,
    )


class OrthogonalArms(dict[str, OrthogonalArm]):
    """Orthogonal arms by tool; each is built when it is first read, as most arms use one tool."""

    def __init__(self, theta_rad: Array, X_LF: Pose, X_FT: Mapping[str, Pose]) -> None:
        """Keep the chain, see `build_orthogonal_arm`, and the frames of all tools."""
        self._theta_rad, self._X_LF, self._X_FT = theta_rad, X_LF, X_FT

    def __missing__(self, tool: str) -> OrthogonalArm:
        self[tool] = build_orthogonal_arm(self._theta_rad, self._X_LF, self._X_FT[tool])
        return self[tool]


def _is_orthogonal(X_LF: Pose) -> bool:
    """Check for parallel and right-angled axes and for offsets that OrthogonalArm lacks."""
    quarter = [np.pi / 2, 0.0, 0.0, -np.pi / 2, 0.0]
    turns = np.stack([rotation_x(np.array(angle)) for angle in quarter], -1)
    offsets = [*X_LF.p[1, 2:], *X_LF.p[0, 5:]]
    return bool(np.abs(X_LF.R[:, :, 1:] - turns).max() < 1e-15 and np.abs(offsets).max() < 1e-15)


Vector = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]
"""Matrix row by row."""
Row = tuple[float, float, float, float, float, float]


class Link(NamedTuple):
    """Constant numbers of a link; they are those of `Arm`."""

    theta_rad: float
    p_LC_m: Vector
    R_CF: Rotation
    p_CF_m: Vector
    compliance: tuple[Row, ...]
    near_kg: float
    far_kg: float
    near_kg_m: Vector
    """First moment of the near mass in the link frame."""
    far_kg_m: Vector
    """First moment of the far mass about the spring."""


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """Constant arrays of the chain; links from the rover outward (6), joints (5), tools (n).

    A link turns by theta plus its joint angle about the z axis of the frame before it. It carries its near
    mass, deflects at its spring C, and carries its far mass and the next frame F beyond the spring.
    """

    theta_rad: Array
    """Constant turn of each link about the z axis of its start frame, (6,)."""
    p_LC_m: Array
    """Position of the spring in the link frame, (3, 6)."""
    RP_CF: Array
    """Next frame in the frame of the unloaded spring, rotation and position side by side, (3, 4, 6)."""
    compliance: Array
    """Compliance from (moment, force) to (rotation, translation), links last, (6, 6, 6)."""
    near_kg: Array
    """Mass before the spring of each link, (6,)."""
    far_kg: Array
    """Mass beyond the spring of each link, (6,)."""
    carried_kg: Array
    """Mass of each link and of all links beyond it, (6,)."""
    near_p_L_m: Array
    """Near point masses in the link frame, (3, 6)."""
    far_p_C_m: Array
    """Far point masses relative to the spring, (3, 6)."""
    X_FT: Mapping[str, Pose]
    """Frame of each tool in frame Arm6, in the order of the parameters."""
    expansion_F: Array
    """Thermal screw of each link per kelvin, at its end and in its end frame, (6, 6), links last."""
    expansion_T: Array
    """Thermal screw of each tool per kelvin, in its own frame, (6, n)."""
    gear_stiffness_Nm_rad: Array
    """Stiffness between motor and output, (5,)."""
    soft_min_rad: Array
    """Lowest output angles, (5,)."""
    soft_max_rad: Array
    """Highest output angles, (5,)."""
    orthogonal: Mapping[str, OrthogonalArm]
    """Nearest orthogonal arm with each tool."""
    links: tuple[Link, ...] = field(init=False)
    """The same numbers link by link, for single poses."""

    def __post_init__(self) -> None:
        columns = (
            self.theta_rad,
            self.p_LC_m,
            self.RP_CF[:, :3].reshape(9, 6),
            self.RP_CF[:, 3],
            self.compliance,
            self.near_kg,
            self.far_kg,
            self.near_kg * self.near_p_L_m,
            self.far_kg * self.far_p_C_m,
        )
        links = zip(*(np.moveaxis(column, -1, 0).tolist() for column in columns), strict=True)
        object.__setattr__(self, "links", tuple(Link(*link) for link in links))

    @property
    def X_CF(self) -> Pose:
        """Next frames in the frames of the unloaded springs, batch (6,)."""
        return Pose(self.RP_CF[:, :3], self.RP_CF[:, 3])


def build_arm(params: Params) -> Arm:
    """Build the arm of these parameters at the calibration temperature."""
    links, joints, tools = params.links.in_order(), params.joints.in_order(), params.tools
    theta = np.array([link.transform.theta_rad for link in links])
    centre = np.array([link.elastic_centre_m for link in links]).T
    X_LF = stack_poses([transform6_to_pose(replace(link.transform, theta_rad=0.0)) for link in links])
    X_FT = {tool.name: transform6_to_pose(tool.transform) for tool in tools}
    near_kg, far_kg = (np.array([getattr(link, side).mass_kg for link in links]) for side in ("near", "far"))
    return Arm(
        theta_rad=theta,
        p_LC_m=centre,
        RP_CF=_side_by_side(Pose(X_LF.R, X_LF.p - centre)),
        compliance=np.moveaxis(np.array([link.compliance for link in links]), 0, -1),
        near_kg=near_kg,
        far_kg=far_kg,
        carried_kg=np.cumsum((near_kg + far_kg)[::-1])[::-1],
        near_p_L_m=_positions([link.near for link in links]),
        far_p_C_m=_positions([link.far for link in links]) - centre,
        X_FT=X_FT,
        expansion_F=np.array([link.expansion_1_K for link in links]).T,
        expansion_T=np.array([tool.expansion_1_K for tool in tools]).T,
        gear_stiffness_Nm_rad=np.array([joint.gear_stiffness_Nm_rad for joint in joints]),
        soft_min_rad=np.array([joint.soft_min_rad for joint in joints]),
        soft_max_rad=np.array([joint.soft_max_rad for joint in joints]),
        orthogonal=OrthogonalArms(theta, X_LF, X_FT),
    )


def heat_arm(arm: Arm, warming_K: float) -> Arm:
    """Build the arm warmer than at its calibration: equation 6 of the paper, with finite transforms."""
    X_CF = arm.X_CF @ screw_exp(arm.expansion_F * warming_K)
    tools = stack_poses(list(arm.X_FT.values())) @ screw_exp(arm.expansion_T * warming_K)
    X_FT = {name: tools[k] for k, name in enumerate(arm.X_FT)}
    X_LF = Pose(X_CF.R, X_CF.p + arm.p_LC_m)
    return replace(
        arm, RP_CF=_side_by_side(X_CF), X_FT=X_FT, orthogonal=OrthogonalArms(arm.theta_rad, X_LF, X_FT)
    )


def transform6_to_pose(t: Transform6) -> Pose:
    """Compute the pose of a general link transform, equation 1 of the paper."""
    ct, st = cos(t.theta_rad), sin(t.theta_rad)
    cb, sb = cos(t.beta_rad), sin(t.beta_rad)
    ca, sa = cos(t.alpha_rad), sin(t.alpha_rad)
    R = [
        [ct * cb, ct * sb * sa - st * ca, ct * sb * ca + st * sa],
        [st * cb, st * sb * sa + ct * ca, st * sb * ca - ct * sa],
        [-sb, cb * sa, cb * ca],
    ]
    p_m = [ct * cb * t.a_m - st * t.b_m, st * cb * t.a_m + ct * t.b_m, t.d_m - sb * t.a_m]
    return Pose(np.array(R), np.array(p_m))


def pose_to_transform6(X: Pose) -> Transform6:
    """Compute the six parameters of a pose, the inverse of equation 1 of the paper.

    Args:
        X: Pose whose x axis is not parallel to the z axis of the start frame.
    """
    R = X.R
    theta, beta, alpha = (
        np.arctan2(R[1, 0], R[0, 0]),
        np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])),
        np.arctan2(R[2, 1], R[2, 2]),
    )
    x, y, z = rotation_z(theta).T @ X.p
    a = x / np.cos(beta)
    return Transform6(*(float(v) for v in (theta, z + a * np.sin(beta), beta, y, alpha, a)))


def _positions(masses: list[PointMass]) -> Array:
    """Collect the positions of point masses, (3, n)."""
    return np.array([mass.com_m for mass in masses]).T


def _side_by_side(X: Pose) -> Array:
    """Join rotation and position, (3, 4, ...)."""
    return np.concatenate([X.R, X.p[:, None]], axis=1)


def wrap_into_limits(arm: Arm, q: Array, near_rad: Array | None = None) -> Array:
    """Add whole turns to angles so that they lie inside the soft limits, shape (5, ...) [rad].

    If no turn fits, the result is the turn nearest to the limits.

    Args:
        near_rad: Angles to stay near if two turns fit, shape (5,); None for the middle of the limits.
    """
    low, high = _limits(arm, q)
    middle = 0.5 * (low + high)
    central = middle + wrap_angle(q - middle)
    if near_rad is None:
        return central
    near = np.clip(near_rad.reshape(low.shape), low, high)
    best = near + wrap_angle(q - near)
    inside = (best >= low) & (best <= high)
    return np.where(inside, best, central)


def limit_excess(arm: Arm, q: Array) -> Array:
    """Compute the excess of joint angles over the soft limits, (5, ...) [rad]; negative inside."""
    low, high = _limits(arm, q)
    return np.maximum(low - q, q - high)


def describe_outside(arm: Arm, joint: Joint, angle_rad: float) -> str:
    """Describe a joint outside its soft limits, with enough digits to show the excess."""
    low, high = arm.soft_min_rad[joint], arm.soft_max_rad[joint]
    places = max(1, 1 - floor(log10(np.degrees(max(low - angle_rad, angle_rad - high, 1e-12)))))
    angle = f"{np.degrees(angle_rad):.{min(places, 9)}f} deg"
    return f"joint {joint.name.lower()}: {angle} is outside {_describe_range(arm, joint, min(places, 9))}"


def format_digits(value: float, places: int) -> str:
    """Format a positive number with this many decimals, or more if it would read as 0."""
    return f"{value:.{max(places, -floor(log10(max(value, 1e-12))))}f}"


def describe_estimated_outside(arm: Arm, joint: Joint, beyond_rad: float) -> str:
    """Describe a joint outside its soft limits whose angle is only estimated."""
    limits = _describe_range(arm, joint, 1)
    return f"joint {joint.name.lower()}: about {np.degrees(beyond_rad):.1f} deg outside {limits}"


def _describe_range(arm: Arm, joint: Joint, places: int) -> str:
    """Describe the soft limits of a joint in degrees."""
    low_deg, high_deg = np.degrees(arm.soft_min_rad[joint]), np.degrees(arm.soft_max_rad[joint])
    return f"its soft limits {low_deg:.{places}f} .. {high_deg:.{places}f} deg"


def _limits(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return the lowest and highest angles, with as many axes as the angles."""
    ones = (1,) * (q.ndim - 1)
    return arm.soft_min_rad.reshape(5, *ones), arm.soft_max_rad.reshape(5, *ones)
