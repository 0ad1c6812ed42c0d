"""Error sources of a tool as data, and cases that combine them (paper, Tables 2 and 4).

Their propagation to the tool: sensitivity of the deflected arm, and rules that combine errors. An error stays
within plus or minus its magnitude; its distribution describes it there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
from pydantic import TypeAdapter
from scipy.optimize import brentq
from scipy.stats import chi2

from fsw.config import Config
from fsw.dictionary.enums import Frame
from fsw.dictionary.types import Vector3
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import frame_jacobian, tool_pose
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Flags, Pose, adjoint, rotate
from sim.frames import approach_from, p_R_from_N, random_targets
from simgap.common.files import file_sha256
from simgap.common.toml import read_toml

SOURCES_FILE: Final = Path(str(resources.files("marsarm.accuracy") / "sources.toml"))
Distribution = Literal["normal", "uniform", "either side"]

CUMULANTS: Final[dict[Distribution, tuple[float, float, float]]] = {
    "normal": (1 / 9, 0.0, 0.0),
    "uniform": (1 / 3, -2 / 15, 16 / 63),
    "either side": (1.0, -2.0, 16.0),
}
"""Second, fourth and sixth cumulants for magnitude 1.

The magnitude is three sigma (normal), the half width (uniform), or one of two values (either side).
"""

EffectName = Literal[
    "frame error", "frame play", "servo error", "windup", "hardstop angle", "backlash", "stiffness", "warming"
]

FrameName = Literal["arm1", "arm2", "arm3", "arm4", "arm5", "arm6", "tool"]
FRAME_NAMES: Final[tuple[FrameName, ...]] = get_args(FrameName)


@dataclass(frozen=True, slots=True)
class FrameMagnitude:
    """Magnitude of an error of some frames, in their own axes."""

    frames: tuple[FrameName, ...]
    rotation_mrad: Vector3 = (0.0, 0.0, 0.0)
    translation_mm: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ErrorSource:
    """Error source with its magnitude and distribution."""

    kind: Literal["systematic", "random"]
    text: str
    label: Literal["S", "I", "A"]
    """Origin of the magnitude: a public document (S), inferred (I), assumed (A)."""
    basis: str
    distribution: Distribution
    effect: EffectName
    """Kind of effect in the plant."""
    at_limit: bool = False
    """True if the error may be at the end of its range, so that it is added (paper equation 13)."""
    relative_to: Literal["frames", "load", "temperature"] = "frames"
    """Reference of the magnitude: none, the deflection under load, or the expansion by warming."""
    at: tuple[FrameMagnitude, ...] = ()
    frames: tuple[FrameName, ...] = FRAME_NAMES
    """Frames of an error relative to load or temperature."""
    share: float = 0.0
    warming_K: float = 0.0

    @property
    def share_by_frame(self) -> Array:
        """Compute the share at each frame, shape (7,); zero at other frames than those of the source."""
        return self.share * np.array([frame.name.lower() in self.frames for frame in Frame])

    @property
    def theta(self) -> Array:
        """Compute the magnitudes at the frames, rotations [rad] above translations [m], shape (6, 7).

        They are zero for a source relative to load or temperature.
        """
        theta = np.zeros((6, len(Frame)))
        for magnitude in self.at:
            for name in magnitude.frames:
                theta[:3, Frame[name.upper()]] += np.array(magnitude.rotation_mrad) * 1e-3
                theta[3:, Frame[name.upper()]] += np.array(magnitude.translation_mm) * 1e-3
        return theta


@dataclass(frozen=True, slots=True)
class BudgetCase:
    """Sources of a case, with factors of their magnitudes."""

    text: str
    sources: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """All error sources and all cases."""

    source: Mapping[str, ErrorSource]
    case: Mapping[str, BudgetCase]


def is_compensated(backlash: float) -> bool:
    """Return whether flight software compensates backlash, given the factor of the source."""
    return backlash < 1


@cache
def load_error_model() -> ErrorModel:
    """Load the error sources and cases of the project, once in a process."""
    model: ErrorModel = TypeAdapter(ErrorModel).validate_python(read_toml(SOURCES_FILE))
    return model


def sources_sha256() -> str:
    """Compute the SHA-256 of the file of error sources and cases."""
    return file_sha256(SOURCES_FILE)


BRANCHES_A_TARGET: Final = 3
"""Assumed number of valid branches of a target; below the mean, so that one draw usually suffices."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Joint angles that bring a tool to targets of the workspace."""

    tool: str
    output_rad: Array
    """Joint angles of the deflected arm, shape (5, n)."""
    p_NoTo_N_m: Array
    """Positions of the tool in RNAV, shape (3, n)."""


def workspace_poses(arm: Arm, tool: str, gravity_R_m_s2: Array, count: int, seed: int) -> Poses:
    """Draw poses of a tool over the workspace; the result depends only on the arguments."""
    rng = np.random.default_rng([seed, list(arm.X_FT).index(tool)])
    outputs, targets = np.zeros((5, 0)), np.zeros((3, 0))
    while outputs.shape[1] < count:
        p_N_m, angles = random_targets(rng, -(-count // BRANCHES_A_TARGET))
        results = inverse_kinematics(arm, tool, p_R_from_N(p_N_m.T).T, approach_from(angles), gravity_R_m_s2)
        valid = results.verdict.T == BranchVerdict.VALID  # target by target, then branch by branch
        found = np.moveaxis(results.output_rad, 1, -1)[:, valid]
        outputs = np.concatenate([outputs, found], axis=1)
        targets = np.concatenate([targets, p_N_m[:, np.nonzero(valid)[0]]], axis=1)
    return Poses(tool, outputs[:, :count], targets[:, :count])


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Derivatives of the tool pose at each pose, in tool axes."""

    J: Array
    """Derivatives by a small screw of each frame in its own axes, shape (6, 6, 7, n)."""
    deflection: Array
    """Tool motion by the full load deflection of each link with its gear, shape (6, 7, n)."""
    expansion_1_K: Array
    """Tool motion by thermal expansion of each link per kelvin, shape (6, 7, n)."""
    side: Array
    """Side of the backlash where load holds each output, +1 or -1; 0 if friction may hold it; (5, n)."""

    def errors(self, source: ErrorSource) -> Array:
        """Compute the signed independent errors of a source at its magnitude, shape (6, k, n)."""
        match source.relative_to:
            case "frames":
                theta = source.theta
                where = np.nonzero(theta)
                return self.J[:, where[0], where[1]] * theta[where][:, None]
            case "load":
                return source.share_by_frame[:, None] * self.deflection
            case "temperature":
                return source.share_by_frame[:, None] * source.warming_K * self.expansion_1_K

    def errors_by_frame(self, source: ErrorSource) -> Array:
        """Compute the absolute errors |J| theta of a source at each frame, shape (6, 7, n)."""
        if source.relative_to == "frames":
            return np.asarray(np.einsum("ikjn,kj->ijn", np.abs(self.J), source.theta))
        return np.abs(self.errors(source))


def compute_sensitivity(config: Config, poses: Poses, gravity_R_m_s2: Array) -> Sensitivity:
    """Compute the sensitivity of the tool of the deflected arm."""
    arm = config.arm
    deflected = settle_output(arm, poses.output_rad, gravity_R_m_s2)
    X_RT = tool_pose(arm, deflected.frames, poses.tool)
    J = frame_jacobian(deflected.frames, X_RT)
    expansion = np.concatenate(
        [arm.expansion_F, arm.expansion_T[:, [list(arm.X_FT).index(poses.tool)]]], axis=1
    )
    growth = np.einsum("ikjn,kj->ijn", J, expansion)
    deflection = np.zeros((6, len(Frame), poses.output_rad.shape[1]))
    X_RL = deflected.frames.X_RL
    spring = rotate(X_RL.R, deflected.frames.X_LD.p) + X_RL.p - X_RT.p[:, None]  # of each link, from the tool
    deflection[:, :-1] = np.einsum("ikjn,kjn->ijn", adjoint(Pose(X_RL.R, spring)), deflected.strain)
    # the joint of link j + 1 rotates about the z axis of frame j
    deflection[:, :5] += J[:, 2, :5] * (deflected.torque_Nm / arm.gear_stiffness_Nm_rad[:, None])
    turn = X_RT.R.swapaxes(0, 1)
    held = np.abs(deflected.torque_Nm) > config.output_friction_Nm[:, None]
    return Sensitivity(
        _rotate_screws(turn[:, :, None, None], J),
        _rotate_screws(turn[:, :, None], deflection),
        _rotate_screws(turn[:, :, None], growth),
        np.sign(deflected.torque_Nm) * held,
    )


def _rotate_screws(R: Array, screw: Array) -> Array:
    """Rotate screws (6, ...) into other axes."""
    return np.concatenate([rotate(R, screw[:3]), rotate(R, screw[3:])])


MIN_SKEWNESS: Final = 0.05
"""Smallest skewness; below it, the distribution counts as symmetric."""
MAX_SKEWNESS: Final = np.sqrt(8.0)
"""Skewness of the square of one normal variable, the largest of a sum of such squares."""
TOTAL, LATERAL, NORMAL, AXIAL = [3, 4, 5], [4, 5], [3], [1, 2]
"""Components of a screw in tool axes that make up each error.

Total, lateral and normal are errors of position; axial is the error of the approach direction.
"""
COVERAGE: Final = 0.9973
"""Three sigma of a normal error; also the share of poses whose bound is within the reported value."""
PARTS: Final = {"total_m": TOTAL, "lateral_m": LATERAL, "normal_m": NORMAL, "axial_rad": AXIAL}
Bounds = Mapping[str, Array]
"""Bounds of the tool errors at each pose, shape (n,), by the names of PARTS."""


@dataclass(frozen=True, slots=True, eq=False)
class SquaredLength:
    """First three cumulants of the squared length of an error at each pose, shape (n,) each."""

    mean: Array
    variance: Array
    third: Array

    @property
    def _degrees_of_freedom(self) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            skewness = np.where(self.variance > 0, self.third / self.variance**1.5, MAX_SKEWNESS)
        return np.asarray(8 / np.clip(skewness, MIN_SKEWNESS, MAX_SKEWNESS) ** 2)

    def quantile(self, coverage: float) -> Array:
        """Compute the error lengths, (n,), that are not exceeded with this probability.

        A shifted and scaled chi-square distribution matches the three cumulants.
        """
        degrees_of_freedom = self._degrees_of_freedom
        normed = (chi2.ppf(coverage, degrees_of_freedom) - degrees_of_freedom) / np.sqrt(
            2 * degrees_of_freedom
        )
        return np.asarray(np.sqrt(np.maximum(self.mean + normed * np.sqrt(self.variance), 0.0)))

    def probability_within(self, length: float) -> Array:
        """Compute the probability, shape (n,), that the error is not longer than this."""
        degrees_of_freedom, sigma = self._degrees_of_freedom, np.sqrt(self.variance)
        excess = length**2 - self.mean
        normed = np.divide(excess, sigma, out=np.where(excess < 0, -np.inf, np.inf), where=sigma > 0)
        return np.asarray(
            chi2.cdf(degrees_of_freedom + np.sqrt(2 * degrees_of_freedom) * normed, degrees_of_freedom)
        )


def squared_length(errors: Sequence[tuple[Array, Distribution]], known: Array | None = None) -> SquaredLength:
    """Compute cumulants of squared lengths of independent errors, (m, k, n), with a known one, (m, n)."""
    m, _, n = errors[0][0].shape
    c = np.zeros((m, n)) if known is None else known
    S = np.zeros((m, m, n))
    for u, distribution in errors:
        S += CUMULANTS[distribution][0] * np.einsum("ikn,jkn->ijn", u, u)
    S2 = np.einsum("ijn,jkn->ikn", S, S)
    mean = np.einsum("iin->n", S) + np.einsum("in,in->n", c, c)
    variance = 2 * np.einsum("iin->n", S2) + 4 * np.einsum("in,ijn,jn->n", c, S, c)
    third = 8 * np.einsum("ijn,jin->n", S2, S) + 24 * np.einsum("in,ijn,jn->n", c, S2, c)
    for u, distribution in errors:
        _, k4, k6 = CUMULANTS[distribution]
        if k4:
            square = np.einsum("ikn,ikn->kn", u, u)
            variance += k4 * np.einsum("kn,kn->n", square, square)
            along = np.einsum("ikn,ijn,jkn->kn", u, S, u) + np.einsum("in,ikn->kn", c, u) ** 2
            third += 12 * k4 * np.einsum("kn,kn->n", square, along) + k6 * (square**3).sum(axis=0)
    return SquaredLength(mean, np.maximum(variance, 0.0), third)


def pooled_quantile(lengths: Sequence[SquaredLength], coverage: float) -> float:
    """Compute the error length that this share of the errors at all poses does not exceed."""
    most = max(float(length.quantile(coverage).max()) for length in lengths)
    if most == 0:
        return 0.0

    def beyond(length: float) -> float:
        return coverage - float(np.concatenate([one.probability_within(length) for one in lengths]).mean())

    return float(brentq(beyond, 0.0, 2 * most, xtol=1e-9))


def bounds(u: Array) -> Bounds:
    """Compute the bounds from components, (6, n) [rad, m]."""
    return {name: np.linalg.norm(u[part], axis=0) for name, part in PARTS.items()}


def worst_case(u: Array) -> Array:
    """Add all errors (sources, 6, 7, n) to components (6, n) [rad, m]: paper equation 10."""
    return np.asarray(u.sum(axis=(0, 2)))


def root_sum_square(u: Array) -> Array:
    """Combine all errors (sources, 6, 7, n) as independent, to components (6, n): paper equation 11."""
    return np.asarray(np.sqrt((u**2).sum(axis=(0, 2))))


def paper_rule(u: Array, at_limit: Flags) -> Array:
    """Combine errors (sources, 6, 7, n) by the paper's rule, to components (6, n): equations 12 and 13.

    Frames of a source are added. Sources at their limits are added, the others combined as root sum square.
    This follows the text of the paper: its printed root covers the added sources too.
    """
    source = u.sum(axis=2)
    return np.asarray(source[at_limit].sum(axis=0) + np.sqrt((source[~at_limit] ** 2).sum(axis=0)))


def shares(u: Array, at_limit: Flags) -> Array:
    """Divide the total error by the paper's rule among sources and frames, to shares [m], (sources, 7, n).

    An added source has the weight one; a source under the root has its own value over the root. A component
    has the weight of its value over the length of the error. So the shares add up to the total.
    """
    source = u.sum(axis=2)
    root = np.sqrt((source[~at_limit] ** 2).sum(axis=0))
    weight = np.ones_like(source)
    weight[~at_limit] = _divide(source[~at_limit], root)
    total = paper_rule(u, at_limit)[TOTAL]
    along = _divide(total, np.linalg.norm(total, axis=0))
    return np.asarray(np.einsum("cn,sc...n,scn->s...n", along, u[:, TOTAL], weight[:, TOTAL]))


def moments_rule(lengths: Mapping[str, SquaredLength], worst: Bounds, coverage: float) -> Bounds:
    """Compute the bounds that hold with this probability, at most the worst case; lengths are as PARTS."""
    return {name: np.minimum(length.quantile(coverage), worst[name]) for name, length in lengths.items()}


def _divide(a: Array, b: Array) -> Array:
    """Compute a / b, and 0 where b is 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0)
