"""What an answer of the inverse kinematics is held to, computed anew from forward kinematics alone."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.kinematics.arm import Arm, build_arm, build_orthogonal_arm
from fsw.kinematics.chain import forward, tool_pose
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
from sim.world import GRAVITY_M_S2

MAX_TILT_RAD: Final = np.radians(30.0)
CALIBRATED_SEEDS: Final = 50
SKEW_SEEDS: Final = 50
RIGID_M: Final = 1e-9
DEFLECTED_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of arm under a kind of gravity."""

    name: str
    chunks: int
    """Of each round of chunks, how many are this case: close to singularities the rigid arm
    of the drawing is a hundred times cheaper than the others."""
    arm: str
    """nominal, calibrated or skew: the drawing with a tool whose boresight misses the turret axis."""
    gravity: str
    """none, mars (tilted up to 30 degrees) or earth (level)."""

    @property
    def tolerance_m(self) -> float:
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
    """One arm with one tool under one gravity: what a batch of targets is tried on."""

    arm_name: str
    arm: Arm
    tool: Tool
    gravity_R_m_s2: Array | None

    def tool_pose(self, output_rad: Array) -> Pose:
        """X_RT of the tool for output angles (5, ...): of the arm at rest under this gravity, or rigid."""
        if self.gravity_R_m_s2 is None:
            return tool_pose(self.arm, forward(self.arm, output_rad), self.tool)
        return tool_pose(self.arm, settle_output(self.arm, output_rad, self.gravity_R_m_s2).frames, self.tool)

    @property
    def is_drawing(self) -> bool:
        """Rigid and square with a radial tool: its double roots are where the drawing shows them."""
        return self.gravity_R_m_s2 is None and self.arm_name == "nominal"


def trials(case: Case, rng: np.random.Generator) -> Iterator[Trial]:
    """One for each tool, all of one arm under one gravity; but every skew tool is another one."""
    gravity = _gravity(case.gravity, rng)
    seed = int(rng.integers(CALIBRATED_SEEDS))
    for tool in Tool:
        name = {
            "nominal": "nominal",
            "calibrated": f"calibrated:{seed}",
            "skew": f"skew:{rng.integers(SKEW_SEEDS)}",
        }[case.arm]
        yield Trial(name, arm_of(name), tool, gravity)


@lru_cache(maxsize=256)
def arm_of(name: str) -> Arm:
    """nominal, calibrated:SEED, as-built:SEED or skew:SEED."""
    kind, _, seed = name.partition(":")
    return skew_tool(int(seed)) if kind == "skew" else build_arm(arm_named(name).params)


def skew_tool(seed: int, offset_m: float = 0.06, tilt_rad: float = 0.8) -> Arm:
    """The drawing with one tool that passes the turret axis at up to so much and leans up to so much."""
    rng = np.random.default_rng(seed)
    arm = arm_of("nominal")
    clock = rotation_z(rng.uniform(-np.pi, np.pi))
    lean = rotation_y(rng.uniform(-tilt_rad, tilt_rad)) @ rotation_x(rng.uniform(-3, 3))
    p_m = clock @ [rng.uniform(0.2, 0.4), rng.uniform(-offset_m, offset_m), rng.uniform(-0.15, 0.0)]
    X_FT = Pose(clock @ lean, p_m)
    shape = build_orthogonal_arm(arm.theta_rad, Pose(arm.X_CF.R, arm.X_CF.p + arm.p_LC_m), X_FT)
    return replace(arm, X_FT=(X_FT,) * len(Tool), orthogonal=(shape,) * len(Tool))


def _gravity(name: str, rng: np.random.Generator) -> Array | None:
    if name == "none":
        return None
    tilt = rng.uniform(0.0, MAX_TILT_RAD) if name == "mars" else 0.0
    heading = rng.uniform(-np.pi, np.pi)
    return gravity_in_rover(tilt * np.cos(heading), tilt * np.sin(heading), GRAVITY_M_S2[name])


STEP_RAD: Final = 1e-4
"""Of the central differences; `rest` is good to 1e-11, so the derivative is to 1e-7."""
SAME_RAD: Final = 1e-6
CLEAR_SIGMA: Final = 1e-4
"""A pose with a larger smallest singular value must be among the answers to its own target."""


def claimed_roots(answers: IkResult) -> Flags:
    """Roots (S, ...) that are said to meet the target.

    Where an arm hangs or is not square, a root far outside the limits has no angles and no error.
    """
    has_angles = (answers.verdict == BranchVerdict.VALID) | (answers.verdict == BranchVerdict.OUTSIDE_LIMITS)
    return has_angles & ((answers.verdict == BranchVerdict.VALID) | np.isfinite(answers.error))


def root_errors(trial: Trial, answers: IkResult, p_m: Array, approach: Array) -> Array:
    """(S, n): how far each claimed root leaves the tool, the larger of metres and radians; else NaN."""
    roots = claimed_roots(answers)
    worst = np.full(roots.shape, np.nan)
    X_RT = trial.tool_pose(answers.output_rad[:, roots])
    which = np.nonzero(roots)[1]
    off_m, off_axis = norm(X_RT.p - p_m[:, which]), norm(X_RT.R[:, 0] - approach[:, which])
    worst[roots] = np.maximum(off_m, off_axis)
    return worst


def root_distances(answers: IkResult, q: Array) -> Array:
    """(S, n): from each claimed root to the vector of its target, whole turns apart; else infinite."""
    distance = np.abs(wrap_angle(answers.output_rad - q[:, None])).max(axis=0)
    return np.where(claimed_roots(answers), distance, np.inf)


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
