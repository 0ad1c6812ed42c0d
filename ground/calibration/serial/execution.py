"""Execution of a calibration of a serial arm: read the files, fit, validate, write the fitted arm."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from diagnosis.serial_arm.arm import SerialArm
from diagnosis.serial_arm.arm_file import arm_from_toml, arm_to_toml, unknown_words
from diagnosis.serial_arm.calibrate import held_out_ratio
from diagnosis.serial_arm.identifiability import Identifiability, assess_identifiability
from diagnosis.serial_arm.initial_setup import estimate_setup
from diagnosis.serial_arm.model import TERMS
from diagnosis.serial_arm.nested_models import NestedModel, fit_nested_models
from diagnosis.serial_arm.series import PoseSeries
from diagnosis.serial_arm.temperature import TemperatureTest, temperature_test
from diagnosis.serial_arm.tracker_table import mapping_from_toml, series_from_table, sha256
from ground.calibration.request import SerialRequest
from ground.common.errors import BadRequest
from ground.common.files import atomic_write
from ground.common.options import check_options
from ground.common.progress import Progress, no_progress
from ground.telemetry.imports.files import MAX_TABLE_BYTES, read_file
from ground.telemetry.imports.mapping_file import MAX_MAPPING_BYTES
from sim.text_file import UnreadableText, decode_text

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
        BadRequest: A file is wrong, or its poses do not determine the parameters; nothing was written.
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
    data = {
        "arm": read_file(request.arm, MAX_MAPPING_BYTES),
        "mapping": read_file(request.mapping, MAX_MAPPING_BYTES),
        "table": read_file(request.table, MAX_TABLE_BYTES),
    }
    arm = arm_from_toml(_text(data["arm"], request.arm), str(request.arm))
    mapping = mapping_from_toml(_text(data["mapping"], request.mapping), str(request.mapping))
    columns, joints = len(mapping.joints.columns), len(arm.links)
    if columns != joints:
        raise BadRequest(
            f"{request.mapping}: joints: {columns} columns; the arm {arm.name} has {joints} joints"
        )
    if mapping.arm != arm.name:
        raise BadRequest(
            f"{request.mapping}: its table is of the arm {mapping.arm!r}, {request.arm} describes "
            f"{arm.name!r}; give the files of one arm"
        )
    series = series_from_table(data["table"], str(request.table), mapping)
    return arm, series, {name: sha256(one) for name, one in data.items()}


def _text(data: bytes, file: Path) -> str:
    try:
        return decode_text(data)
    except UnreadableText as error:
        raise BadRequest(f"{file}: {error}") from error


def _parse_terms(text: str) -> tuple[str, ...]:
    if text in (ALL, NONE):
        return TERMS if text == ALL else ()
    words = [word.strip() for word in text.split(",")]
    wrong = unknown_words(words, (*TERMS, ALL, NONE), "terms")
    if wrong is not None or ALL in words or NONE in words:
        raise BadRequest(wrong or f"terms: {text!r}: {ALL} and {NONE} stand alone")
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
