"""A check: read robot and logs, audit them, simulate the nominal model; its table, document and page."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from simgap.arrays import Array
from simgap.catalogue.catalogue import catalogue
from simgap.checks.audit import audit
from simgap.checks.records import Audit, Remark, hold
from simgap.command.request import CheckRequest
from simgap.common.console import pluralize
from simgap.common.errors import RobotError
from simgap.common.files import digest_files, json_sha256
from simgap.common.options import check_options, command_text
from simgap.common.page import Origin, heading, paragraph, save_page, table
from simgap.common.progress import GUESS, Progress, no_progress
from simgap.common.report import ReportTable, file_lines, to_json
from simgap.diagnosis import check_audit, check_motions, end_sentence, list_variations
from simgap.loading import load
from simgap.logs import Logs, Motion
from simgap.report import page
from simgap.report.traces import extreme_rows
from simgap.residuals.conditioned import group_by_robot
from simgap.residuals.simulation_residuals import list_kinds
from simgap.robot import Robot
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import Window, cut_windows

READ: Final = 0.05
"""Share of the time that reading takes; measured on an hour of logs of six joints."""
AUDITED: Final = 0.1
"""Share after the audit; the rest is simulation."""
MAX_REMARKS: Final = 8
"""Remarks on the console; the page and the JSON document have all."""
MAX_MOTIONS: Final = 3
"""Names of motions in a line."""
MAX_DRAWN: Final = 4
JOINT_HEAD: Final = ("joint", "Hz", "+-ms", "missing", "stale", "range [rad]", "left out", "error [mrad]")
"""Columns of a joint: rate, jitter, rows, range of the position, and mean error of the nominal model."""
RATE_HEAD: Final = (
    *("motion", "duration", "rate", "jitter", "missing", "stale", "rows left out"),
    "largest nominal error",
)


@dataclass(frozen=True, slots=True)
class NominalMotion:
    """The nominal model in one motion."""

    motion: str
    position: Mapping[str, Array]
    """Joint -> predicted position at the times of the logged ones, (n,) [rad]; NaN if it blew up, and where
    not all joints have a position."""
    mean_abs_rad: Mapping[str, float]
    """Joint -> mean absolute difference from the logged position; NaN if it blew up, or is not simulated."""
    is_simulated: bool
    """False without a command, with too few positions, or without the gains of all loops."""


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Result of a check."""

    request: CheckRequest
    robot: Robot
    logs: Logs
    audit: Audit
    nominal: tuple[NominalMotion, ...]
    """The nominal model in each motion, in the order of the logs."""
    digests: dict[str, str]
    """SHA-256 of robot file and logs."""
    refusal: str
    """Why a diagnosis refuses these logs; empty if it takes them."""


@dataclass(frozen=True, slots=True)
class JointSummary:
    """One joint over all motions; numbers of motions are weighed by their samples."""

    name: str
    rate_Hz: float
    jitter_s: float
    n_missing: int
    n_invalid: int
    n_stale: int
    refused_share: float
    """Share of the position samples that a diagnosis must not use."""
    lowest_rad: float
    highest_rad: float
    nominal_mean_abs_rad: float
    """Of the nominal simulation; NaN if it blew up, or is none."""
    is_simulated: bool
    """False if no motion has a command and enough positions, or without the gains of all loops."""
    is_slide: bool = False


def check_robot(request: CheckRequest, progress: Progress = no_progress) -> CheckReport:
    """Check a robot file and its logs; BadRequest or RobotError if an option, the file or a log is wrong."""
    check_options(request)
    progress(0.0, 1.0, "reading")
    robot = Robot.from_toml(request.robot)
    logs = load(robot, request.logs)
    progress(READ, GUESS, "auditing")
    found = audit(robot, logs)
    try:
        groups, unfit = group_by_robot(robot, logs.motions), ""
    except RobotError as error:
        groups, unfit = [], str(error)
    models: dict[str, Models] = {}
    for one, part in groups:
        models |= dict.fromkeys([motion.name for motion in part], Models(one))
    logs_of = [motion.joints.values() for motion in logs.motions]
    durations_s = [max(float(np.ptp(log.position.time_s)) for log in joints) for joints in logs_of]
    ends = np.cumsum([0.0, *durations_s]) / max(sum(durations_s), 1e-9)
    nominal = []
    for motion, done in zip(logs.motions, ends[:-1], strict=True):
        progress(AUDITED + (1.0 - AUDITED) * float(done), 1.0, f"simulating {motion.name}")
        nominal.append(simulate_nominal(models.get(motion.name), motion))
    digests = digest_files({"robot": [request.robot], "log": request.logs})
    refusal = _refusal(robot, logs, found) or unfit
    return CheckReport(request, robot, logs, found, tuple(nominal), digests, refusal)


def simulate_nominal(models: Models | None, motion: Motion) -> NominalMotion:
    """Simulate a motion once, as a diagnosis does, and compare; without models it is not simulated."""
    logged = {name: log.position for name, log in motion.joints.items()}
    predicted = {name: np.full(one.value.size, math.nan) for name, one in logged.items()}
    error = dict.fromkeys(logged, math.nan)
    if models is None:
        return NominalMotion(motion.name, predicted, error, is_simulated=False)
    windows, names = _whole_window(models, motion), [joint.name for joint in models.robot.joints]
    for window in windows:
        found = Engine(models, [], [window], 1).positions(np.zeros((1, 0)))[0]
        parts = np.split(found, np.cumsum([one.size for one in window.sample_time_s])[:-1])
        for name, part in zip(names, parts, strict=True):
            first = int(np.searchsorted(logged[name].time_s, window.start_s))
            at = slice(first, first + part.size)
            predicted[name][at] = part
            error[name] = float(np.mean(np.abs(part - logged[name].value[at]))) if part.size else math.nan
    return NominalMotion(motion.name, predicted, error, is_simulated=bool(windows))


def _whole_window(models: Models, motion: Motion) -> list[Window]:
    """Return a motion as one window; none without a gain, without a command, or with too few positions."""
    if not all(joint.knows_gains for joint in models.robot.joints):
        return []
    try:
        return cut_windows(models.robot, motion, None, 0.0)
    except RobotError:
        return []


def summarize_joints(report: CheckReport) -> list[JointSummary]:
    """Return one summary for each joint, in the order of the robot file."""
    return [_summary(report, joint.name) for joint in report.robot.joints]


def _summary(report: CheckReport, joint: str) -> JointSummary:
    rates = [rate for rate in report.audit.rates if rate.joint == joint]
    weight = np.array([rate.n_samples for rate in rates], float)
    usable = [report.audit.is_usable(motion.name, joint) for motion in report.logs.motions]
    positions = [motion.joints[joint].position.value for motion in report.logs.motions]
    errors = np.array([one.mean_abs_rad[joint] for one in report.nominal])
    judged = np.array([one.is_simulated for one in report.nominal]) & (weight > 0.0)
    return JointSummary(
        name=joint,
        rate_Hz=float(np.median([rate.rate_Hz for rate in rates if np.isfinite(rate.rate_Hz)] or [np.nan])),
        jitter_s=max((rate.jitter_s for rate in rates if np.isfinite(rate.jitter_s)), default=np.nan),
        n_missing=sum(rate.n_missing for rate in rates),
        n_invalid=sum(rate.n_invalid for rate in rates),
        n_stale=sum(rate.n_stale for rate in rates),
        refused_share=1.0 - sum(int(one.sum()) for one in usable) / max(sum(one.size for one in usable), 1),
        lowest_rad=min(float(np.nanmin(one)) for one in positions),
        highest_rad=max(float(np.nanmax(one)) for one in positions),
        nominal_mean_abs_rad=float(np.average(errors[judged], weights=weight[judged]))
        if judged.any()
        else math.nan,
        is_simulated=bool(judged.any()),
        is_slide=report.robot.joint(joint).is_slide,
    )


def _refusal(robot: Robot, logs: Logs, found: Audit) -> str:
    """Return the sentence with which a diagnosis refuses these logs; empty if it takes them."""
    try:
        check_audit(found, logs.fit)
        check_motions(robot, logs.fit, logs.judged)
        list_kinds(robot, logs.fit, found.usable)
        list_variations(robot, logs, catalogue(robot, logs))
    except RobotError as error:
        return str(error)
    return ""


def check_json(report: CheckReport) -> dict[str, Any]:
    """Convert a check to a JSON document in SI units; null where a number is not known."""
    found = {
        "robot": report.robot.name,
        "motions": [motion.name for motion in report.logs.motions],
        "held_out": sorted(report.logs.held_out),
        "losses": report.logs.losses,
        "joints": summarize_joints(report),
        **{key: getattr(report.audit, key) for key in ("remarks", "untested", "refused", "rates")},
        "nominal": [{"motion": one.motion, "mean_abs_rad": one.mean_abs_rad} for one in report.nominal],
        "refusal": report.refusal or None,
        "sha256": report.digests,
    }
    return {key: to_json(value) for key, value in found.items()}


def check_parts(report: CheckReport) -> list[str | ReportTable]:
    """Show one line for each joint, and the remarks with the worst first."""
    held_out = f", {len(report.logs.held_out)} held out" if report.logs.held_out else ""
    title = f"{report.robot.name}: {pluralize(len(report.logs.motions), 'motion')}{held_out}"
    more = len(report.audit.remarks) - MAX_REMARKS
    return [
        ReportTable(JOINT_HEAD, [*map(joint_cells, summarize_joints(report))], title),
        *report.logs.losses,
        *remark_lines(report.audit)[:MAX_REMARKS],
        *([f"{pluralize(more, 'more remark')} in --report and --json"] if more > 0 else []),
        *(f"not tested: {one}" for one in report.audit.untested),
        refusal_sentence(report),
        *file_lines({"report": report.request.report}),
    ]


def remark_lines(audit: Audit) -> list[str]:
    """Return a line for each remark, or one that says that there is none."""
    none = "no remark in what was tested" if audit.untested else "no remark: the logs look sound"
    return [f"{one.kind}: {remark_text(one)}{_motion_words(one)}" for one in audit.remarks] or [none]


def remark_text(remark: Remark) -> str:
    """Return the text of a remark after its joint, if it is of one."""
    return f"{remark.joint}: {remark.text}" if remark.joint else remark.text


def refusal_sentence(report: CheckReport) -> str:
    """Say why a diagnosis refuses the logs, or how many rows it leaves out, and why."""
    if report.refusal:
        return end_sentence(f"A diagnosis will refuse these logs: {report.refusal}")
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


def joint_cells(one: JointSummary) -> tuple[str, ...]:
    """Return the cells of a joint, as JOINT_HEAD names them."""
    error = one.nominal_mean_abs_rad
    factor, digits, unit = (1e3, 1, " mm") if one.is_slide else (1.0, 2, "")
    failed = "blew up" if one.is_simulated else "not simulated"
    return (
        one.name,
        f"{one.rate_Hz:.0f}",
        f"{one.jitter_s * 1e3:.1f}",
        str(one.n_missing + one.n_invalid),
        str(one.n_stale),
        f"{factor * one.lowest_rad:.{digits}f}..{factor * one.highest_rad:.{digits}f}{unit}",
        f"{one.refused_share:.1%}",
        f"{error * 1e3:.1f}{unit}" if math.isfinite(error) else failed,
    )


def save_check_page(report: CheckReport, path: Path) -> None:
    """Write the page; BadOutput if the file cannot be written."""
    digests = {**report.digests, "result": json_sha256(check_json(report))}
    origin = Origin(command_text("simgap check", report.request), digests)
    count = len(report.audit.remarks)
    said = pluralize(count, "remark") if count else remark_lines(report.audit)[0].capitalize()
    verdict = f"{said}. {refusal_sentence(report)}"
    save_page(f"{report.robot.name}: check of the logs", verdict, (), origin, list(_page_parts(report)), path)


def _page_parts(report: CheckReport) -> Iterator[str]:
    if report.audit.remarks:
        yield heading("Remarks, the worst first")
        rows = [(str(one.kind), remark_text(one), ", ".join(one.motions)) for one in report.audit.remarks]
        yield table(("kind", "what the logs show", "motions"), rows)
    if report.audit.untested:
        yield heading("Not tested")
        yield table(("fault that these logs cannot show",), [(one,) for one in report.audit.untested])
    yield heading("Joints")
    yield paragraph(
        "Rate and jitter of the positions, rows that are missing or stale, their range, and the share "
        "that a diagnosis leaves out. The error is the mean absolute difference between the logged position "
        "and one simulation of the model as it is, from the start of each motion, with the logged commands."
    )
    yield table(JOINT_HEAD, [joint_cells(one) for one in summarize_joints(report)])
    yield heading("Command, position and nominal simulation")
    chosen = drawn_motions(report)
    yield paragraph(
        f"{len(chosen)} of {pluralize(len(report.logs.motions), 'motion')}: those of the remarks, then those "
        "with the largest error. A diagnosis leaves out what is marked."
    )
    yield page.figure_style()
    yield from page.draw_figures([joint_figure(report, joint.name, chosen) for joint in report.robot.joints])
    yield heading("Rates")
    yield table(RATE_HEAD, list(_rate_rows(report)))


def drawn_motions(report: CheckReport) -> list[int]:
    """Return the motions to draw: one of each remark, the worst first, then those of the largest error."""
    names = [motion.name for motion in report.logs.motions]
    refused = dict.fromkeys(names, 0)
    for one in report.audit.refused:
        refused[one.motion] += one.n_samples
    error = [np.nansum([*_comparable(report.robot, one).values()]) for one in report.nominal]
    worst = [max(one.motions, key=refused.__getitem__) for one in report.audit.remarks if one.motions]
    by_error = sorted(range(len(names)), key=lambda k: -error[k])
    return list(dict.fromkeys([*map(names.index, worst), *by_error]))[:MAX_DRAWN]


def joint_figure(report: CheckReport, joint: str, motions: list[int]) -> str:
    """Draw command, position and nominal simulation of one joint, and what a diagnosis leaves out."""
    documents = []
    of_joint = report.robot.joint(joint)
    for number in motions:
        motion = report.logs.motions[number]
        log = motion.joints[joint]
        left_out = ~report.audit.is_usable(motion.name, joint)
        series: dict[str, Array] = {
            "refused": np.where(left_out, log.position.value, np.nan),
            "measured": log.position.value,
            "nominal": report.nominal[number].position[joint],
        }
        if log.command is not None:
            series["command"] = hold(log.command, log.position.time_s)
        error = {"nominal": series["measured"] - series["nominal"]}
        rows = extreme_rows([*series.values(), *error.values()])
        series, error = ({name: one[rows] for name, one in part.items()} for part in (series, error))
        panels = [page.position_panel("distance" if of_joint.is_slide else "angle", of_joint.unit, series)]
        if np.isfinite(error["nominal"]).any():
            panels.append(page.error_panel("measured less simulated", of_joint.unit, error))
        documents.append((motion.name, page.motion_document(log.position.time_s[rows], panels)))
    has_command = all(report.logs.motions[k].joints[joint].command is not None for k in motions)
    names = ("measured", "nominal", *(("command",) if has_command else ()), "refused")
    return page.series_figure(joint, names, documents)


def _rate_rows(report: CheckReport) -> Iterator[tuple[str, ...]]:
    for motion, nominal in zip(report.logs.motions, report.nominal, strict=True):
        rates = [one for one in report.audit.rates if one.motion == motion.name]
        left_out = sum(one.n_samples for one in report.audit.refused if one.motion == motion.name)
        comparable = _comparable(report.robot, nominal)
        worst = max(comparable, key=lambda name: comparable[name])
        unit = report.robot.joint(worst).unit
        yield (
            motion.name,
            f"{rates[0].duration_s:.1f} s",
            f"{rates[0].rate_Hz:.0f} Hz",
            f"{max(one.jitter_s for one in rates) * 1e3:.1f} ms",
            str(max(one.n_missing + one.n_invalid for one in rates)),
            str(max(one.n_stale for one in rates)),
            str(left_out),
            f"{nominal.mean_abs_rad[worst] * 1e3:.1f} m{unit} at {worst}",
        )


def _comparable(robot: Robot, nominal: NominalMotion) -> dict[str, float]:
    """Return the error of each joint in rad, that of a slide as what moves a point as far."""
    return {name: error / robot.joint(name).per_rad for name, error in nominal.mean_abs_rad.items()}
