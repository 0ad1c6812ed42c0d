"""Where the kinematics campaign aims: everywhere, and more often close to where an inverse goes wrong.

Two roots meet where the elbow is straight, where the approach is parallel to the pitch axes and where the
turret axis passes right over or under the azimuth axis. Joint vectors come at distances from there that are
uniform in their logarithm, from a microradian to a third of a radian; so do targets around the reach and the
edges of the workspace.
"""

from enum import IntFlag
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.soft_limits import limit_excess, wrap_into_limits
from fsw.kinematics.transforms import Array, cross, dot, norm
from sim.frames import P_NR_M
from sim.workspace import BOTTOM_Z_M, CENTRE_X_M, RADIUS_M, TOP_Z_M, WEDGE_SIDE_RAD
from validation.kinematics_trials import Trial, task_jacobian

NEAREST: Final = 1e-6
FARTHEST: Final = 0.3
REFINED_SHARE: Final = 0.3
"""Of the vectors near a double root, how many are measured from that of the real, hanging arm."""
SECANT_STEPS: Final = 5
SECANT_FIRST_RAD: Final = 1e-3
SECANT_REACH_RAD: Final = 0.1
REACH_M: Final = 2.5

Kinds = NDArray[np.int64]


class Near(IntFlag):
    """What a joint vector is near; several at once are a crossing of double roots."""

    NOTHING = 0
    ELBOW = 1
    """Straight."""
    WRIST = 2
    """The approach parallel to the pitch axes."""
    SHOULDER = 4
    """The turret axis over or under the azimuth axis."""
    LIMIT = 8


JOINT_OF: Final = {Near.ELBOW: Joint.ELBOW, Near.WRIST: Joint.TURRET, Near.SHOULDER: Joint.ELEVATION}
"""The joint that is moved to come near; the shoulder last, for it depends on the elbow."""


class Aim(IntFlag):
    """How a target was drawn."""

    WORKSPACE = 0
    """Uniform in the primary workspace and its wedge of approaches."""
    EDGE = 1
    """Near a face of the workspace or of the wedge, on either side."""
    SINGULAR = 2
    """Near the target of a vector that is near a double root."""
    ANYWHERE = 3


def near_name(kind: int) -> str:
    """For instance `elbow+wrist`."""
    return "+".join(str(flag.name).lower() for flag in Near(int(kind))) or "nothing"


def log_distances(rng: np.random.Generator, n: int) -> Array:
    """Either sign, logarithm uniform."""
    sizes: Array = 10.0 ** rng.uniform(np.log10(NEAREST), np.log10(FARTHEST), n)
    return sizes * rng.choice([-1.0, 1.0], n)


def vectors(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Kinds]:
    """Joint vectors (5, n) inside the soft limits, and what each is near."""
    low, high = trial.arm.soft_min_rad[:, None], trial.arm.soft_max_rad[:, None]
    plain = rng.uniform(low, high, (5, n))
    kind = rng.choice(16, n, p=np.array([20, 1, 1, 1, 1, 1, 1, 1, 1, *[0] * 7]) / 28)
    q = plain.copy()
    for flag, joint in JOINT_OF.items():
        there = np.flatnonzero(kind & flag)
        q[joint, there] = _double_root(trial, flag, rng, q[:, there])
        if not trial.is_drawing:
            some = there[rng.random(there.size) < REFINED_SHARE]
            q[joint, some] = _refine_singular_angle(trial, joint, q[:, some])
        q[joint, there] += log_distances(rng, there.size)
    _put_near_limits(q, np.flatnonzero(kind & Near.LIMIT), low, high, rng)
    q = wrap_into_limits(trial.arm, q)
    inside = limit_excess(trial.arm, q).max(axis=0) <= 0  # NaN where there is no such pose
    return np.where(inside, q, plain), np.where(inside, kind, int(Near.NOTHING))


def _double_root(trial: Trial, flag: Near, rng: np.random.Generator, q: Array) -> Array:
    """The angle of the flag's joint at the double root of the nearest square arm with a radial tool."""
    n = q.shape[1]
    if flag is Near.ELBOW:
        return np.zeros(n)
    if flag is Near.WRIST:
        boresight = trial.arm.X_FT[trial.tool].R[:, 0]
        square: Array = rng.choice([-0.5, 0.5], n) * np.pi - np.arctan2(boresight[1], boresight[0])
        return square
    # the forward component of a point of the turret axis is A + B cos + C sin of the elevation
    f0, f1, f2 = (_forward_component(trial, q, angle) for angle in (0.0, np.pi / 2, np.pi))
    A, B = 0.5 * (f0 + f2), 0.5 * (f0 - f2)
    C = f1 - A
    ratio = -A / np.hypot(B, C)
    ratio[np.abs(ratio) > 1] = np.nan
    elevation: Array = np.arctan2(C, B) + rng.choice([-1.0, 1.0], n) * np.arccos(ratio)
    return elevation


def _forward_component(trial: Trial, q: Array, elevation_rad: float) -> Array:
    """How far ahead of the azimuth axis the tool's foot on the turret axis is, at another elevation."""
    q = q.copy()
    q[Joint.ELEVATION] = elevation_rad
    frames = forward(trial.arm, q)
    X_RT, X_FT = tool_pose(trial.arm, frames, trial.tool), trial.arm.X_FT[trial.tool]
    boresight = X_FT.R[:2, 0]
    foot = X_RT.p - (X_FT.p[:2] @ boresight) / (boresight @ boresight) * X_RT.R[:, 0]
    return dot(frames.X_RF.R[:, 0, 1], foot - frames.X_RF.p[:, 0])


def _refine_singular_angle(trial: Trial, joint: Joint, q: Array) -> Array:
    """The joint's angle where this very arm is singular, by secant steps; where they fail, as it was."""
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
    return start


def _determinant(trial: Trial, q: Array) -> Array:
    J = np.moveaxis(task_jacobian(trial, q), -1, 0)
    return np.asarray(np.linalg.det(J), np.float64)


def _put_near_limits(q: Array, there: Kinds, low: Array, high: Array, rng: np.random.Generator) -> None:
    joint = rng.integers(5, size=there.size)
    inward = np.abs(log_distances(rng, there.size))
    upper = rng.random(there.size) < 0.5
    q[joint, there] = np.where(upper, high[joint, 0] - inward, low[joint, 0] + inward)


def targets(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Array, Kinds]:
    """Positions (3, n) and unit approaches (3, n) in the rover frame, and how each was drawn."""
    aim = rng.choice(4, n, p=[0.6, 0.15, 0.15, 0.1])
    p_m, approach = _workspace(rng, n, aim == Aim.EDGE)
    there = aim == Aim.SINGULAR
    p_m[:, there], approach[:, there] = _around_double_roots(trial, rng, int(there.sum()))
    there = aim == Aim.ANYWHERE
    size = int(there.sum())
    p_m[:, there] = trial.arm.X_CF.p[:, :1] + REACH_M * rng.random(size) * _directions(rng, size)
    approach[:, there] = _directions(rng, size)
    return p_m, approach, aim


def workspace_targets(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Positions and approaches (3, n), uniform in the primary workspace, in the rover frame."""
    return _workspace(rng, n, np.zeros(n, bool))


def _workspace(rng: np.random.Generator, n: int, edge: NDArray[np.bool_]) -> tuple[Array, Array]:
    """As sim.workspace.random_surface; those on the edge near one of the faces, some of them outside."""
    low = np.array([0.0, TOP_Z_M, 0.0, -WEDGE_SIDE_RAD])[:, None]
    high = np.array([RADIUS_M, BOTTOM_Z_M, np.pi / 2, WEDGE_SIDE_RAD])[:, None]
    u = rng.random((4, n))
    u[0] = np.sqrt(u[0])
    values = low + (high - low) * u
    face, upper, off = rng.integers(4, size=n), rng.random(n) < 0.5, log_distances(rng, n)
    upper |= face == 0  # the axis of the cylinder is no face
    at = np.arange(n)
    on_face = np.where(upper, high[face, 0], low[face, 0]) + off
    values[face, at] = np.where(edge, on_face, values[face, at])
    radius, z, down, side = values
    heading = rng.uniform(-np.pi, np.pi, n)
    p_N_m = np.stack([CENTRE_X_M + radius * np.cos(heading), radius * np.sin(heading), z])
    approach = np.stack([np.cos(down) * np.cos(side), np.cos(down) * np.sin(side), np.sin(down)])
    return p_N_m - P_NR_M[:, None], approach


def _around_double_roots(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Small steps away from the targets of vectors near double roots, in position and approach."""
    q, _ = vectors(trial, rng, n)
    X_RT = trial.tool_pose(q)
    p_m = X_RT.p + log_distances(rng, n) * _directions(rng, n)
    approach = X_RT.R[:, 0] + log_distances(rng, n) * cross(X_RT.R[:, 0], _directions(rng, n))
    return p_m, approach / norm(approach)


def _directions(rng: np.random.Generator, n: int) -> Array:
    v = rng.normal(size=(3, n))
    return v / norm(v)
