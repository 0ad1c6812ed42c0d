"""The arm as arrays: what follows from the parameters once, so that no cycle computes it again."""

from dataclasses import dataclass, replace

import numpy as np

from fsw.dictionary.params import Lump, Params, Transform6
from fsw.kinematics.shape import Shape, shape_of
from fsw.kinematics.transforms import Array, Pose, batched, rotation_x, rotation_y, rotation_z, screw_exp


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """Constant arrays of the chain; links from the rover outward (6), joints (5), tools (5).

    A link turns by theta plus its joint angle about the z axis of the frame before it, carries its near lump,
    yields at its spring C, and carries its far lump and the next frame F beyond the spring.
    """

    theta_rad: Array
    """Constant turn of each link about its start frame's z, (6,)."""
    p_LC_m: Array
    """Spring position in the link frame, (3, 6)."""
    RP_CF: Array
    """Next frame as seen from the unloaded spring, rotation and position side by side, (3, 4, 6)."""
    compliance: Array
    """(6, 6, 6): (moment, force) to (rotation, translation), links last."""
    near_kg: Array
    far_kg: Array
    carried_kg: Array
    """Mass of each link and all links beyond."""
    near_p_L_m: Array
    """Near lumps in the link frame, (3, 6)."""
    far_p_C_m: Array
    """Far lumps as seen from the spring, (3, 6)."""
    X_FT: tuple[Pose, ...]
    """Tool frames in Arm6, in the order of Tool."""
    expansion_F: Array
    """Thermal screw of each link per kelvin, at its end and in its end frame, (6, 6), links last."""
    expansion_T: Array
    """Likewise of each tool, (6, 5)."""
    gear_stiffness_Nm_rad: Array
    soft_min_rad: Array
    soft_max_rad: Array
    shapes: tuple[Shape, ...]
    """The nearest square arm with each tool, for the closed form of the inverse kinematics."""

    @property
    def X_CF(self) -> Pose:
        """The same as poses, batch (6,)."""
        return Pose(self.RP_CF[:, :3], self.RP_CF[:, 3])


def arm_from(params: Params) -> Arm:
    """The arrays of this arm at calibration temperature."""
    links, joints, tools = params.links.in_order(), params.joints.in_order(), params.tools.in_order()
    theta = np.array([link.transform.theta_rad for link in links])
    centre = np.array([link.elastic_centre_m for link in links]).T
    X_LF = batched([transform6(replace(link.transform, theta_rad=0.0)) for link in links])
    X_FT = tuple(transform6(tool.transform) for tool in tools)
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
        shapes=tuple(shape_of(theta, X_LF, tool) for tool in X_FT),
    )


def warmed(arm: Arm, warming_K: float) -> Arm:
    """The arm this much warmer than at calibration: paper equation 6, as finite transforms."""
    X_CF = arm.X_CF @ screw_exp(arm.expansion_F * warming_K)
    tools = batched(arm.X_FT) @ screw_exp(arm.expansion_T * warming_K)
    X_FT = tuple(tools[k] for k in range(len(arm.X_FT)))
    X_LF = Pose(X_CF.R, X_CF.p + arm.p_LC_m)
    return replace(
        arm,
        RP_CF=_side_by_side(X_CF),
        X_FT=X_FT,
        shapes=tuple(shape_of(arm.theta_rad, X_LF, tool) for tool in X_FT),
    )


def transform6(t: Transform6) -> Pose:
    """The general link transform, paper equation 1."""
    R_theta, R_beta, R_alpha = (
        rotation_z(np.array(t.theta_rad)),
        rotation_y(np.array(t.beta_rad)),
        rotation_x(np.array(t.alpha_rad)),
    )
    p_m = R_theta @ (np.array([0, 0, t.d_m]) + R_beta @ np.array([t.a_m, t.b_m, 0]))
    return Pose(R_theta @ R_beta @ R_alpha, p_m)


def transform6_from(X: Pose) -> Transform6:
    """The six parameters of a pose whose x axis is not along the start frame's z."""
    R = X.R
    theta, beta, alpha = (
        np.arctan2(R[1, 0], R[0, 0]),
        np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])),
        np.arctan2(R[2, 1], R[2, 2]),
    )
    x, y, z = rotation_z(theta).T @ X.p
    a = x / np.cos(beta)
    return Transform6(*(float(v) for v in (theta, z + a * np.sin(beta), beta, y, alpha, a)))


def _positions(lumps: list[Lump]) -> Array:
    return np.array([lump.com_m for lump in lumps]).T


def _side_by_side(X: Pose) -> Array:
    return np.concatenate([X.R, X.p[:, None]], axis=1)
