"""Forward kinematics of the strained chain, and its Jacobian."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import Array, rigid, rotation_x, rotation_y, rotation_z


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Poses along the arm in the rover frame RMECH, outward, (..., 6, 4, 4) each.

    The joint that moves link i turns about the z axis of X_RF[i - 1] through its origin.
    """

    X_RC: Array
    """Each link's spring, near side."""
    X_RD: Array
    """Each link's spring, far side."""
    X_RF: Array
    """Arm1 to Arm6."""


def forward(arm: Arm, output_rad: Array, strain: Array | None = None) -> Frames:
    """Frames for output angles (..., 5) and spring strains (..., 6, 6); no strain is the rigid arm.

    Paper equation 2, with the spring of each link as one more transform.
    """
    turn = np.zeros((*output_rad.shape[:-1], 6))
    turn[..., 1:] = output_rad
    R = rotation_z(turn + arm.theta_rad)
    X_LC = rigid(R, (R @ arm.p_LC_m[..., None])[..., 0])
    if strain is None:
        X_CD = np.broadcast_to(np.eye(4), X_LC.shape)
        X_LF = X_LC @ arm.X_CF
    else:
        X_CD = strain_transform(strain)
        X_LF = X_LC @ X_CD @ arm.X_CF
    X_RF = np.empty_like(X_LF)
    X_RF[..., 0, :, :] = X_LF[..., 0, :, :]
    for i in range(1, 6):
        np.matmul(X_RF[..., i - 1, :, :], X_LF[..., i, :, :], out=X_RF[..., i, :, :])
    X_RC = X_LC.copy()
    np.matmul(X_RF[..., :5, :, :], X_LC[..., 1:, :, :], out=X_RC[..., 1:, :, :])
    return Frames(X_RC, X_RC @ X_CD, X_RF)


def strain_transform(strain: Array) -> Array:
    """A spring's displacement as a finite transform: translate, then turn about x, y and z in this order.

    The order is that of the plant's spring; at 45 mrad it matters by a tenth of a millimetre.
    """
    R = rotation_x(strain[..., 0]) @ rotation_y(strain[..., 1]) @ rotation_z(strain[..., 2])
    return rigid(R, strain[..., 3:])


def tool_pose(arm: Arm, frames: Frames, tool: int) -> Array:
    """X_RT of a tool, (..., 4, 4)."""
    X_RT: Array = frames.X_RF[..., 5, :, :] @ arm.X_FT[tool]
    return X_RT


def joint_jacobian(frames: Frames, p_R_m: Array) -> Array:
    """Screw of a point fixed to the turret per joint rate, (..., 6, 5), rotation first, in the rover frame.

    Point p (..., 3) in the rover frame. The springs' own response to the motion is left out.
    """
    axis = frames.X_RF[..., :5, :3, 2]
    arm_m = p_R_m[..., None, :] - frames.X_RF[..., :5, :3, 3]
    return np.swapaxes(np.concatenate([axis, np.cross(axis, arm_m)], axis=-1), -1, -2)
