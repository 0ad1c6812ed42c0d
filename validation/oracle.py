"""An oracle for the rigid arm of the drawing: EAIK 1.2, which finds the roots of a full pose by other means.

A target here is a position and an approach; the spin about the approach is free and differs between roots.
EAIK takes full poses, so it is asked once for each different pose among our roots, and the union of what it
finds is compared. It knows the arm from azimuth joint to turret interface; the tool is taken off first.
"""

import argparse
import json
import sys
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.kinematics.chain import forward
from fsw.kinematics.ik import inverse_kinematics
from fsw.kinematics.transforms import Array, wrap_angle
from sim.params import nominal_params
from validation.kinematics_samples import workspace_targets
from validation.kinematics_trials import Trial, arm_of, claimed_roots, smallest_singular_value

SAME_POSE: Final = 1e-9
SAME_RAD: Final = 1e-6
MEETS: Final = 1e-9
EXAMPLES: Final = 20


class Eaik:
    """The arm of the drawing without a tool; ImportError where the package is not installed."""

    def __init__(self) -> None:
        from eaik.IK_DH import DhRobot  # needs numpy and nothing else of what the package asks for

        joints = [link.transform for link in nominal_params().links.in_order()[1:]]
        if any(link.theta_rad or link.beta_rad or link.b_m for link in joints):
            raise ValueError("the drawing is no longer in standard Denavit-Hartenberg form")
        self.robot = DhRobot(
            *(np.array([getattr(j, name) for j in joints]) for name in ("alpha_rad", "a_m", "d_m"))
        )

    @property
    def family(self) -> str:
        return str(self.robot.getKinematicFamily())

    def roots(self, X_1F: Array) -> Array:
        """The roots (5, k) of a pose (4, 4) of the turret interface from Arm1.

        What reaches a pose only nearly, EAIK marks as least squares. Where two azimuths nearly coincide it
        also marks roots that miss the pose by a mere 1e-12; its own forward kinematics takes the mark off.
        """
        solution = self.robot.IK(X_1F)
        at_best = zip(solution.Q, solution.is_LS, strict=True)
        real = [q for q, least_squares in at_best if not least_squares or self._error(q, X_1F) < MEETS]
        return np.array(real).reshape(-1, 5).T

    def _error(self, q: Array, X_1F: Array) -> float:
        return float(np.abs(self.robot.fwdKin(q) - X_1F).max())


def interface_poses(trial: Trial, output_rad: Array) -> Array:
    """(n, 4, 4): the turret interface from Arm1 for outputs (5, n)."""
    ends = forward(trial.arm, output_rad).X_RF
    R_R1, p_R1 = ends.R[:, :, 0, 0], ends.p[:, 0, 0]
    X = np.zeros((output_rad.shape[1], 4, 4))
    X[:, :3, :3] = np.einsum("ji,jkn->nik", R_R1, ends.R[:, :, 5])
    X[:, :3, 3] = (R_R1.T @ (ends.p[:, 5] - p_R1[:, None])).T
    X[:, 3, 3] = 1.0
    return X


def distinct_poses(poses: Array) -> list[int]:
    """Indices of the first of each set of equal poses (n, 4, 4)."""
    flat = poses.reshape(len(poses), -1)
    chosen: list[int] = []
    for k in range(len(flat)):
        if all(np.abs(flat[k] - flat[j]).max() > SAME_POSE for j in chosen):
            chosen.append(k)
    return chosen


@dataclass(slots=True)
class Comparison:
    """Our roots against the oracle's; comparisons add up over targets."""

    targets: int = 0
    calls: int = 0
    ours: int = 0
    theirs: int = 0
    only_ours: int = 0
    only_theirs: int = 0
    widest_rad: float = 0.0
    """Of roots that both have, the largest distance between the two, over all joints."""
    examples: list[dict[str, Any]] = field(default_factory=list)

    def note(self, trial: Trial, what: str, roots: Array) -> None:
        for root in roots.T[: max(EXAMPLES - len(self.examples), 0)]:
            sigma = float(smallest_singular_value(trial, root[:, None])[0])
            self.examples.append(
                {"what": what, "tool": trial.tool.name, "root_rad": root.tolist(), "sigma": sigma}
            )


def compare(eaik: Eaik, tool: Tool, p_m: Array, approach: Array) -> Comparison:
    """For targets (3, n): whether our roots and the oracle's are the same, modulo whole turns."""
    trial = Trial("nominal", arm_of("nominal"), tool, None)
    answers = inverse_kinematics(trial.arm, tool, p_m, approach)
    roots = claimed_roots(answers)
    seen = Comparison(targets=p_m.shape[1])
    for k in range(seen.targets):
        ours = answers.output_rad[:, roots[:, k], k]
        poses = interface_poses(trial, ours)
        asked = poses[distinct_poses(poses)]
        theirs = np.concatenate([np.zeros((5, 0)), *(eaik.roots(X_1F) for X_1F in asked)], axis=1)
        apart = np.abs(wrap_angle(ours[:, :, None] - theirs[:, None])).max(axis=0)
        from_ours, from_theirs = apart.min(axis=1, initial=np.inf), apart.min(axis=0, initial=np.inf)
        alone, lost = from_ours > SAME_RAD, from_theirs > SAME_RAD
        seen.calls += len(asked)
        seen.ours += ours.shape[1]
        seen.theirs += theirs.shape[1]
        seen.only_ours += int(alone.sum())
        seen.only_theirs += int(lost.sum())
        seen.widest_rad = max(seen.widest_rad, float(from_ours[~alone].max(initial=0.0)))
        seen.note(trial, "only ours", ours[:, alone])
        seen.note(trial, "only theirs", theirs[:, lost])
    return seen


def random_targets(tool: Tool, kind: str, rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Of kind `workspace`, the primary one, or `vectors`: poses of random joint vectors in their limits."""
    if kind == "workspace":
        return workspace_targets(rng, n)
    arm = arm_of("nominal")
    q = rng.uniform(arm.soft_min_rad[:, None], arm.soft_max_rad[:, None], (5, n))
    X_RT = Trial("nominal", arm, tool, None).tool_pose(q)
    return X_RT.p, X_RT.R[:, 0]


KINDS: Final = ("workspace", "vectors")


def main() -> int:
    """Print the comparison as JSON; exit status 1 where the two differ, 2 without the oracle."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.oracle",
        description=__doc__,
        epilog="example: python -m validation.oracle --targets 100000",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--targets", type=int, default=100_000, help="in all (default 100000)")
    parser.add_argument("--seed", type=int, default=0, help="of the targets (default 0)")
    asked = parser.parse_args()
    try:
        eaik = Eaik()
    except ImportError as missing:
        print(f"marsarm: the oracle is not installed ({missing}); `make oracle` installs it", file=sys.stderr)
        return 2
    each = -(-asked.targets // (len(Tool) * len(KINDS)))
    results, differ = {}, False
    for kind in KINDS:
        for tool in Tool:
            print(f"marsarm: {each} targets from {kind}, {tool.name}", file=sys.stderr)
            rng = np.random.default_rng([asked.seed, int(tool), KINDS.index(kind)])
            seen = compare(eaik, tool, *random_targets(tool, kind, rng, each))
            differ |= bool(seen.only_ours or seen.only_theirs)
            results[f"{kind} {tool.name}"] = asdict(seen)
    print(json.dumps({"family": eaik.family, "seed": asked.seed, "results": results}, indent=2))
    return int(differ)


if __name__ == "__main__":
    sys.exit(main())
