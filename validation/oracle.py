"""Oracle for the inverse kinematics of the nominal rigid arm: EAIK 1.2, which uses another method.

A target here is a position and an approach; the rotation about the approach is free and differs between
roots. EAIK needs full poses. It is called once for each distinct pose of our roots, and all its roots are
compared with ours. Its chain is from azimuth joint to turret interface, so the tool is removed first.
"""

from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from fsw.kinematics.chain import forward
from fsw.kinematics.ik import inverse_kinematics
from fsw.kinematics.transforms import Array, wrap_angle
from sim.params import nominal_params
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document
from validation.kinematics_samples import workspace_targets
from validation.kinematics_trials import Trial, arm_of, claimed_roots, smallest_singular_value

SAME_POSE: Final = 1e-9
"""Poses with matrix elements closer than this are equal."""
SAME_RAD: Final = 1e-6
"""Roots with joint angles closer than this are equal."""
MEETS: Final = 1e-9
"""A root whose matrix elements are closer to the pose than this solves it."""
EXAMPLES: Final = 20
"""Largest number of differences that are listed."""
KINDS: Final = ("workspace", "vectors")


class Eaik:
    """EAIK model of the nominal arm without a tool.

    Raises:
        ImportError: EAIK is not installed.
    """

    def __init__(self) -> None:
        from eaik.IK_DH import DhRobot  # of the dependencies it needs only numpy

        joints = [link.transform for link in nominal_params().links.in_order()[1:]]
        if any(link.theta_rad or link.beta_rad or link.b_m for link in joints):
            raise ValueError("the drawing is no longer in standard Denavit-Hartenberg form")
        self.robot = DhRobot(
            *(np.array([getattr(j, name) for j in joints]) for name in ("alpha_rad", "a_m", "d_m"))
        )

    @property
    def family(self) -> str:
        """Kinematic family that EAIK assigns to the arm."""
        return str(self.robot.getKinematicFamily())

    def roots(self, X_1F: Array) -> Array:
        """Find the roots [rad], (5, k), of a pose of the turret interface in the Arm1 frame, (4, 4).

        EAIK marks approximate solutions as least squares. If two azimuths nearly coincide, it also marks
        roots with errors of only 1e-12. Its own forward kinematics identifies these.
        """
        solution = self.robot.IK(X_1F)
        marked = zip(solution.Q, solution.is_LS, strict=True)
        exact = [q for q, least_squares in marked if not least_squares or self._error(q, X_1F) < MEETS]
        return np.array(exact).reshape(-1, 5).T

    def _error(self, q: Array, X_1F: Array) -> float:
        return float(np.abs(self.robot.fwdKin(q) - X_1F).max())


def interface_poses(trial: Trial, output_rad: Array) -> Array:
    """Compute homogeneous transforms of the turret interface in Arm1, (n, 4, 4), at output angles, (5, n)."""
    ends = forward(trial.arm, output_rad).X_RF
    R_R1, p_R1 = ends.R[:, :, 0, 0], ends.p[:, 0, 0]
    X = np.zeros((output_rad.shape[1], 4, 4))
    X[:, :3, :3] = np.einsum("ji,jkn->nik", R_R1, ends.R[:, :, 5])
    X[:, :3, 3] = (R_R1.T @ (ends.p[:, 5] - p_R1[:, None])).T
    X[:, 3, 3] = 1.0
    return X


def distinct_poses(poses: Array) -> list[int]:
    """Return the index of the first of each set of equal poses of shape (n, 4, 4)."""
    flat = poses.reshape(len(poses), -1)
    chosen: list[int] = []
    for k in range(len(flat)):
        if all(np.abs(flat[k] - flat[j]).max() > SAME_POSE for j in chosen):
            chosen.append(k)
    return chosen


@dataclass(slots=True)
class Comparison:
    """Counts of roots found here and by the oracle, summed over targets."""

    targets: int = 0
    calls: int = 0
    ours: int = 0
    theirs: int = 0
    only_ours: int = 0
    only_theirs: int = 0
    widest_rad: float = 0.0
    """Largest difference of a joint angle between roots that both found."""
    examples: list[dict[str, Any]] = field(default_factory=list)

    def note(self, trial: Trial, what: str, roots: Array) -> None:
        """Keep roots, shape (5, k), as examples."""
        for root in roots.T[: max(EXAMPLES - len(self.examples), 0)]:
            sigma = float(smallest_singular_value(trial, root[:, None])[0])
            self.examples.append(
                {"what": what, "tool": trial.tool, "root_rad": root.tolist(), "sigma": sigma}
            )


def compare(eaik: Eaik, tool: str, p_m: Array, approach: Array) -> Comparison:
    """Compare our roots with the oracle's, modulo full turns.

    Targets are positions and unit approach vectors in the rover frame, (3, n) each.
    """
    trial = Trial("nominal", arm_of("nominal"), tool, None)
    answers = inverse_kinematics(trial.arm, tool, p_m, approach)
    roots = claimed_roots(answers)
    comparison = Comparison(targets=p_m.shape[1])
    for k in range(comparison.targets):
        ours = answers.output_rad[:, roots[:, k], k]
        poses = interface_poses(trial, ours)
        distinct = poses[distinct_poses(poses)]
        theirs = np.concatenate([np.zeros((5, 0)), *(eaik.roots(X_1F) for X_1F in distinct)], axis=1)
        distance = np.abs(wrap_angle(ours[:, :, None] - theirs[:, None])).max(axis=0)
        to_theirs, to_ours = distance.min(axis=1, initial=np.inf), distance.min(axis=0, initial=np.inf)
        only_ours, only_theirs = to_theirs > SAME_RAD, to_ours > SAME_RAD
        comparison.calls += len(distinct)
        comparison.ours += ours.shape[1]
        comparison.theirs += theirs.shape[1]
        comparison.only_ours += int(only_ours.sum())
        comparison.only_theirs += int(only_theirs.sum())
        comparison.widest_rad = max(comparison.widest_rad, float(to_theirs[~only_ours].max(initial=0.0)))
        comparison.note(trial, "only ours", ours[:, only_ours])
        comparison.note(trial, "only theirs", theirs[:, only_theirs])
    return comparison


def random_targets(tool: str, kind: str, rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Draw targets of the workspace, or those of random joint vectors if the kind is `vectors`.

    Returns:
        Positions [m] and unit approach vectors in the rover frame, (3, n) each.
    """
    if kind == "workspace":
        return workspace_targets(rng, n)
    arm = arm_of("nominal")
    q = rng.uniform(arm.soft_min_rad[:, None], arm.soft_max_rad[:, None], (5, n))
    X_RT = Trial("nominal", arm, tool, None).tool_pose(q)
    return X_RT.p, X_RT.R[:, 0]


def campaign(context: Context, targets: int = 100_000) -> Document:
    """Compare the roots of this many targets; in bounds if none differs."""
    try:
        eaik = Eaik()
    except ImportError as missing:
        raise BadRequest(
            f"the oracle is not installed ({missing}); pip install --no-deps 'eaik>=1.2'"
        ) from missing
    tools = nominal_params().tool_names
    each = -(-targets // (len(tools) * len(KINDS)))
    results: dict[str, Comparison] = {}
    for kind in KINDS:
        for tool in tools:
            context.progress(len(results), len(tools) * len(KINDS), f"{kind}, {tool}")
            rng = np.random.default_rng([context.seed, tools.index(tool), KINDS.index(kind)])
            results[f"{kind} {tool}"] = compare(eaik, tool, *random_targets(tool, kind, rng, each))
    same = all(not (one.only_ours or one.only_theirs) for one in results.values())
    return {
        "family": eaik.family,
        "seed": context.seed,
        "in_bounds": same,
        "results": {name: asdict(one) for name, one in results.items()},
    }
