"""Console output and JSON document of a check; on the console at most a screenful."""

import math
from typing import Any, Final

from rich.table import Table

from simgap.audit.records import Remark, SignalRate
from simgap.command.execution import CheckReport, JointSummary, summarize_joints
from simgap.common.console import plain_console, pluralize

MAX_REMARKS: Final = 8
"""Remarks on the console; the page and the JSON document have all."""
JOINT_HEAD: Final = ("joint", "Hz", "+-ms", "missing", "stale", "range [rad]", "left out", "error [mrad]")
"""Columns of a joint: rate, jitter, rows, range of the position, and mean error of the nominal model."""
MAX_MOTIONS: Final = 3
"""Names of motions in a line."""


def print_check(report: CheckReport) -> None:
    """Print one line for each joint, and the remarks with the worst first."""
    console = plain_console()
    console.print(_joint_table(report))
    for line in remark_lines(report.audit.remarks)[:MAX_REMARKS]:
        console.print(line)
    more = len(report.audit.remarks) - MAX_REMARKS
    if more > 0:
        console.print(f"{pluralize(more, 'more remark')} in --report and --json")
    console.print(refusal_sentence(report))


def remark_lines(remarks: tuple[Remark, ...]) -> list[str]:
    """Return a line for each remark, or one that says that there is none."""
    return [f"{one.kind}: {remark_place(one)}{one.text}{_motion_words(one)}" for one in remarks] or [
        "no remark: the logs look sound"
    ]


def remark_place(remark: Remark) -> str:
    """Return the joint of a remark as the beginning of a sentence; nothing for the whole robot."""
    return f"{remark.joint}: " if remark.joint else ""


def refusal_sentence(report: CheckReport) -> str:
    """Say why a diagnosis refuses the logs, or how many rows it leaves out, and why."""
    if report.refusal:
        return f"A diagnosis will refuse these logs: {report.refusal}."
    refused = report.audit.refused
    if not refused:
        return "A diagnosis will use all rows."
    motions = len({one.motion for one in refused})
    reasons = ", ".join(dict.fromkeys(one.reason for one in refused))
    rows = sum(one.n_samples for one in refused)
    return f"A diagnosis will leave out {rows} rows of {pluralize(motions, 'motion')}: {reasons}."


def _motion_words(remark: Remark) -> str:
    names = remark.motions[:MAX_MOTIONS]
    more = len(remark.motions) - len(names)
    words = ", ".join(names) + (f" and {more} more" if more else "")
    return f" [{words}]" if words else ""


def _joint_table(report: CheckReport) -> Table:
    motions = report.logs.motions
    held_out = f", {len(report.logs.held_out)} held out" if report.logs.held_out else ""
    title = f"{report.robot.name}: {pluralize(len(motions), 'motion')}{held_out}"
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1))
    for name in JOINT_HEAD:
        table.add_column(name, justify="left" if name == "joint" else "right", no_wrap=True)
    for one in summarize_joints(report):
        table.add_row(*joint_cells(one))
    return table


def joint_cells(one: JointSummary) -> tuple[str, ...]:
    """Return the cells of a joint, as JOINT_HEAD names them."""
    error = one.nominal_mean_abs_rad
    return (
        one.name,
        f"{one.rate_Hz:.0f}",
        f"{one.jitter_s * 1e3:.1f}",
        str(one.n_missing + one.n_invalid),
        str(one.n_stale),
        f"{one.lowest_rad:.2f}..{one.highest_rad:.2f}",
        f"{one.refused_share:.1%}",
        f"{error * 1e3:.1f}" if math.isfinite(error) else "blew up" if one.is_simulated else "no command",
    )


def check_json(report: CheckReport) -> dict[str, Any]:
    """Convert a check to a JSON document in SI units; null where a number is not known."""
    return {
        "robot": report.robot.name,
        "motions": [motion.name for motion in report.logs.motions],
        "held_out": sorted(report.logs.held_out),
        "joints": [_joint_json(one) for one in summarize_joints(report)],
        "remarks": [_remark_json(one) for one in report.audit.remarks],
        "refused": [
            {"motion": one.motion, "reason": one.reason, "rows": one.n_samples}
            for one in report.audit.refused
        ],
        "rates": [_rate_json(one) for one in report.audit.rates],
        "nominal": [
            {
                "motion": one.motion,
                "mean_abs_rad": {name: _number(value) for name, value in one.mean_abs_rad.items()},
            }
            for one in report.nominal
        ],
        "refusal": report.refusal or None,
        "sha256": report.digests,
    }


def _joint_json(one: JointSummary) -> dict[str, Any]:
    return {
        "name": one.name,
        "rate_Hz": _number(one.rate_Hz),
        "jitter_s": _number(one.jitter_s),
        "missing": one.n_missing,
        "invalid": one.n_invalid,
        "stale": one.n_stale,
        "refused_share": one.refused_share,
        "lowest_rad": _number(one.lowest_rad),
        "highest_rad": _number(one.highest_rad),
        "nominal_mean_abs_rad": _number(one.nominal_mean_abs_rad),
    }


def _remark_json(one: Remark) -> dict[str, Any]:
    low, high = one.interval
    return {
        "kind": str(one.kind),
        "joint": one.joint or None,
        "motions": list(one.motions),
        "text": one.text,
        "value": _number(one.value),
        "interval": [_number(low), _number(high)],
        "unit": one.unit,
    }


def _rate_json(one: SignalRate) -> dict[str, Any]:
    return {
        "motion": one.motion,
        "joint": one.joint,
        "samples": one.n_samples,
        "duration_s": one.duration_s,
        "rate_Hz": _number(one.rate_Hz),
        "jitter_s": _number(one.jitter_s),
        "missing": one.n_missing,
        "invalid": one.n_invalid,
        "stale": one.n_stale,
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
