"""Execution of a check: read robot and logs, audit them, simulate the nominal model."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.audit.audit import NominalModel, NominalMotion, audit
from simgap.audit.records import Audit
from simgap.command.request import CheckRequest
from simgap.common.errors import RobotError
from simgap.common.files import digest_files
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress
from simgap.diagnose import check_audit, check_motions
from simgap.load import load
from simgap.logs import Logs, Motion
from simgap.robot import Robot

READ: Final = 0.05
"""Share of the time that reading takes; measured on an hour of logs of six joints."""
AUDITED: Final = 0.1
"""Share after the audit; the rest is simulation."""


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
    """False without a command in all motions."""


def check_robot(request: CheckRequest, progress: Progress = no_progress) -> CheckReport:
    """Check a robot file and its logs.

    Raises:
        BadRequest: an option is wrong.
        RobotError: the robot file or a log is wrong; nothing was written.
    """
    check_options(request)
    progress(0.0, 1.0, "reading")
    robot = Robot.from_toml(request.robot)
    logs = load(robot, request.logs)
    progress(READ, 1.0, "auditing")
    found = audit(robot, logs)
    model = NominalModel(robot)
    durations_s = [_duration_s(motion) for motion in logs.motions]
    ends = np.cumsum([0.0, *durations_s]) / max(sum(durations_s), 1e-9)
    nominal = []
    for motion, done in zip(logs.motions, ends[:-1], strict=True):
        progress(AUDITED + (1.0 - AUDITED) * float(done), 1.0, f"simulating {motion.name}")
        nominal.append(model.simulate(motion))
    digests = digest_files({"robot": [request.robot], "log": request.logs})
    return CheckReport(request, robot, logs, found, tuple(nominal), digests, _refusal(robot, logs, found))


def summarize_joints(report: CheckReport) -> list[JointSummary]:
    """Return one summary for each joint, in the order of the robot file."""
    return [_summary(report, joint.name) for joint in report.robot.joints]


def _summary(report: CheckReport, joint: str) -> JointSummary:
    rates = [rate for rate in report.audit.rates if rate.joint == joint]
    weight = np.array([rate.n_samples for rate in rates], float)
    is_simulated = all(motion.joints[joint].command is not None for motion in report.logs.motions)
    usable = [report.audit.is_usable(motion.name, joint) for motion in report.logs.motions]
    positions = [motion.joints[joint].position.value for motion in report.logs.motions]
    errors = np.array([one.mean_abs_rad[joint] for one in report.nominal])
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
        nominal_mean_abs_rad=float(np.average(errors, weights=weight))
        if is_simulated and weight.any()
        else float("nan"),
        is_simulated=is_simulated,
    )


def _refusal(robot: Robot, logs: Logs, found: Audit) -> str:
    """Return the sentence with which a diagnosis refuses these logs; empty if it takes them."""
    try:
        check_motions(robot, logs.fit, logs.judged)
        check_audit(found, logs.fit)
    except RobotError as error:
        return str(error)
    return ""


def _duration_s(motion: Motion) -> float:
    return max(float(np.ptp(log.position.time_s)) for log in motion.joints.values())
