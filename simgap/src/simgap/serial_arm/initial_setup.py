"""Initial estimate of base and target frames, in closed form from measured poses."""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.serial_arm.arm import SerialArm
from simgap.serial_arm.chain import forward_kinematics
from simgap.serial_arm.model import TrackerSetup
from simgap.serial_arm.poses import IDENTITY, Pose, compose, norm, repeat_pose
from simgap.serial_arm.series import PoseSeries

LEAST_POSES: Final = 20
LEAST_TURN_RAD: Final = 0.2
"""Smallest spread of the rotation of the target about two axes; below it, base and target are confounded."""
MAX_ROTATION_ERROR_RAD: Final = 0.1
"""Largest median rotation error; a larger one is not an error of an arm."""
MAX_POSITION_ERROR_M: Final = 0.05


def estimate_setup(arm: SerialArm, series: PoseSeries) -> TrackerSetup:
    """Estimate the frames of base and target from poses of the uncalibrated arm.

    R_TM = R_TB R_BF R_FM is bilinear in R_TB and R_FM. Both follow from the leading singular pair of the sum
    of Kronecker products of R_TM and R_BF (M. Shah, J. Mechanisms Robotics 5, 2013). Translations are
    then linear.

    Raises:
        RobotError: Too few poses, too similar poses, or poses of another arm, unit or frame.
    """
    if series.count < LEAST_POSES:
        raise RobotError(f"{series.count} poses are too few; {LEAST_POSES} or more are wanted")
    ends, _ = forward_kinematics(repeat_pose(IDENTITY, series.count), arm.link_geometry, series.joint_rad)
    X_BF = ends[-1]
    _check_rotations(X_BF)
    R_TB, R_FM = _solve_rotations(series.X_TM.R, X_BF.R)
    rotation_error_rad = _angle(compose(np.swapaxes(series.X_TM.R, 0, 1), _product(R_TB, X_BF.R, R_FM)))
    if np.median(rotation_error_rad) > MAX_ROTATION_ERROR_RAD:
        raise RobotError(
            f"the target does not turn as the arm's flange does: half of the poses are off by "
            f"{np.degrees(np.median(rotation_error_rad)):.1f} deg or more; "
            "see that angles have their units, rotations the order "
            "that the tracker means, and joints the arm's names and signs"
        )
    setup = _solve_translations(series, X_BF, R_TB, R_FM)
    position_error_m = norm(series.X_TM.p - _target_poses(setup, X_BF).p)
    if np.median(position_error_m) > MAX_POSITION_ERROR_M:
        raise RobotError(
            f"the target does not move as the arm's flange does: half of the poses are off by "
            f"{np.median(position_error_m) * 1e3:.0f} mm or more; {_scale_words(series, X_BF)}"
        )
    return setup


def _check_rotations(X_BF: Pose) -> None:
    turns = _log(compose(np.swapaxes(X_BF.R, 0, 1), X_BF.R[:, :, :1]))
    spread = np.linalg.svd(turns - turns.mean(axis=1, keepdims=True), compute_uv=False)
    if spread[1] / np.sqrt(turns.shape[1]) < LEAST_TURN_RAD / 2:
        raise RobotError(
            "the poses are too much alike: the flange hardly turns about a second axis, so base and target "
            "cannot be told apart; give poses that turn by half a radian or more about two axes"
        )


def _solve_rotations(R_TM: Array, R_BF: Array) -> tuple[Array, Array]:
    both = np.einsum("ijn,kln->ikjl", R_TM, R_BF).reshape(9, 9)
    U, _, Vt = np.linalg.svd(both)
    R_TB, R_MF = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(R_TB))
    return _nearest_rotation(sign * R_TB), _nearest_rotation(sign * R_MF).T


def _nearest_rotation(M: Array) -> Array:
    U, _, Vt = np.linalg.svd(M)
    R: Array = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R


def _solve_translations(series: PoseSeries, X_BF: Pose, R_TB: Array, R_FM: Array) -> TrackerSetup:
    """Find the translations with the least squared position errors."""
    R_TF = np.einsum("ij,jkn->ikn", R_TB, X_BF.R)
    rows = np.concatenate([np.broadcast_to(np.eye(3)[:, :, None], R_TF.shape), R_TF], axis=1)
    difference = series.X_TM.p - np.einsum("ij,jn->in", R_TB, X_BF.p)
    flat = np.moveaxis(rows, 2, 0).reshape(-1, 6)
    shifts = np.linalg.lstsq(flat, difference.T.ravel(), rcond=None)[0]
    return TrackerSetup(Pose(R_TB, shifts[:3]), Pose(R_FM, shifts[3:]))


def _target_poses(setup: TrackerSetup, X_BF: Pose) -> Pose:
    n = X_BF.p.shape[1]
    return repeat_pose(setup.X_TB, n) @ X_BF @ repeat_pose(setup.X_FM, n)


def _scale_words(series: PoseSeries, X_BF: Pose) -> str:
    """Describe an error of units, if the motions differ in size."""
    measured, modelled = (np.sqrt(np.mean(np.var(p, axis=1))) for p in (series.X_TM.p, X_BF.p))
    if not 0.2 < measured / modelled < 5.0:
        return f"it moves {measured / modelled:.3g} times as far: see that positions have their unit"
    return "see that this is the arm of the file, and that positions and joints have their order and signs"


def _product(R_TB: Array, R_BF: Array, R_FM: Array) -> Array:
    product: Array = np.einsum("ij,jkn,kl->iln", R_TB, R_BF, R_FM)
    return product


def _angle(R: Array) -> Array:
    angle: Array = np.arccos(np.clip((np.trace(R) - 1) / 2, -1.0, 1.0))
    return angle


def _log(R: Array) -> Array:
    turns: Array = Rotation.from_matrix(np.moveaxis(R, -1, 0)).as_rotvec().T
    return turns
