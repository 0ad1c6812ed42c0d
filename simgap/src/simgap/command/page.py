"""Page of a check: remarks, joints, command and position of a few motions, rates."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from simgap.command.execution import CheckReport, summarize_joints
from simgap.command.figures import motion_figures
from simgap.command.tables import JOINT_HEAD, check_json, joint_cells, refusal_sentence, remark_place
from simgap.common.console import pluralize
from simgap.common.json_digest import json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin, figures, heading, paragraph, save_page, table

MAX_DRAWN: Final = 4
"""Motions that are drawn: each is a figure for each joint."""


def save_check_page(report: CheckReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: the file cannot be written.
    """
    origin = Origin(
        command_text("robot check", report.request),
        {**report.digests, "result": json_sha256(check_json(report))},
    )
    parts = [
        *_remark_section(report),
        *_joint_section(report),
        *_motion_section(report),
        *_rate_section(report),
    ]
    save_page(f"{report.robot.name}: check of the logs", _verdict(report), (), origin, parts, path)


def drawn_motions(report: CheckReport) -> list[int]:
    """Return the motions to draw: one of each remark, the worst first, then those of the largest error."""
    names = [motion.name for motion in report.logs.motions]
    refused = dict.fromkeys(names, 0)
    for one in report.audit.refused:
        refused[one.motion] += one.n_samples
    error = [np.nansum(list(one.mean_abs_rad.values())) for one in report.nominal]
    of_remarks = [
        names.index(max(one.motions, key=lambda name: refused[name]))
        for one in report.audit.remarks
        if one.motions
    ]
    by_error = sorted(range(len(names)), key=lambda k: -error[k])
    return list(dict.fromkeys([*of_remarks, *by_error]))[:MAX_DRAWN]


def _verdict(report: CheckReport) -> str:
    count = len(report.audit.remarks)
    said = f"{pluralize(count, 'remark')}. " if count else "No remark: the logs look sound. "
    return said + refusal_sentence(report)


def _remark_section(report: CheckReport) -> Iterator[str]:
    if not report.audit.remarks:
        return
    yield heading("Remarks, the worst first")
    rows = [
        (str(one.kind), f"{remark_place(one)}{one.text}", ", ".join(one.motions))
        for one in report.audit.remarks
    ]
    yield table(("kind", "what the logs show", "motions"), rows)


def _joint_section(report: CheckReport) -> Iterator[str]:
    yield heading("Joints")
    yield paragraph(
        "Rate and jitter of the positions, rows that are missing or stale, their range, and the share "
        "that a diagnosis leaves out. The error is the mean absolute difference between the logged position "
        "and one simulation of the model as it is, from the start of each motion, with the logged commands."
    )
    yield table(JOINT_HEAD, [joint_cells(one) for one in summarize_joints(report)])


def _motion_section(report: CheckReport) -> Iterator[str]:
    yield heading("Command, position and nominal simulation")
    chosen = drawn_motions(report)
    yield paragraph(
        f"{len(chosen)} of {pluralize(len(report.logs.motions), 'motion')}: those of the remarks, then those "
        "with the largest error. A diagnosis leaves out what is shaded."
    )
    for number in chosen:
        yield f"<h3>{_escape(report.logs.motions[number].name)}</h3>"
        yield figures(*motion_figures(report, number))


def _rate_section(report: CheckReport) -> Iterator[str]:
    yield heading("Rates")
    rows = []
    for motion, nominal in zip(report.logs.motions, report.nominal, strict=True):
        rates = [one for one in report.audit.rates if one.motion == motion.name]
        first = rates[0]
        left_out = sum(one.n_samples for one in report.audit.refused if one.motion == motion.name)
        worst = max(nominal.mean_abs_rad, key=lambda name: nominal.mean_abs_rad[name])
        rows.append(
            (
                motion.name,
                f"{first.duration_s:.1f} s",
                f"{first.rate_Hz:.0f} Hz",
                f"{max(one.jitter_s for one in rates) * 1e3:.1f} ms",
                str(max(one.n_missing + one.n_invalid for one in rates)),
                str(max(one.n_stale for one in rates)),
                str(left_out),
                f"{nominal.mean_abs_rad[worst] * 1e3:.1f} mrad at {worst}",
            )
        )
    head = (
        "motion",
        "duration",
        "rate",
        "jitter",
        "missing",
        "stale",
        "rows left out",
        "largest nominal error",
    )
    yield table(head, rows)


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")
