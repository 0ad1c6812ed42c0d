"""Forward kinematics of the deflected chain, and its Jacobians by joint and by frame."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.single_pose import LinkPose, place_links, small_cos_sin, spring_turn
from fsw.kinematics.transforms import IDENTITY, Array, Pose, adjoint, cross, multiply_per_link, rotate

NO_STRAIN: Final = (0.0,) * 36


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Poses along the arm, batch (6, ...) each, links from the rover outward.

    The joint that moves link i turns about the z axis of X_RL[i], through its origin.
    """

    X_RL: Pose
    """Link frames after the turn of their joints, in the rover frame RMECH."""
    X_LD: Pose
    """Far side of each spring in the link frame."""
    X_RF: Pose
    """Frames at the ends of the links, Arm1 to Arm6, in the rover frame."""


def forward(arm: Arm, output_rad: Array, strain: Array | None = None) -> Frames:
    """Compute all frames of the arm: equation 2 of the paper, with a transform for the spring of each link.

    Args:
        arm: Arm.
        output_rad: Output angles, shape (5, ...).
        strain: Spring displacements in rad and m, links second, shape (6, 6, ...); None for the rigid arm.

    Returns:
        The frames.
    """
    if output_rad.ndim == 1:
        return collect_frames(place_pose(arm, output_rad, strain))
    batch = output_rad.shape[1:]
    ones = (1,) * len(batch)
    angle = np.zeros((6, *batch))
    angle[1:] = output_rad
    angle += arm.theta_rad.reshape(6, *ones)
    cosine, sine = np.cos(angle), np.sin(angle)
    # poses are (3, 4, ...), so that one product rotates both rotation and translation
    if strain is None:
        p_LD = arm.p_LC_m.reshape(3, 6, *ones)
        X_LD = Pose(np.broadcast_to(IDENTITY.R.reshape(3, 3, 1, *ones), (3, 3, 6, *ones)), p_LD)
        X_LF = arm.RP_CF.reshape(3, 4, 6, *ones).copy()
    else:
        X_LD = spring_pose(arm, strain)
        R_LD = X_LD.R.reshape(3, 3, 6, -1)
        X_LF = multiply_per_link(arm.RP_CF.swapaxes(0, 1), R_LD).reshape(3, 4, *X_LD.R.shape[2:])
    X_LF[:, 3] += X_LD.p
    X_SF = np.empty((3, 4, 6, *batch))  # in the start frame of the link, before its joint turns
    np.multiply(cosine, X_LF[0], out=X_SF[0])
    X_SF[0] -= sine * X_LF[1]
    np.multiply(sine, X_LF[0], out=X_SF[1])
    X_SF[1] += cosine * X_LF[1]
    X_SF[2] = X_LF[2]
    R_RS = np.empty((3, 3, 7, *batch))
    R_RS[:, :, 0] = IDENTITY.R.reshape(3, 3, *ones)
    R_RS[:, :, 1] = X_SF[:, :3, 0]
    for i in range(1, 6):
        np.einsum("ik...,kj...->ij...", R_RS[:, :, i], X_SF[:, :3, i], out=R_RS[:, :, i + 1])
    p_RS = np.zeros((3, 7, *batch))
    np.add.accumulate(rotate(R_RS[:, :, :6], X_SF[:, 3]), axis=1, out=p_RS[:, 1:])
    R_RL = np.empty((3, 3, 6, *batch))
    x, y = R_RS[:, 0, :6], R_RS[:, 1, :6]
    np.multiply(x, cosine, out=R_RL[:, 0])
    R_RL[:, 0] += y * sine
    np.multiply(y, cosine, out=R_RL[:, 1])
    R_RL[:, 1] -= x * sine
    R_RL[:, 2] = R_RS[:, 2, :6]
    return Frames(Pose(R_RL, p_RS[:, :6]), X_LD, Pose(R_RS[:, :, 1:], p_RS[:, 1:]))


def place_pose(arm: Arm, output_rad: Array, strain: Array | None) -> list[LinkPose]:
    """Place the links of a single pose.

    Args:
        arm: Arm.
        output_rad: Output angles, shape (5,).
        strain: Spring displacements in rad and m, links second, shape (6, 6); None for the rigid arm.

    Returns:
        The poses of the links.
    """
    return place_links(
        arm.links, output_rad.tolist(), NO_STRAIN if strain is None else strain.ravel().tolist()
    )


def collect_frames(placed: list[LinkPose]) -> Frames:
    """Collect the frames of a single pose."""
    numbers = np.array([number for link in placed for part in link for number in part]).reshape(6, 36).T
    rotations = [numbers[k : k + 9].reshape(3, 3, 6) for k in (0, 12, 24)]
    X_RL, X_LD, X_RF = (Pose(R, numbers[k : k + 3]) for R, k in zip(rotations, (9, 21, 33), strict=True))
    return Frames(X_RL, X_LD, X_RF)


def spring_pose(arm: Arm, strain: Array) -> Pose:
    """Compute the far side of each spring in the frame of its link.

    A spring translates, then turns about x, y and z in this order; each turn carries the later axes. The
    spring of the plant does the same. At 45 mrad the order matters by a tenth of a millimetre.

    Args:
        arm: Arm.
        strain: Spring displacements in rad and m, links second, shape (6, 6, ...).

    Returns:
        The poses, batch (6, ...).
    """
    cosine, sine = small_cos_sin(strain[:3])
    R = np.concatenate(spring_turn(*cosine, *sine)).reshape(3, 3, *strain.shape[1:])
    return Pose(R, strain[3:] + arm.p_LC_m.reshape(3, 6, *(1,) * (strain.ndim - 2)))


def tool_pose(arm: Arm, frames: Frames, tool: str) -> Pose:
    """Compute the pose of a tool in the rover frame.

    Args:
        arm: Arm.
        frames: Frames of the arm.
        tool: Name of the tool.

    Returns:
        X_RT, batch (...).
    """
    X_FT, R_RF = arm.X_FT[tool], frames.X_RF.R[:, :, 5]
    R_RT = np.einsum("ik...,kj->ij...", R_RF, X_FT.R)
    return Pose(R_RT, np.einsum("ik...,k->i...", R_RF, X_FT.p) + frames.X_RF.p[:, 5])


def joint_jacobian(frames: Frames, p_R_m: Array) -> Array:
    """Compute the Jacobian of a point fixed to the turret by the joint angles.

    The springs are held: their response to the motion is not included.

    Args:
        frames: Frames of the arm.
        p_R_m: Point in the rover frame, shape (3, ...).

    Returns:
        Screws per joint rate in the rover frame, rotation [rad/rad] first, then translation [m/rad], shape
        (6, 5, ...).
    """
    axis = frames.X_RL.R[:, 2, 1:]
    return np.concatenate([axis, cross(axis, p_R_m[:, None] - frames.X_RL.p[:, 1:])])


def frame_poses(frames: Frames, X_RT: Pose) -> Pose:
    """Collect the frames Arm1 to Arm6 and the tool.

    Args:
        frames: Frames of the arm.
        X_RT: Pose of the tool.

    Returns:
        Poses in the rover frame, batch (7, ...), in the order of Frame.
    """
    R = np.concatenate([frames.X_RF.R, X_RT.R[:, :, None]], axis=2)
    return Pose(R, np.concatenate([frames.X_RF.p, X_RT.p[:, None]], axis=1))


def frame_jacobian(frames: Frames, X_RT: Pose) -> Array:
    """Compute the Jacobian of the tool by small screws of each frame, equations 3 and 7 of the paper.

    A small screw displaces one frame, in its own axes, and all that the frame carries. The springs are held:
    their response to the motion is not included.

    Args:
        frames: Frames of the arm.
        X_RT: Pose of the tool.

    Returns:
        Rotation of the tool and displacement of its origin in rover axes, per screw of each frame, shape (6,
        6, 7, ...), in the order of Frame.
    """
    X_RJ = frame_poses(frames, X_RT)
    return adjoint(Pose(X_RJ.R, X_RJ.p - X_RT.p[:, None]))
