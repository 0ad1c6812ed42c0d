"""Arms, tools and gravities of the kinematics campaign, and checks of solutions by forward kinematics."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from fsw.kinematics.arm import Arm, build_arm, build_orthogonal_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import fold_distances
from fsw.kinematics.ik import BranchVerdict, IkResult
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import (
    Array,
    Flags,
    Pose,
    dot,
    norm,
    rotation_x,
    rotation_y,
    rotation_z,
    wrap_angle,
)
from sim.arms import arm_named
from sim.frames import gravity_in_rover
from sim.params import nominal_params
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
    chunks: int
    """Number of chunks of this case in a round; near singularities the nominal rigid arm is a hundred times
    faster than the others."""
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
        """Compute the pose X_RT of the tool for output angles of shape (5, ...).

        The arm is in static equilibrium under the gravity, or rigid if there is none.
        """
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
    X_FT = Pose(clock @ lean, p_m)
    shape = build_orthogonal_arm(arm.theta_rad, Pose(arm.X_CF.R, arm.X_CF.p + arm.p_LC_m), X_FT)
    return replace(arm, X_FT=dict.fromkeys(arm.X_FT, X_FT), orthogonal=dict.fromkeys(arm.X_FT, shape))


def _gravity(name: str, rng: np.random.Generator) -> Array | None:
    if name == "none":
        return None
    tilt = rng.uniform(0.0, MAX_TILT_RAD) if name == "mars" else 0.0
    heading = rng.uniform(-np.pi, np.pi)
    return gravity_in_rover(tilt * np.cos(heading), tilt * np.sin(heading), GRAVITY_M_S2[name])


def claimed_roots(answers: IkResult) -> Flags:
    """Return which roots claim to meet the target, shape (S, ...).

    If an arm is deflected or not orthogonal, a root far outside the limits has no angles and no error.
    """
    has_angles = (answers.verdict == BranchVerdict.VALID) | (answers.verdict == BranchVerdict.OUTSIDE_LIMITS)
    claimed: Flags = has_angles & ((answers.verdict == BranchVerdict.VALID) | np.isfinite(answers.error))
    return claimed


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
    p, x = (
        (v[:, :, 0] - v[:, :, 1]) / (2 * STEP_RAD)
        for v in (one.reshape(3, 5, 2, n) for one in (X.p, X.R[:, 0]))
    )
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
