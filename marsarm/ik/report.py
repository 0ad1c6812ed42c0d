"""Report of inverse-kinematics results: tables and JSON documents."""

from math import degrees
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import describe_slot
from marsarm.ik.model import IkModel
from marsarm.ik.reach import ReachReport
from marsarm.ik.solve import BatchReport, IkReport
from marsarm.ik.tally import JOINT_NAMES, VERDICT_NAMES, Tally
from simgap.common.console import plain_console

WIDEST: Final = 240
"""Number of columns, larger than the width of any table."""


def ik_json(report: IkReport) -> dict[str, Any]:
    """Convert the result for one target to a JSON document."""
    branches = [_branch_json(report, slot) for slot in range(len(BRANCHES))]
    return {
        "valid": sum(branch["verdict"] == "valid" for branch in branches),
        **_model_json(report.model),
        "frame": report.request.frame,
        "position_m": list(report.request.position_m or ()),
        "approach": list(report.request.approach or ()),
        "joints": list(JOINT_NAMES),
        "branches": branches,
    }


def ik_table(report: IkReport) -> None:
    """Print the joint angles of each branch of a target, or the reason why it is invalid."""
    branches = [_branch_json(report, slot) for slot in range(len(BRANCHES))]
    valid = sum(branch["verdict"] == "valid" for branch in branches)
    table = Table()
    table.add_column("branch", no_wrap=True)
    for joint in JOINT_NAMES:
        table.add_column(f"{joint}\ndeg", justify="right", no_wrap=True)
    table.add_column("forward check\nm, rad", justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for branch in branches:
        angles = branch["output_deg"] or [None] * len(JOINT_NAMES)
        cells = ("-" if angle is None else f"{angle:.3f}" for angle in angles)
        error = "-" if branch["forward_error"] is None else f"{branch['forward_error']:.1e}"
        table.add_row(branch["branch"], *cells, error, branch["reason"] or "valid")
    _print_whole(f"{report.model.description}: {valid} of {len(branches)} branches valid", table)


def batch_json(report: BatchReport) -> dict[str, Any]:
    """Convert the summary of a batch to a JSON document."""
    return {
        **_tally_json(report.tally),
        **_model_json(report.model),
        "frame": report.request.frame,
        "batch": str(report.request.batch),
        "out": str(report.request.out),
    }


def batch_table(report: BatchReport) -> None:
    """Print the summary of a batch: counts, and the path of the results."""
    _print_tally(f"{report.model.description}: {report.tally.targets} targets", report.tally)
    plain_console().print(f"out       {report.request.out}", soft_wrap=True)


def reach_json(report: ReachReport) -> dict[str, Any]:
    """Convert a reach map to a JSON document."""
    request = report.request
    drawn = request.picture is not None and report.picture_problem is None
    return {
        **_tally_json(report.tally),
        **_model_json(report.model),
        "seed": request.seed,
        "picture": str(request.picture) if drawn else None,
        "picture_problem": report.picture_problem,
    }


def reach_table(report: ReachReport) -> None:
    """Print a reach map: counts, and the path of the picture."""
    title = f"{report.model.description}: {report.tally.targets} random targets of the workspace"
    _print_tally(title, report.tally)
    if report.request.picture is not None:
        reason = f"none  ({report.picture_problem})" if report.picture_problem else report.request.picture
        plain_console().print(f"picture   {reason}", soft_wrap=True)


def _branch_json(report: IkReport, slot: int) -> dict[str, Any]:
    result, name = report.result, BRANCHES[slot]
    verdict = VERDICT_NAMES[int(result.verdict[slot])]
    angles, error, excess = (
        result.output_rad[:, slot],
        float(result.error[slot]),
        float(result.excess[slot]),
    )
    reason = describe_slot(report.model.arm, result, slot).removeprefix(f"{name}: ")
    return {
        "branch": name,
        "verdict": verdict,
        "reason": None if verdict == "valid" else reason,
        "output_deg": [degrees(angle) for angle in angles] if np.isfinite(angles).all() else None,
        "limiting_joint": JOINT_NAMES[int(result.joint[slot])] if verdict == "outside_limits" else None,
        "beyond_limit_deg": degrees(excess) if verdict == "outside_limits" else None,
        "out_of_reach_m": excess if verdict == "out_of_reach" else None,
        "forward_error": error if np.isfinite(error) else None,
    }


def _model_json(model: IkModel) -> dict[str, Any]:
    request, gravity = model.request, model.gravity_R_m_s2
    return {
        "tool": model.tool,
        "arm": request.arm,
        "compensate": request.compensate,
        "gravity": request.gravity,
        "tilt_deg": {"roll": request.tilt_roll_deg, "pitch": request.tilt_pitch_deg},
        "gravity_R_m_s2": None if gravity is None else gravity.tolist(),
        "warming_K": request.warming_K,
        "params_sha256": model.params_sha256,
    }


def _tally_json(tally: Tally) -> dict[str, Any]:
    """Convert counts to shares of targets, or of invalid branches."""
    at_most_four = sum(count for valid, count in tally.targets_by_valid.items() if valid <= 4)
    return {
        "targets": tally.targets,
        "targets_by_valid_branches": {
            str(valid): count / tally.targets for valid, count in sorted(tally.targets_by_valid.items())
        },
        "targets_with_at_most_four": at_most_four / tally.targets,
        "valid_by_branch": {name: tally.valid_by_branch[name] / tally.targets for name in BRANCHES},
        "out_by_verdict": _shares_out(tally, {k: n for k, n in tally.by_verdict.items() if k != "valid"}),
        "outside_limits_by_joint": _shares_out(tally, tally.outside_by_joint),
    }


def _shares_out(tally: Tally, counts: dict[str, int]) -> dict[str, float]:
    """Compute shares of the invalid branches, in descending order."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return {name: count / max(tally.out, 1) for name, count in ordered}


def _print_tally(title: str, tally: Tally) -> None:
    shares = _tally_json(tally)
    parts = (
        ("targets with so many valid branches", shares["targets_by_valid_branches"]),
        ("targets with at most four", {"0 to 4": shares["targets_with_at_most_four"]}),
        ("targets with this branch valid", shares["valid_by_branch"]),
        ("of the branches that are out:", shares["out_by_verdict"]),
        ("... outside limits, by joint farthest out", shares["outside_limits_by_joint"]),
    )
    table = Table()
    table.add_column("share")
    table.add_column("")
    table.add_column("%", justify="right")
    for name, part in parts:
        for row, (key, share) in enumerate(part.items()):
            table.add_row(name if row == 0 else "", key.replace("_", " "), f"{100.0 * share:.2f}")
        table.add_section()
    _print_whole(title, table)


def _print_whole(title: str, table: Table) -> None:
    """Print a table at full width, because wrapped lines are readable and truncated ones are not."""
    console = plain_console(max(Console().width, WIDEST))
    console.print(title)
    console.print(table)
