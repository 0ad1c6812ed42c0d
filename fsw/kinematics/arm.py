"""The arm as arrays: what follows from the parameters once, so that no cycle computes it again."""

from dataclasses import dataclass

import numpy as np

from fsw.dictionary.params import LinkParams, Params, Transform6
from fsw.kinematics.transforms import Array, rigid, rotation_x, rotation_y, rotation_z, translation


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """Constant arrays of the chain and its joints; links from the rover outward (6), joints (5), tools (5).

    A link turns by theta plus its joint angle about the z axis of the frame before it, carries its near lump,
    yields at its spring C, and carries its far lump and the next frame F beyond the spring.
    """

    theta_rad: Array
    """Constant turn of each link about its start frame's z, shape (6,)."""
    p_LC_m: Array
    """Spring position in the link frame, (6, 3)."""
    X_CF: Array
    """Next frame as seen from the unloaded spring, (6, 4, 4)."""
    compliance: Array
    """(6, 6, 6): (moment, force) to (rotation, translation)."""
    near_kg: Array
    far_kg: Array
    near_p_C_m: Array
    far_p_C_m: Array
    """Lump positions as seen from the spring, (6, 3)."""
    X_FT: Array
    """Tool frames in Arm6, (5, 4, 4)."""
    gear_stiffness_Nm_rad: Array
    soft_min_rad: Array
    soft_max_rad: Array


def arm_from(params: Params) -> Arm:
    """The arrays of this arm."""
    links, joints = params.links.in_order(), params.joints.in_order()
    centre = np.array([link.elastic_centre_m for link in links])
    return Arm(
        theta_rad=np.array([link.transform.theta_rad for link in links]),
        p_LC_m=centre,
        X_CF=np.stack([_frame_from_spring(link) for link in links]),
        compliance=np.array([link.compliance for link in links]),
        near_kg=np.array([link.near.mass_kg for link in links]),
        far_kg=np.array([link.far.mass_kg for link in links]),
        near_p_C_m=np.array([link.near.com_m for link in links]) - centre,
        far_p_C_m=np.array([link.far.com_m for link in links]) - centre,
        X_FT=np.stack([transform6(tool) for tool in params.tools.in_order()]),
        gear_stiffness_Nm_rad=np.array([joint.gear_stiffness_Nm_rad for joint in joints]),
        soft_min_rad=np.array([joint.soft_min_rad for joint in joints]),
        soft_max_rad=np.array([joint.soft_max_rad for joint in joints]),
    )


def transform6(t: Transform6) -> Array:
    """The general link transform, paper equation 1, 4x4."""
    R_theta, R_beta, R_alpha = (
        rotation_z(np.array(t.theta_rad)),
        rotation_y(np.array(t.beta_rad)),
        rotation_x(np.array(t.alpha_rad)),
    )
    p_m = R_theta @ (np.array([0, 0, t.d_m]) + R_beta @ np.array([t.a_m, t.b_m, 0]))
    return rigid(R_theta @ R_beta @ R_alpha, p_m)


def transform6_from(X: Array) -> Transform6:
    """The six parameters of a transform (4x4) whose x axis is not along the start frame's z."""
    R, p_m = X[:3, :3], X[:3, 3]
    theta, beta, alpha = (
        np.arctan2(R[1, 0], R[0, 0]),
        np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])),
        np.arctan2(R[2, 1], R[2, 2]),
    )
    x, y, z = rotation_z(theta).T @ p_m
    a = x / np.cos(beta)
    return Transform6(*(float(v) for v in (theta, z + a * np.sin(beta), beta, y, alpha, a)))


def _frame_from_spring(link: LinkParams) -> Array:
    turned = rigid(rotation_z(np.array(-link.transform.theta_rad)), np.zeros(3)) @ transform6(link.transform)
    return translation(-np.array(link.elastic_centre_m)) @ turned
