"""Arms, targets and joint vectors to try the inverse kinematics on, and checks of its solutions.

Two roots meet at a straight elbow, at an approach parallel to the pitch axes, and where the turret axis
intersects the azimuth axis. Distances of joint vectors from there have a uniform logarithm, from 1 urad to
0.3 rad.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntFlag
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm, build_arm, build_orthogonal_arm, limit_excess, wrap_into_limits
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import fold_distances
from fsw.kinematics.ik import BranchVerdict, IkResult
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import (
    Array,
    Flags,
    Pose,
    cross,
    dot,
    norm,
    rotation_x,
    rotation_y,
    rotation_z,
    wrap_angle,
)
from sim.arms import arm_named, nominal_params
from sim.frames import approach_from, gravity_in_rover, p_R_from_N, random_targets
from sim.setting import GRAVITY_M_S2

MAX_TILT_RAD: Final = np.radians(30.0)
CALIBRATED_SEEDS: Final = 50
SKEW_SEEDS: Final = 50
RIGID_M: Final = 1e-9
"""Tolerance of a rigid arm."""
DEFLECTED_M: Final = 1e-6
"""Tolerance of an arm deflected by gravity."""
STEP_RAD: Final = 1e-4
"""Step of central differences; an equilibrium is accurate to 1e-11, so the derivative is to 1e-7."""
SAME_RAD: Final = 1e-6
"""Joint vectors closer than this are the same root."""
CLEAR_SIGMA: Final = 1e-4
"""Smallest singular value above which a pose of the orthogonal rigid arm is clear of double roots."""
CLEAR_OF_FOLDS: Final = 0.2
"""Distance from every fold [m, sine] above which a pose of any other arm is clear of double roots."""


@dataclass(frozen=True, slots=True)
class Case:
    """Kind of arm under a kind of gravity."""

    name: str
    arms: int
    """Number of draws; near singularities the nominal rigid arm is a hundred times faster than the others."""
    arm: str
    """nominal, calibrated, or skew: the nominal arm with a tool whose boresight misses the turret axis."""
    gravity: str
    """none, mars (tilted up to 30 degrees) or earth (level)."""

    @property
    def tolerance_m(self) -> float:
        """Largest error of a solution: the larger of metres and radians."""
        return RIGID_M if self.gravity == "none" else DEFLECTED_M


CASES: Final = (
    Case("nominal rigid", 12, "nominal", "none"),
    Case("nominal on Mars", 2, "nominal", "mars"),
    Case("nominal on Earth", 1, "nominal", "earth"),
    Case("calibrated rigid", 2, "calibrated", "none"),
    Case("calibrated on Mars", 2, "calibrated", "mars"),
    Case("skew tool rigid", 1, "skew", "none"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Arm with a tool under a gravity, on which a batch of targets is tried."""

    arm_name: str
    arm: Arm
    tool: str
    gravity_R_m_s2: Array | None

    def tool_pose(self, output_rad: Array) -> Pose:
        """Compute the pose X_RT of the tool at rest for output angles of shape (5, ...)."""
        if self.gravity_R_m_s2 is None:
            return tool_pose(self.arm, forward(self.arm, output_rad), self.tool)
        return tool_pose(self.arm, settle_output(self.arm, output_rad, self.gravity_R_m_s2).frames, self.tool)

    @property
    def is_exact(self) -> bool:
        """True if the closed form solves the arm: all its roots are then found."""
        return self.gravity_R_m_s2 is None and self.arm.orthogonal[self.tool].is_exact

    @property
    def is_drawing(self) -> bool:
        """True for the nominal rigid arm, which is orthogonal: its double roots have closed forms."""
        return self.gravity_R_m_s2 is None and self.arm_name == "nominal"


def trials(case: Case, rng: np.random.Generator) -> Iterator[Trial]:
    """Draw an arm and a gravity, and yield a trial for each tool; each skew tool is drawn separately."""
    gravity = _gravity(case.gravity, rng)
    seed = int(rng.integers(CALIBRATED_SEEDS))
    for tool in nominal_params().tool_names:
        name = {
            "nominal": "nominal",
            "calibrated": f"calibrated:{seed}",
            "skew": f"skew:{rng.integers(SKEW_SEEDS)}",
        }[case.arm]
        yield Trial(name, arm_of(name), tool, gravity)


@lru_cache(maxsize=256)
def arm_of(name: str) -> Arm:
    """Build the arm named nominal, calibrated:SEED, as-built:SEED or skew:SEED."""
    kind, _, seed = name.partition(":")
    return skew_tool(int(seed)) if kind == "skew" else build_arm(arm_named(name).params)


def skew_tool(seed: int, offset_m: float = 0.06, tilt_rad: float = 0.8) -> Arm:
    """Build the nominal arm with a random tool, whose boresight misses the turret axis.

    The tool is at most `offset_m` from the radial direction, and tilted by at most `tilt_rad`.
    """
    rng = np.random.default_rng(seed)
    arm = arm_of("nominal")
    clock = rotation_z(np.asarray(rng.uniform(-np.pi, np.pi)))
    lean_y, lean_x = (np.asarray(rng.uniform(-most, most)) for most in (tilt_rad, 3))
    lean = rotation_y(lean_y) @ rotation_x(lean_x)
    p_m = clock @ [rng.uniform(0.2, 0.4), rng.uniform(-offset_m, offset_m), rng.uniform(-0.15, 0.0)]
    return with_tool(arm, Pose(clock @ lean, p_m))


def with_tool(arm: Arm, X_FT: Pose) -> Arm:
    """Build an arm with this tool frame instead of its tools."""
    shape = build_orthogonal_arm(arm.theta_rad, Pose(arm.X_CF.R, arm.X_CF.p + arm.p_LC_m), X_FT)
    return replace(arm, X_FT=dict.fromkeys(arm.X_FT, X_FT), orthogonal=dict.fromkeys(arm.X_FT, shape))


def _gravity(name: str, rng: np.random.Generator) -> Array | None:
    if name == "none":
        return None
    tilt = rng.uniform(0.0, MAX_TILT_RAD) if name == "mars" else 0.0
    heading = rng.uniform(-np.pi, np.pi)
    return gravity_in_rover(tilt * np.cos(heading), tilt * np.sin(heading), GRAVITY_M_S2[name])


def claimed_roots(answers: IkResult) -> Flags:
    """Return which roots claim to meet the target, (S, ...); one far outside the limits may have no error."""
    outside = (answers.verdict == BranchVerdict.OUTSIDE_LIMITS) & np.isfinite(answers.error)
    return np.asarray((answers.verdict == BranchVerdict.VALID) | outside)


def root_errors(trial: Trial, answers: IkResult, p_m: Array, approach: Array) -> Array:
    """Compute the pose error of each claimed root: the larger of metres and radians, (S, n); else NaN.

    Targets are positions and unit approach vectors in the rover frame, (3, n) each.
    """
    roots = claimed_roots(answers)
    worst = np.full(roots.shape, np.nan)
    X_RT = trial.tool_pose(answers.output_rad[:, roots])
    which = np.nonzero(roots)[1]
    error_m, error_axis = norm(X_RT.p - p_m[:, which]), norm(X_RT.R[:, 0] - approach[:, which])
    worst[roots] = np.maximum(error_m, error_axis)
    return worst


def root_distances(answers: IkResult, q: Array) -> Array:
    """Compute the largest joint difference [rad] of each claimed root from a vector, modulo full turns.

    The vectors, (5, n), are those of the targets. The result is (S, n), and infinite for other roots.
    """
    distance = np.abs(wrap_angle(answers.output_rad - q[:, None])).max(axis=0)
    return np.where(claimed_roots(answers), distance, np.inf)


def task_jacobian(trial: Trial, q: Array) -> Array:
    """Compute the Jacobian of position and approach by central differences, with the change of deflection.

    For joint vectors, (5, n), it has derivatives of the position in m/rad, and of the approach along the
    other two tool axes, (5, 5, n).
    """
    n = q.shape[1]
    steps = STEP_RAD * np.stack([np.eye(5), -np.eye(5)], axis=-1)
    X = trial.tool_pose((q[:, None, None] + steps[..., None]).reshape(5, -1))
    parts = (one.reshape(3, 5, 2, n) for one in (X.p, X.R[:, 0]))
    p, x = ((v[:, :, 0] - v[:, :, 1]) / (2 * STEP_RAD) for v in parts)
    R_RT = trial.tool_pose(q).R
    tilts = [dot(R_RT[:, k, None], x) for k in (1, 2)]
    return np.concatenate([p, np.stack(tilts)])


def smallest_singular_value(trial: Trial, q: Array) -> Array:
    """Compute the smallest singular value of the task Jacobian, shape (n,); it is 0 where two roots meet."""
    J = np.moveaxis(task_jacobian(trial, q), -1, 0)
    return np.asarray(np.linalg.svd(J, compute_uv=False)[:, -1], np.float64)


def find_regular(trial: Trial, q: Array) -> Flags:
    """Find the joint vectors, shape (n,), that must be among the solutions of their own targets."""
    regular: Flags = smallest_singular_value(trial, q) > CLEAR_SIGMA
    if not trial.is_exact:
        regular &= np.abs(fold_distances(trial.arm.orthogonal[trial.tool], q)).min(axis=0) > CLEAR_OF_FOLDS
    return regular


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


def log_distances(rng: np.random.Generator, n: int) -> Array:
    """Draw distances of either sign with a uniform logarithm, shape (n,)."""
    sizes: Array = 10.0 ** rng.uniform(np.log10(NEAREST), np.log10(FARTHEST), n)
    signs: Array = rng.choice([-1.0, 1.0], n)
    return sizes * signs


def draw_vectors(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Kinds]:
    """Draw joint vectors inside the soft limits, most of them near double roots or limits.

    They are output angles, (5, n) [rad], with flags of Near, (n,).
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
    """Find the angle of a joint at which this arm is singular, by secants; unchanged where they fail."""
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


def draw_targets(trial: Trial, rng: np.random.Generator, n: int) -> tuple[Array, Array, Flags]:
    """Draw targets in the workspace, near double roots, and anywhere in reach.

    Return positions [m] and unit approach vectors in the rover frame, (3, n) each, and flags of the first.
    """
    p_N_m, angles_rad = random_targets(rng, n)
    p_m, approach = p_R_from_N(p_N_m.T).T, approach_from(angles_rad)
    drawn = rng.random(n)
    singular, anywhere = drawn < 0.15, drawn > 0.9
    p_m[:, singular], approach[:, singular] = _around_double_roots(trial, rng, int(singular.sum()))
    size = int(anywhere.sum())
    p_m[:, anywhere] = trial.arm.X_CF.p[:, :1] + REACH_M * rng.random(size) * _directions(rng, size)
    approach[:, anywhere] = _directions(rng, size)
    return p_m, approach, ~(singular | anywhere)


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
