"""Random targets and joint vectors, with emphasis on singularities and limits.

Two roots meet at a straight elbow, at an approach parallel to the pitch axes, and where the turret axis
intersects the azimuth axis. Distances of joint vectors from there have a uniform logarithm, from 1 urad to
0.3 rad. So have distances of targets from the faces of the workspace.
"""

from enum import IntFlag
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import limit_excess, wrap_into_limits
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.transforms import Array, cross, dot, norm
from sim.frames import P_NR_M, PRIMARY
from validation.kinematics_trials import Trial, task_jacobian

NEAREST: Final = 1e-6
FARTHEST: Final = 0.3
REFINED_SHARE: Final = 0.3
"""Share of the vectors near a double root whose distance is from the double root of the deflected arm."""
SECANT_STEPS: Final = 5
SECANT_FIRST_RAD: Final = 1e-3
SECANT_REACH_RAD: Final = 0.1
REACH_M: Final = 2.5

Kinds = NDArray[np.int64]


class Near(IntFlag):
    """Double roots and limits that a joint vector is near; several flags are a crossing of double roots."""

    NOTHING = 0
    ELBOW = 1
    """Straight elbow."""
    WRIST = 2
    """Approach parallel to the pitch axes."""
    SHOULDER = 4
    """Turret axis over or under the azimuth axis."""
    LIMIT = 8
    """Soft limit of a joint."""


JOINT_OF: Final = {Near.ELBOW: Joint.ELBOW, Near.WRIST: Joint.TURRET, Near.SHOULDER: Joint.ELEVATION}
"""Joint that is moved towards each double root; the shoulder is last, because it depends on the elbow."""


class Aim(IntFlag):
    """Method by which a target was drawn."""

    WORKSPACE = 0
    """Uniform in the primary workspace and its wedge of approaches."""
    EDGE = 1
    """Near a face of the workspace or of the wedge, on either side."""
    SINGULAR = 2
    """Near the target of a vector that is near a double root."""
    ANYWHERE = 3


def log_distances(rng: np.random.Generator, n: int) -> Array:
    """Draw distances of either sign with a uniform logarithm, shape (n,)."""
    sizes: Array = 10.0 ** rng.uniform(np.log10(NEAREST), np.log10(FARTHEST), n)
    signs: Array = rng.choice([-1.0, 1.0], n)
    return sizes * signs


def draw_vectors(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Kinds]:
    """Draw joint vectors inside the soft limits, most of them near double roots or limits.

    Returns:
        Output angles in rad, shape (5, n), and flags of Near, shape (n,).
    """
    low, high = trial.arm.soft_min_rad[:, None], trial.arm.soft_max_rad[:, None]
    plain = rng.uniform(low, high, (5, n))
    kind = rng.choice(16, n, p=np.array([20, 1, 1, 1, 1, 1, 1, 1, 1, *[0] * 7]) / 28)
    q = plain.copy()
    for flag, joint in JOINT_OF.items():
        flagged = np.flatnonzero(kind & flag)
        q[joint, flagged] = _double_root(trial, flag, rng, q[:, flagged])
        if not trial.is_drawing:
            some = flagged[rng.random(flagged.size) < REFINED_SHARE]
            q[joint, some] = _refine_singular_angle(trial, joint, q[:, some])
        q[joint, flagged] += log_distances(rng, flagged.size)
    _put_near_limits(q, np.flatnonzero(kind & Near.LIMIT), low, high, rng)
    q = wrap_into_limits(trial.arm, q)
    inside = limit_excess(trial.arm, q).max(axis=0) <= 0  # NaN where there is no such pose
    return np.where(inside, q, plain), np.where(inside, kind, int(Near.NOTHING))


def _double_root(trial: Trial, flag: Near, rng: np.random.Generator, q: Array) -> Array:
    """Compute the angle of a joint at the double root of the nearest orthogonal arm with a radial tool."""
    n = q.shape[1]
    if flag is Near.ELBOW:
        return np.zeros(n)
    if flag is Near.WRIST:
        boresight = trial.arm.X_FT[trial.tool].R[:, 0]
        turret: Array = rng.choice([-0.5, 0.5], n) * np.pi - np.arctan2(boresight[1], boresight[0])
        return turret
    # The forward component of a point on the turret axis is A + B cos(elevation) + C sin(elevation).
    f0, f1, f2 = (_forward_component(trial, q, angle) for angle in (0.0, np.pi / 2, np.pi))
    A, B = 0.5 * (f0 + f2), 0.5 * (f0 - f2)
    C = f1 - A
    ratio = -A / np.hypot(B, C)
    ratio[np.abs(ratio) > 1] = np.nan
    elevation: Array = np.arctan2(C, B) + rng.choice([-1.0, 1.0], n) * np.arccos(ratio)
    return elevation


def _forward_component(trial: Trial, q: Array, elevation_rad: float) -> Array:
    """Compute how far the tool's foot on the turret axis is ahead of the azimuth axis, at an elevation."""
    q = q.copy()
    q[Joint.ELEVATION] = elevation_rad
    frames = forward(trial.arm, q)
    X_RT, X_FT = tool_pose(trial.arm, frames, trial.tool), trial.arm.X_FT[trial.tool]
    boresight = X_FT.R[:2, 0]
    foot = X_RT.p - (X_FT.p[:2] @ boresight) / (boresight @ boresight) * X_RT.R[:, 0]
    return dot(frames.X_RF.R[:, 0, 1], foot - frames.X_RF.p[:, 0])


def _refine_singular_angle(trial: Trial, joint: Joint, q: Array) -> Array:
    """Find the angle of a joint at which this arm is singular, by the secant method.

    Where the method fails, the angle is unchanged.
    """
    usable = np.isfinite(q).all(axis=0)
    start = q[joint].copy()
    q = q[:, usable].copy()
    first = q[joint].copy()
    before, at_before = first, _determinant(trial, q)
    now = first + SECANT_FIRST_RAD
    for _ in range(SECANT_STEPS):
        q[joint] = now
        at_now = _determinant(trial, q)
        rise = at_now - at_before
        step = np.where(rise == 0, 0.0, -at_now * (now - before) / np.where(rise == 0, 1.0, rise))
        step = np.clip(step, -SECANT_REACH_RAD, SECANT_REACH_RAD)
        before, at_before, now = now, at_now, now + step
    good = (np.abs(step) < NEAREST) & (np.abs(now - first) < SECANT_REACH_RAD)
    start[usable] = np.where(good, now, first)
    return np.asarray(start)


def _determinant(trial: Trial, q: Array) -> Array:
    J = np.moveaxis(task_jacobian(trial, q), -1, 0)
    return np.asarray(np.linalg.det(J), np.float64)


def _put_near_limits(q: Array, flagged: Kinds, low: Array, high: Array, rng: np.random.Generator) -> None:
    """Move a random joint of the flagged vectors to the inside of a soft limit, in place."""
    joint = rng.integers(5, size=flagged.size)
    inward = np.abs(log_distances(rng, flagged.size))
    upper = rng.random(flagged.size) < 0.5
    q[joint, flagged] = np.where(upper, high[joint, 0] - inward, low[joint, 0] + inward)


def draw_targets(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Array, Kinds]:
    """Draw targets in the workspace, near its faces, near double roots, and anywhere in reach.

    Returns:
        Positions [m] and unit approach vectors in the rover frame, (3, n) each, and values of Aim, (n,).
    """
    aim = rng.choice(4, n, p=[0.6, 0.15, 0.15, 0.1])
    p_m, approach = _workspace(rng, n, aim == Aim.EDGE)
    singular = aim == Aim.SINGULAR
    p_m[:, singular], approach[:, singular] = _around_double_roots(trial, rng, int(singular.sum()))
    anywhere = aim == Aim.ANYWHERE
    size = int(anywhere.sum())
    p_m[:, anywhere] = trial.arm.X_CF.p[:, :1] + REACH_M * rng.random(size) * _directions(rng, size)
    approach[:, anywhere] = _directions(rng, size)
    return p_m, approach, aim


def workspace_targets(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Draw targets uniformly in the workspace: positions [m] and unit approach vectors, (3, n) each."""
    return _workspace(rng, n, np.zeros(n, bool))


def _workspace(rng: np.random.Generator, n: int, edge: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Draw targets as `sim.frames.random_surface` does; those of `edge` near a face, on either side."""
    low = np.array([0.0, PRIMARY.top_z_m, 0.0, -PRIMARY.wedge_side_rad])[:, None]
    high = np.array([PRIMARY.radius_m, PRIMARY.bottom_z_m, np.pi / 2, PRIMARY.wedge_side_rad])[:, None]
    u = rng.random((4, n))
    u[0] = np.sqrt(u[0])
    values = low + (high - low) * u
    face, upper, off = rng.integers(4, size=n), rng.random(n) < 0.5, log_distances(rng, n)
    upper |= face == 0  # the lower bound of the radius, the axis of the cylinder, is no face
    at = np.arange(n)
    on_face = np.where(upper, high[face, 0], low[face, 0]) + off
    values[face, at] = np.where(edge, on_face, values[face, at])
    radius, z, down, side = values
    heading = rng.uniform(-np.pi, np.pi, n)
    p_N_m = np.stack([PRIMARY.centre_x_m + radius * np.cos(heading), radius * np.sin(heading), z])
    approach = np.stack([np.cos(down) * np.cos(side), np.cos(down) * np.sin(side), np.sin(down)])
    return p_N_m - P_NR_M[:, None], approach


def _around_double_roots(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Draw targets at small distances from those of vectors near double roots, in position and approach."""
    q, _ = draw_vectors(trial, rng, n)
    X_RT = trial.tool_pose(q)
    p_m = X_RT.p + log_distances(rng, n) * _directions(rng, n)
    approach = X_RT.R[:, 0] + log_distances(rng, n) * cross(X_RT.R[:, 0], _directions(rng, n))
    return p_m, approach / norm(approach)


def _directions(rng: np.random.Generator, n: int) -> Array:
    """Draw unit vectors uniformly on the sphere, shape (3, n)."""
    v = rng.normal(size=(3, n))
    return v / norm(v)
