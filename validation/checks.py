"""What an answer of the inverse kinematics is held to, computed anew from forward kinematics alone."""

from typing import Final

import numpy as np

from fsw.kinematics.ik import BranchVerdict, IkResult
from fsw.kinematics.transforms import Array, Flags, dot, norm, wrap_angle
from validation.cases import Trial

STEP_RAD: Final = 1e-4
"""Of the central differences; `rest` is good to 1e-11, so the derivative is to 1e-7."""
SAME_RAD: Final = 1e-6
CLEAR_SIGMA: Final = 1e-4
"""A pose with a larger smallest singular value must be among the answers to its own target."""


def claimed(answers: IkResult) -> Flags:
    """Roots (S, ...) that are said to meet the target.

    Where an arm hangs or is not square, a root far outside the limits has no angles and no error.
    """
    has_angles = (answers.verdict == BranchVerdict.VALID) | (answers.verdict == BranchVerdict.OUTSIDE_LIMITS)
    return has_angles & ((answers.verdict == BranchVerdict.VALID) | np.isfinite(answers.error))


def errors(trial: Trial, answers: IkResult, p_m: Array, approach: Array) -> Array:
    """(S, n): how far each claimed root leaves the tool, the larger of metres and radians; else NaN."""
    roots = claimed(answers)
    worst = np.full(roots.shape, np.nan)
    X_RT = trial.tool_pose(answers.output_rad[:, roots])
    which = np.nonzero(roots)[1]
    off_m, off_axis = norm(X_RT.p - p_m[:, which]), norm(X_RT.R[:, 0] - approach[:, which])
    worst[roots] = np.maximum(off_m, off_axis)
    return worst


def apart(answers: IkResult, q: Array) -> Array:
    """(S, n): from each claimed root to the vector of its target, whole turns apart; else infinite."""
    distance = np.abs(wrap_angle(answers.output_rad - q[:, None])).max(axis=0)
    return np.where(claimed(answers), distance, np.inf)


def task_jacobian(trial: Trial, q: Array) -> Array:
    """(5, 5, n): position and approach by the joints, the load's response included; central differences."""
    n = q.shape[1]
    moves = STEP_RAD * np.stack([np.eye(5), -np.eye(5)], axis=-1)
    X = trial.tool_pose((q[:, None, None] + moves[..., None]).reshape(5, -1))
    p, x = ((v[:, :, 0] - v[:, :, 1]) / (2 * STEP_RAD) for v in (X.p.reshape(3, 5, 2, n), _x_axes(X.R, n)))
    R_RT = trial.tool_pose(q).R
    turns = [dot(R_RT[:, k, None], x) for k in (1, 2)]
    return np.concatenate([p, np.stack(turns)])


def _x_axes(R: Array, n: int) -> Array:
    return R[:, 0].reshape(3, 5, 2, n)


def smallest_singular_value(trial: Trial, q: Array) -> Array:
    """(n): 0 where two roots meet."""
    J = np.moveaxis(task_jacobian(trial, q), -1, 0)
    return np.asarray(np.linalg.svd(J, compute_uv=False)[:, -1], np.float64)
