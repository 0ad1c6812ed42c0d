"""Report of a calibration: what it shows on the console and on its page, with a plot like paper Figure 7."""

from dataclasses import asdict
from functools import partial
from math import degrees
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import digest
from fsw.kinematics.transforms import Array
from marsarm.calibration.calibrate import Calibration, data_sha256, provenance, rms_m
from marsarm.calibration.execution import FRAME_RANK, MAX_HELD_OUT_RATIO, MAX_SIGMA0, CalibrateReport
from marsarm.calibration.residual_model import residual_model
from marsarm.calibration.verify import PlaceErrors, Verification
from marsarm.render import svg
from marsarm.render.svg import ReportFigure
from simgap.common.console import pluralize
from simgap.common.files import json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin, Requirement
from simgap.common.report import Heading, ReportPage, ReportTable, file_lines, to_json

ROTATION: Final = slice(0, 3)
POSITION: Final = slice(3, 6)
"""Parts of an error screw."""
LEAST_REDUCTION: Final = 5.0
"""Least ratio of the errors before and after: "a factor of five", paper, Figure 7."""
MAX_EARTH_ERROR_M: Final = 5e-3
"""Largest error on Earth: "less than 5mm", paper, verification."""
MAX_MARS_ERROR_M: Final = 20e-3
"""Largest total position error on Mars: paper, positioning requirements."""
SMALL_ERROR_M: Final = MAX_EARTH_ERROR_M / LEAST_REDUCTION
"""Error before, below which nothing needs to fall."""


def calibration_document(report: CalibrateReport) -> dict[str, Any]:
    """Collect the calibration in SI units."""
    found, best = report.found, report.found.best
    frames = found.frame_identifiability
    return {
        "arm": found.campaign.arm_name,
        "poses": found.campaign.count,
        "outliers": found.outliers,
        "data_sha256": data_sha256(found.campaign),
        "params_sha256": digest(report.params),
        "position_error_m": {
            "before": _error_statistics(found.before),
            "after": _error_statistics(found.after[:, best.used]),
            "held_out": _error_statistics(found.held_out_error),
        },
        "sigma0": best.sigma0,
        "p_value": best.p_value,
        "held_out_over_expected": found.hold_out.ratio,
        "rank": {
            "frames": frames.rank,
            "of_frames": len(frames.parameters),
            "all": found.identifiability.rank,
            "of_all": len(best.parameters),
            "condition_frames": frames.condition,
            "singular_values_frames": frames.singular_values,
        },
        "unidentifiable": frames.unidentifiable_groups(),
        "parameters": {
            parameter.name: {"unit": parameter.unit, "value": value, "sigma": sigma}
            for parameter, value, sigma in zip(best.parameters, best.values, best.sigma, strict=True)
        },
        "verification": None if report.verification is None else _verification_document(report.verification),
    }


def _error_statistics(error: Array) -> dict[str, float]:
    length = np.linalg.norm(error[3:], axis=0)
    return {"rms": rms_m(error), "max": float(length.max(initial=0.0))}


def _verification_document(found: Verification) -> dict[str, Any]:
    return {
        "zero_moved_rad": found.zero_rad,
        "zero_expected_rad": found.expected_rad,
        "places": {
            one.name: {key: value for key, value in asdict(one).items() if key != "name"}
            for one in found.places
        },
    }


def calibration_parts(report: CalibrateReport) -> list[str | ReportTable]:
    """Show errors, encoder zeros, unidentifiable parameters and verification."""
    request, found = report.request, report.found
    parts: list[str | ReportTable] = [_summary_table(found), _zero_table(found), *_unidentifiable(found)]
    if report.verification is not None:
        parts.append(_verification_table(report.verification))
    files = {"out": request.out, "save-data": request.save_data, "report": request.report}
    return [*parts, *file_lines(files)]


def _unidentifiable(found: Calibration) -> list[str]:
    """List the groups of parameters that the campaign does not identify."""
    lines = ["Not identifiable from this campaign, kept at nominal values:"]
    for group in found.frame_identifiability.unidentifiable_groups():
        known = (
            f"identified as {pluralize(group.identified, 'combination')}"
            if group.identified
            else "not identified"
        )
        lines.append(f"  {', '.join(group.names)}: {known}")
    return lines


def _summary_table(found: Calibration) -> ReportTable:
    best, frames = found.best, found.frame_identifiability
    errors = {"before": found.before, "after": found.after[:, best.used], "held out": found.held_out_error}
    outliers = ", ".join(map(str, found.outliers)) or "none"
    rows = [("poses", f"{found.campaign.count}; left out as outliers: {outliers}")]
    for name, error in errors.items():
        most_mm = 1e3 * _error_statistics(error)["max"]
        rows.append((f"position error, {name}", f"{1e3 * rms_m(error):.2f} mm rms, {most_mm:.2f} mm at most"))
    rows += [
        ("residuals", f"{best.sigma0:.3f} of the noise, p = {best.p_value:.2g}"),
        ("held-out poses", f"{found.hold_out.ratio:.3f} of the error that noise and covariance predict"),
        ("rank, frames", f"{frames.rank} of 42, condition {frames.condition:.0f}"),
        ("rank, all", f"{found.identifiability.rank} of {len(best.parameters)}"),
    ]
    return ReportTable((), rows, f"Calibration of {found.campaign.arm_name}")


def _zero_table(found: Calibration) -> ReportTable:
    """Show the encoder zeros, which are rotations about z of the frames before the joints."""
    best = found.best
    rows = []
    for joint, of_joint in zip(Joint, found.nominal.joints.in_order(), strict=True):
        k = best.index(f"arm{joint + 1}.rz")
        zero, sigma = best.values[k], best.sigma[k]
        hardstop = f"{degrees(of_joint.hardstop_rad + zero):.4f} deg"
        rows.append((joint.name.lower(), f"{1e3 * zero:+.2f} ± {1e3 * sigma:.2f} mrad", hardstop))
    head = ("joint", "zero (rz of its frame)", "hardstop at")
    return ReportTable(head, rows, "Encoder zeros, as new hardstop angles")


def _verification_table(found: Verification) -> ReportTable:
    rows = [
        (
            place.name,
            f"{1e3 * place.rms_m:.2f} mm",
            f"{1e3 * place.max_m:.2f} mm",
            f"{1e3 * place.max_lateral_m:.2f} mm",
            f"{degrees(place.max_axis_rad):.3f} deg",
        )
        for place in found.places
    ]
    difference = 1e3 * np.abs(found.zero_rad - found.expected_rad).max()
    title = f"Fresh targets, full turret; new hardstops within {difference:.3f} mrad of the parameters"
    return ReportTable(("", "rms", "largest", "lateral", "axis"), rows, title)


def calibration_requirements(report: CalibrateReport) -> list[Requirement]:
    """List the requirements of a calibration: those of the paper, and those without which it is refused."""
    found, best = report.found, report.found.best
    held = found.held_out_error
    before_m, after_m = rms_m(found.before[:, found.held_out_poses]), rms_m(held)
    largest_m = _error_statistics(held)["max"]
    rank = found.frame_identifiability.rank
    rows = [
        Requirement(
            "held-out position error, rms, before over after: at least",
            f"{LEAST_REDUCTION:.1f}",
            f"{before_m / after_m:.1f}",
            None if before_m < SMALL_ERROR_M else before_m >= LEAST_REDUCTION * after_m,
        ),
        Requirement(
            "largest held-out position error",
            f"{1e3 * MAX_EARTH_ERROR_M:.0f} mm",
            f"{1e3 * largest_m:.2f} mm",
            largest_m < MAX_EARTH_ERROR_M,
        ),
        Requirement(
            "residuals over the noise", f"{MAX_SIGMA0}", f"{best.sigma0:.3f}", best.sigma0 <= MAX_SIGMA0
        ),
        Requirement(
            "held-out residuals over the expected",
            f"{MAX_HELD_OUT_RATIO}",
            f"{found.hold_out.ratio:.3f}",
            found.hold_out.ratio <= MAX_HELD_OUT_RATIO,
        ),
        Requirement("rank of the frame parameters: at least", f"{FRAME_RANK}", f"{rank}", rank >= FRAME_RANK),
    ]
    if report.verification is None:
        return [*rows, Requirement("tool error at new targets, which --verify N measures", "-", "-", None)]
    return [*rows, *(_place_requirement(place) for place in report.verification.places)]


def _place_requirement(place: PlaceErrors) -> Requirement:
    bound_m = MAX_EARTH_ERROR_M if place.name == "earth" else MAX_MARS_ERROR_M
    text = f"largest tool error at new targets, {place.name}"
    return Requirement(text, f"{1e3 * bound_m:.0f} mm", f"{1e3 * place.max_m:.2f} mm", place.max_m < bound_m)


def calibration_page(report: CalibrateReport) -> ReportPage:
    """Show the summary, the errors pose by pose, the encoder zeros and what is identifiable."""
    found = report.found
    parts: list[str | Heading | ReportTable | tuple[ReportFigure, ...]] = [
        Heading("Summary"),
        _summary_table(found),
        Heading("Pose by pose"),
        "Shaded: shoulder-in poses. Crosses: calibrated parameters, but every output always on one side "
        "of its backlash, as if the backlash state were not known.",
        (
            ReportFigure("position errors", 3.6, partial(_draw_errors, found=found, part=POSITION)),
            ReportFigure("rotation errors", 3.6, partial(_draw_errors, found=found, part=ROTATION)),
        ),
        Heading("Encoder zeros"),
        _zero_table(found),
        Heading("Identifiability of the 42 frame parameters"),
        (ReportFigure("singular values", 2.8, partial(_draw_singular_values, found=found)),),
        *_unidentifiable(found),
    ]
    if report.verification is not None:
        parts += [Heading("Fresh targets, full turret"), _verification_table(report.verification)]
    parts += [Heading("Provenance"), *provenance(found)]
    digests = {
        "poses": data_sha256(found.campaign),
        "parameters before": digest(found.nominal),
        "parameters after": digest(report.params),
        "result": json_sha256(to_json(calibration_document(report))),
    }
    origin = Origin(command_text("marsarm calibrate", report.request), digests)
    title = f"Calibration of {found.campaign.arm_name}"
    return ReportPage(title, calibration_requirements(report), origin, parts)


def _draw_errors(figure: Any, found: Calibration, part: slice) -> None:
    axes = figure.subplots()
    stateless = residual_model(found.nominal, found.campaign, with_backlash=False)
    series = (
        ("uncalibrated", found.before, svg.RED, "o"),
        ("calibrated, backlash state left out", stateless.errors(found.best.values), svg.MUTED, "x"),
        ("calibrated", found.after, svg.BLUE, "."),
    )
    for name, error, colour, marker in series:
        axes.plot(_lengths(error, part), marker, color=colour, label=name, markersize=3)
    _shade(axes, found)
    unknown = np.flatnonzero(found.unknown.any(axis=0))
    name = "calibrated, side of a backlash unknown"
    after = _lengths(found.after, part)
    axes.plot(unknown, after[unknown], "o", color=svg.BLUE, fillstyle="none", label=name, markersize=5)
    out = np.flatnonzero(~found.best.used)
    if out.size:
        axes.plot(out, after[out], "o", color=svg.INK, fillstyle="none", label="outlier")
    label = "position [mm]" if part == POSITION else "rotation [mrad]"
    axes.set(xlabel="pose, in the order in which they were taken", ylabel=label, ylim=(0, None))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2, fontsize=8)


def _lengths(error: Array, part: slice) -> Array:
    """Compute the length of a part of each error, in mm or mrad."""
    return np.asarray(1e3 * np.linalg.norm(error[part], axis=0))


def _shade(axes: Any, found: Calibration) -> None:
    for k, branch in enumerate(found.campaign.branch):
        if branch.startswith("shoulder-in"):
            axes.axvspan(k - 0.5, k + 0.5, color=svg.SHADE, linewidth=0, zorder=0)
    for last in np.flatnonzero(np.diff(found.campaign.group)):
        axes.axvline(last + 0.5, color=svg.FAINT, linewidth=0.8, zorder=0)


def _draw_singular_values(figure: Any, found: Calibration) -> None:
    axes, values = figure.subplots(), found.frame_identifiability.singular_values
    rank = found.frame_identifiability.rank
    shown = np.maximum(values, 1e-3)
    axes.semilogy(np.arange(1, rank + 1), shown[:rank], "o", color=svg.BLUE, label="identified")
    axes.semilogy(
        np.arange(rank + 1, values.size + 1), shown[rank:], "o", color=svg.RED, label="not identified"
    )
    axes.axvline(rank + 0.5, color=svg.FAINT, linewidth=0.8)
    axes.set(xlabel=f"combination; {rank} of {values.size} are identified", ylabel="sigmas per scale")
    axes.legend()
