"""Inverse kinematics of targets, one of them as a request of the command line."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params, digest
from fsw.kinematics.arm import Arm, build_arm, heat_arm
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, IkResult, describe_slot, inverse_kinematics
from fsw.kinematics.transforms import Array, select_targets
from marsarm.common.requests import check_targets, make_world, parse_tool, select_arm
from marsarm.ik.request import IkRequest, ModelRequest
from sim.frames import Workspace, p_R_from_N
from simgap.common.errors import BadRequest
from simgap.common.options import check_options
from simgap.common.progress import Progress
from simgap.common.report import ReportTable

if TYPE_CHECKING:
    from marsarm.common.pool import Runner

JOINT_NAMES: Final = tuple(joint.name.lower() for joint in Joint)
VERDICT_NAMES: Final = tuple(verdict.name.lower() for verdict in BranchVerdict)
MOST_WARMING_K: Final = 200.0
"""Largest temperature difference from calibration; the coldest night on Mars is nearer."""
BATCH_SIZE: Final = 8192
"""Number of targets in a part of a batch; solving a part takes about a second."""


@dataclass(frozen=True, slots=True, eq=False)
class IkTargets:
    """Targets: position of the tool's origin and direction of its boresight, in RMECH."""

    p_RoTo_R_m: Array
    """Positions, shape (3, n)."""
    approach_R: Array
    """Unit vectors, shape (3, n)."""

    def __len__(self) -> int:
        return int(self.p_RoTo_R_m.shape[1])

    def part(self, start: int, count: int) -> "IkTargets":
        """Select `count` targets from index `start` on."""
        these = slice(start, start + count)
        return IkTargets(self.p_RoTo_R_m[:, these], self.approach_R[:, these])


def make_targets(position_m: Array, approach: Array) -> IkTargets:
    """Build targets of positions in RNAV and directions of any length, shape (3, n) each.

    BadRequest, in the words of the user, says that a number is not finite, a point too far, a direction 0, or
    the shapes differ.
    """
    position_m, approach = np.asarray(position_m, float), np.asarray(approach, float)
    if position_m.shape != approach.shape or position_m.ndim != 2 or len(position_m) != 3:
        shapes = f"{position_m.shape} and {approach.shape}"
        raise BadRequest(f"position and approach: have the shapes {shapes}; both must have (3, n)")
    what = "the one in which the tool is to point, such as 0 0 1 for down"
    unit = check_targets(position_m, approach, ("position", "approach"), what)
    unit = unit / np.linalg.norm(unit, axis=0)
    return IkTargets(p_R_from_N(position_m.T).T, unit)


@dataclass(frozen=True, slots=True, eq=False)
class IkModel:
    """Arm as flight software knows it, with the gravity to compensate; None without compensation."""

    request: ModelRequest
    arm: Arm
    tool: str
    gravity_R_m_s2: Array | None
    params: Params
    workspace: Workspace

    @property
    def description(self) -> str:
        """Describe the arm and its load."""
        request = self.request
        text = f"{self.tool}, arm {request.arm}"
        if request.warming_K:
            text += f" {request.warming_K:+g} K"
        if self.gravity_R_m_s2 is None:
            return text + ", rigid"
        tilted = f", roll {request.tilt_roll_deg:g} pitch {request.tilt_pitch_deg:g} deg"
        level = request.tilt_roll_deg == request.tilt_pitch_deg == 0.0
        return text + f", deflected by the gravity of {request.gravity.title()}" + ("" if level else tilted)

    def solve_in_batches(self, targets: IkTargets, run: "Runner", progress: Progress) -> Iterator[IkResult]:
        """Solve the inverse kinematics in parts, (8, n) each."""
        from marsarm.common.pool import in_order  # one target needs no pool

        starts = range(0, len(targets), BATCH_SIZE)
        parts = ((self, targets.part(start, BATCH_SIZE)) for start in starts)
        progress(0, len(targets), "solving")
        for start, result in zip(starts, in_order(run, IkModel.solve, parts), strict=True):
            progress(start, len(targets), "solving")
            yield result

    def solve(self, targets: IkTargets) -> IkResult:
        """Solve the inverse kinematics of all targets for every branch, shape (8, n)."""
        return inverse_kinematics(
            self.arm, self.tool, targets.p_RoTo_R_m, targets.approach_R, self.gravity_R_m_s2
        )


def build_ik_model(request: ModelRequest) -> IkModel:
    """Build the arm model of a request; BadRequest if a field of the request is wrong."""
    world = make_world(request.gravity, request.tilt_roll_deg, request.tilt_pitch_deg, "gravity")
    if not math.isfinite(request.warming_K) or abs(request.warming_K) > MOST_WARMING_K:
        raise BadRequest(
            f"warming: {request.warming_K:g} K is not within {MOST_WARMING_K:g} K of calibration temperature"
        )
    arm = select_arm(request.arm, request.params, request.mismatch)
    params = arm.params
    tool = parse_tool(request.tool or arm.model.description.instrument, params.tool_names)
    gravity = world.gravity_N_m_s2 if request.compensate == "absolute" else None
    warm = heat_arm(build_arm(params), request.warming_K)
    return IkModel(request, warm, tool, gravity, params, arm.model.workspace)


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts that add up over parts of a batch."""

    targets_by_valid: Counter[int] = field(default_factory=Counter)
    """Number of targets by their number of valid branches."""
    valid_by_branch: Counter[str] = field(default_factory=Counter)
    by_verdict: Counter[str] = field(default_factory=Counter)
    outside_by_joint: Counter[str] = field(default_factory=Counter)
    """Number of branches outside limits, by the joint farthest beyond its limit."""

    def add(self, result: IkResult) -> None:
        """Count the results of a part of a batch."""
        valid = result.verdict == BranchVerdict.VALID
        outside = result.verdict == BranchVerdict.OUTSIDE_LIMITS
        self.targets_by_valid.update(valid.sum(axis=0).tolist())
        self.valid_by_branch.update(dict(zip(BRANCHES, valid.sum(axis=1).tolist(), strict=True)))
        self.by_verdict.update(VERDICT_NAMES[k] for k in result.verdict.ravel().tolist())
        self.outside_by_joint.update(JOINT_NAMES[k] for k in result.joint[outside].tolist())

    @property
    def targets(self) -> int:
        """Return the number of targets."""
        return self.targets_by_valid.total()

    @property
    def out(self) -> int:
        """Return the number of invalid branches."""
        return self.by_verdict.total() - self.by_verdict["valid"]


@dataclass(frozen=True, slots=True, eq=False)
class IkReport:
    """Result for one target."""

    request: IkRequest
    model: IkModel
    result: IkResult
    """Result of every branch, shape (8,)."""


def solve(request: IkRequest) -> IkReport:
    """Solve the inverse kinematics of a request; BadRequest if the request is wrong."""
    check_options(request)
    model = build_ik_model(request.model)
    return IkReport(request, model, select_targets(model.solve(_one_target(request)), 0))


def _one_target(request: IkRequest) -> IkTargets:
    if request.position_m is None or request.approach is None:
        raise BadRequest(
            "position and approach: give both, such as --position 2.1 0 -0.3 --approach 0.5 0 0.85"
        )
    position, approach = (np.array(vector)[:, None] for vector in (request.position_m, request.approach))
    return make_targets(position, approach)


def ik_document(report: IkReport) -> dict[str, Any]:
    """Collect the result for one target."""
    branches = [_branch(report, slot) for slot in range(len(BRANCHES))]
    return {
        "valid": sum(branch["verdict"] == "valid" for branch in branches),
        **model_document(report.model),
        "position_m": report.request.position_m or (),
        "approach": report.request.approach or (),
        "joints": JOINT_NAMES,
        "branches": branches,
    }


def _branch(report: IkReport, slot: int) -> dict[str, Any]:
    result, name = report.result, BRANCHES[slot]
    verdict = VERDICT_NAMES[int(result.verdict[slot])]
    angles, excess = result.output_rad[:, slot], float(result.excess[slot])
    is_outside, is_far = verdict == "outside_limits", verdict == "out_of_reach"
    reason = describe_slot(report.model.arm, result, slot).removeprefix(f"{name}: ")
    return {
        "branch": name,
        "verdict": verdict,
        "reason": None if verdict == "valid" else reason,
        "output_deg": [math.degrees(angle) for angle in angles] if np.isfinite(angles).all() else None,
        "limiting_joint": JOINT_NAMES[int(result.joint[slot])] if is_outside else None,
        "beyond_limit_deg": math.degrees(excess) if is_outside else None,
        "out_of_reach_m": excess if is_far else None,
        "forward_error": result.error[slot],
    }


def ik_parts(report: IkReport) -> list[str | ReportTable]:
    """Show the joint angles of each valid branch of a target, and the reasons why others are invalid."""
    branches = [_branch(report, slot) for slot in range(len(BRANCHES))]
    valid = [one for one in branches if one["reason"] is None]
    rows = [(one["branch"], *(f"{angle:.3f}" for angle in one["output_deg"])) for one in valid]
    head = ("branch", *(f"{joint}\ndeg" for joint in JOINT_NAMES))
    found = f"{len(valid)} of {len(branches)} branches valid" if valid else "no branch reaches the target"
    title = f"{report.model.description}: {found}"
    parts: list[str | ReportTable] = [ReportTable(head, rows, title, is_whole=True)] if valid else [title]
    if valid:
        worst = max(float(one["forward_error"]) for one in valid)
        parts.append(f"forward kinematics of these angles: at most {worst:.1e} m or rad beside the target")
    return parts + [f"{one['branch']}: {one['reason']}" for one in branches if one["reason"] is not None]


def model_document(model: IkModel) -> dict[str, Any]:
    """Collect what describes the arm of a request."""
    request = model.request
    return {
        "tool": model.tool,
        "arm": request.arm,
        "compensate": request.compensate,
        "gravity": request.gravity,
        "tilt_deg": {"roll": request.tilt_roll_deg, "pitch": request.tilt_pitch_deg},
        "gravity_R_m_s2": model.gravity_R_m_s2,
        "warming_K": request.warming_K,
        "params_sha256": digest(model.params),
    }


def tally_document(tally: Tally) -> dict[str, Any]:
    """Convert counts to shares of targets, or of invalid branches."""
    at_most_four = sum(count for valid, count in tally.targets_by_valid.items() if valid <= 4)
    invalid = {name: count for name, count in tally.by_verdict.items() if name != "valid"}
    return {
        "targets": tally.targets,
        "targets_by_valid_branches": {
            str(valid): count / tally.targets for valid, count in sorted(tally.targets_by_valid.items())
        },
        "targets_with_at_most_four": at_most_four / tally.targets,
        "valid_by_branch": {name: tally.valid_by_branch[name] / tally.targets for name in BRANCHES},
        "out_by_verdict": _shares_out(tally, invalid),
        "outside_limits_by_joint": _shares_out(tally, tally.outside_by_joint),
    }


def _shares_out(tally: Tally, counts: dict[str, int]) -> dict[str, float]:
    """Compute shares of the invalid branches, in descending order."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return {name: count / max(tally.out, 1) for name, count in ordered}


def tally_table(title: str, tally: Tally) -> ReportTable:
    """Show counts as shares in percent."""
    shares = tally_document(tally)
    parts = (
        ("targets with so many valid branches", shares["targets_by_valid_branches"]),
        ("targets with at most four", {"0 to 4": shares["targets_with_at_most_four"]}),
        ("targets with this branch valid", shares["valid_by_branch"]),
        ("of the branches that are out:", shares["out_by_verdict"]),
        ("... outside limits, by joint farthest out", shares["outside_limits_by_joint"]),
    )
    rows = [
        (name if row == 0 else "", key.replace("_", " "), f"{100.0 * share:.2f}")
        for name, part in parts
        for row, (key, share) in enumerate(part.items())
    ]
    return ReportTable(("share", "", "%"), rows, title, is_whole=True)
