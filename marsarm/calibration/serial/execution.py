"""Execution of a calibration of a serial arm: read the files, fit, validate, write the fitted arm."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from marsarm.calibration.request import SerialRequest
from sim.scenario.names import did_you_mean
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress
from simgap.serial_arm.calibrate import estimate_setup, held_out_ratio
from simgap.serial_arm.chain import PoseSeries
from simgap.serial_arm.files import arm_to_toml, read_arm, read_series
from simgap.serial_arm.fit import Identifiability, assess_identifiability
from simgap.serial_arm.model import TERMS, SerialArm
from simgap.serial_arm.nested_models import NestedModel, TemperatureTest, fit_nested_models, temperature_test

ALL: Final = "all"
NONE: Final = "none"


@dataclass(frozen=True, slots=True, eq=False)
class SerialReport:
    """Result of a request for a calibration."""

    request: SerialRequest
    arm: SerialArm
    """Arm of the file, before the calibration."""
    poses: int
    part: PoseSeries
    fresh: PoseSeries | None
    models: tuple[NestedModel, ...]
    """Models; the first one has no terms, the last one all requested terms."""
    identifiability: Identifiability
    ratio: float | None
    """Error of held-out poses over the error expected from noise and covariance."""
    temperature: TemperatureTest | None
    digests: dict[str, str]
    """SHA-256 of the input files."""


def calibrate_serial(request: SerialRequest, progress: Progress = no_progress) -> SerialReport:
    """Fit the arm of a file to one part of a table of measured poses, and validate it with the other part.

    Raises:
        BadRequest: The request is wrong; nothing was written.
        RobotError: A file is wrong, or its poses do not determine the parameters; nothing was written.
    """
    check_options(request)
    terms = _parse_terms(request.terms)
    arm, series, digests = _read(request)
    count = round(request.fit_share * series.count)
    is_part = np.arange(series.count) < count
    part, fresh = series.at(is_part), series.at(~is_part) if count < series.count else None
    steps = fit_nested_models(
        arm, estimate_setup(arm, part), part, fresh, _term_sets(terms, request.nested), progress
    )
    report = _build_report(request, arm, series, part, fresh, steps, digests)
    if request.out is not None:
        text = arm_to_toml(steps[-1].found.arm, _provenance(report))
        with atomic_write(request.out, "out") as file:
            file.write(text.encode())
    return report


def _build_report(
    request: SerialRequest,
    arm: SerialArm,
    series: PoseSeries,
    part: PoseSeries,
    fresh: PoseSeries | None,
    steps: tuple[NestedModel, ...],
    digests: dict[str, str],
) -> SerialReport:
    last = steps[-1]
    fit = last.found.fit
    identifiability = assess_identifiability(fit.parameters, fit.at, fit.used)
    ratio = None if fresh is None else held_out_ratio(last.found, fresh)
    temperature = temperature_test(last.found, last.validation)
    return SerialReport(
        request, arm, series.count, part, fresh, steps, identifiability, ratio, temperature, digests
    )


def _read(request: SerialRequest) -> tuple[SerialArm, PoseSeries, dict[str, str]]:
    arm = read_arm(request.arm)
    series = read_series(arm, request.table, request.mapping)
    files = {"arm": request.arm, "mapping": request.mapping, "table": request.table}
    return arm, series, {name: _sha256(path) for name, path in files.items()}


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _parse_terms(text: str) -> tuple[str, ...]:
    if text in (ALL, NONE):
        return TERMS if text == ALL else ()
    words = [word.strip() for word in text.split(",")]
    wrong = next((word for word in words if word not in (*TERMS, ALL, NONE)), None)
    if wrong is not None:
        known = did_you_mean(wrong, (*TERMS, ALL, NONE))
        raise BadRequest(f"terms: {wrong!r:.60} is not known; {known}")
    if ALL in words or NONE in words:
        raise BadRequest(f"terms: {text!r}: {ALL} and {NONE} stand alone")
    return tuple(term for term in TERMS if term in words)


def _term_sets(terms: tuple[str, ...], is_nested: bool) -> Sequence[tuple[str, ...]]:
    every = [terms[:k] for k in range(len(terms) + 1)]
    return every if is_nested else list(dict.fromkeys((every[0], *every[1:2], every[-1])))


def _provenance(report: SerialReport) -> list[str]:
    """Describe the origin of a calibrated arm."""
    last = report.models[-1]
    validation = (
        ""
        if last.fresh is None
        else f" {last.fresh.position_m.size} others: {last.fresh.rms_m * 1e3:.3f} mm."
    )
    return [
        f"{report.arm.name}, as calibrated by {report.part.count} of {report.poses} measured poses.",
        f"Position error, root mean square: {last.fitted.rms_m * 1e3:.3f} mm.{validation}",
        f"Terms: {', '.join(last.terms) or 'none'}.",
        *(f"{name} sha256 {digest}" for name, digest in report.digests.items()),
    ]
