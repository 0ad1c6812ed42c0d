"""Report of a calibration: JSON document, tables, and a page with a plot like paper Figure 7."""

from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from fsw.config import digest
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from ground.calibration.arm_model import arm_model
from ground.calibration.calibrate import Calibration, rms_m
from ground.calibration.execution import CalibrateReport
from ground.calibration.identifiability import UnidentifiableGroup
from ground.calibration.parameter_file import data_sha256, provenance
from ground.calibration.verify import PlaceErrors, Verification
from ground.render.console import plain_console, pluralize
from ground.render.figures import render_png
from ground.render.page import heading, image, paragraph, save_page, table


def calibration_json(report: CalibrateReport) -> dict[str, Any]:
    """Convert the calibration to a JSON document in SI units."""
    found = report.found
    best = found.best
    return {
        "arm": found.campaign.arm_name,
        "poses": found.campaign.count,
        "outliers": list(found.rejection.outliers),
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
            "frames": found.frame_identifiability.rank,
            "of_frames": len(found.frame_identifiability.parameters),
            "all": found.identifiability.rank,
            "of_all": len(best.parameters),
            "condition_frames": found.frame_identifiability.condition,
            "singular_values_frames": found.frame_identifiability.singular_values.tolist(),
        },
        "unidentifiable": [
            {"names": list(group.names), "identified": group.identified}
            for group in found.frame_identifiability.unidentifiable_groups()
        ],
        "parameters": {
            parameter.name: {"unit": parameter.unit, "value": value, "sigma": sigma}
            for parameter, value, sigma in zip(
                best.parameters, best.values.tolist(), best.sigma.tolist(), strict=True
            )
        },
        "verification": None if report.verification is None else _verification_json(report.verification),
    }


def _error_statistics(error: Array) -> dict[str, float]:
    length = np.linalg.norm(error[3:], axis=0)
    return {"rms": rms_m(error), "max": float(length.max(initial=0.0))}


def _verification_json(found: Verification) -> dict[str, Any]:
    return {
        "zero_moved_rad": found.zero_rad.tolist(),
        "zero_expected_rad": found.expected_rad.tolist(),
        "places": {
            place.name: {
                "rms_m": float(np.sqrt(np.mean(place.total_m**2))),
                "max_m": float(place.total_m.max()),
                "max_lateral_m": float(place.lateral_m.max()),
                "max_axis_rad": float(place.axis_rad.max()),
            }
            for place in found.places
        },
    }


def calibration_table(report: CalibrateReport) -> None:
    """Print the calibration: errors, encoder zeros, unidentifiable parameters and verification."""
    console = plain_console()
    found = report.found
    console.print(_summary_table(found))
    console.print(_zero_table(found))
    console.print("Not identifiable from this campaign, kept at nominal values:")
    for group in found.frame_identifiability.unidentifiable_groups():
        console.print(f"  {describe_group(group)}")
    if report.verification is not None:
        console.print(_verification_table(report.verification))
    for name in ("out", "save_data", "report"):
        path = getattr(report.request, name)
        if path is not None:
            console.print(f"{name.replace('_', '-'):<9} {path}")


def describe_group(group: UnidentifiableGroup) -> str:
    """Describe a group of unidentifiable parameters."""
    names = ", ".join(group.names)
    if group.identified == 0:
        return f"{names}: not identified"
    return f"{names}: identified as {pluralize(group.identified, 'combination')}"


def summary_rows(found: Calibration) -> list[tuple[str, str]]:
    """Build the rows of the summary."""
    best = found.best
    errors = (
        ("before", found.before),
        ("after", found.after[:, best.used]),
        ("held out", found.held_out_error),
    )
    outliers = ", ".join(map(str, found.rejection.outliers)) or "none"
    return [
        ("poses", f"{found.campaign.count}; left out as outliers: {outliers}"),
        *(
            (
                f"position error, {name}",
                f"{1e3 * rms_m(e):.2f} mm rms, {1e3 * _error_statistics(e)['max']:.2f} mm at most",
            )
            for name, e in errors
        ),
        ("residuals", f"{best.sigma0:.3f} of the noise, p = {best.p_value:.2g}"),
        ("held-out poses", f"{found.hold_out.ratio:.3f} of the error that noise and covariance predict"),
        (
            "rank, frames",
            (
                f"{found.frame_identifiability.rank} of 42, condition "
                f"{found.frame_identifiability.condition:.0f}"
            ),
        ),
        ("rank, all", f"{found.identifiability.rank} of {len(best.parameters)}"),
    ]


def _summary_table(found: Calibration) -> Table:
    table = Table(title=f"Calibration of {found.campaign.arm_name}", title_justify="left", show_header=False)
    for row in summary_rows(found):
        table.add_row(*row)
    return table


def zero_rows(found: Calibration) -> list[tuple[str, str, str]]:
    """Build the rows of encoder zeros, which are rotations about z of the frames before the joints."""
    best = found.best
    rows = []
    for joint, of_joint in zip(Joint, found.nominal.joints.in_order(), strict=True):
        k = best.index(f"arm{joint + 1}.rz")
        zero, sigma = best.values[k], best.sigma[k]
        hardstop = f"{degrees(of_joint.hardstop_rad + zero):.4f} deg"
        rows.append((joint.name.lower(), f"{1e3 * zero:+.2f} ± {1e3 * sigma:.2f} mrad", hardstop))
    return rows


def _zero_table(found: Calibration) -> Table:
    table = Table(title="Encoder zeros, as new hardstop angles", title_justify="left")
    for name in ("joint", "zero (rz of its frame)", "hardstop at"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for row in zero_rows(found):
        table.add_row(*row)
    return table


def place_rows(found: Verification) -> list[tuple[str, str, str, str, str]]:
    """Build the rows of tool errors at fresh targets."""
    return [_place_row(place) for place in found.places]


def _place_row(place: PlaceErrors) -> tuple[str, str, str, str, str]:
    rms = 1e3 * float(np.sqrt(np.mean(place.total_m**2)))
    return (
        place.name,
        f"{rms:.2f} mm",
        f"{1e3 * place.total_m.max():.2f} mm",
        f"{1e3 * place.lateral_m.max():.2f} mm",
        f"{degrees(float(place.axis_rad.max())):.3f} deg",
    )


def _verification_table(found: Verification) -> Table:
    difference = 1e3 * np.abs(found.zero_rad - found.expected_rad).max()
    title = f"Fresh targets, full turret; new hardstops within {difference:.3f} mrad of the parameters"
    table = Table(title=title, title_justify="left")
    for name in ("", "rms", "largest", "lateral", "axis"):
        table.add_column(name, justify="right" if name else "left")
    for row in place_rows(found):
        table.add_row(*row)
    return table


def save_calibration_page(report: CalibrateReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: The file cannot be written.
    """
    found = report.found
    groups = [describe_group(group) for group in found.frame_identifiability.unidentifiable_groups()]
    parts = [
        table(("", ""), summary_rows(found)),
        heading("Pose by pose"),
        paragraph(
            "Shaded: shoulder-in poses. Grey: calibrated parameters, but every output always on one side of "
            "its backlash, as if the backlash state were not known."
        ),
        image(
            render_png((12, 7), 110, lambda figure: _draw_errors(figure, found)), "errors before and after"
        ),
        heading("Encoder zeros"),
        table(("joint", "zero (rz of its frame)", "hardstop at"), zero_rows(found)),
        heading("Identifiability of the 42 frame parameters"),
        image(
            render_png((12, 3.2), 110, lambda figure: _draw_singular_values(figure, found)), "singular values"
        ),
        paragraph("Not identifiable from this campaign, kept at nominal values:"),
        *(paragraph(one) for one in groups),
    ]
    if report.verification is not None:
        head = ("", "rms", "largest", "lateral", "axis")
        parts += [heading("Fresh targets, full turret"), table(head, place_rows(report.verification))]
    parts += [heading("Provenance"), *(paragraph(line) for line in provenance(found))]
    save_page(f"Calibration of {found.campaign.arm_name}", parts, path)


def errors_without_backlash(found: Calibration) -> Array:
    """Compute the errors with calibrated parameters, but without the state of the backlash.

    Args:
        found: Calibration.

    Returns:
        Error screws, rotation [rad] above translation [m], shape (6, n).
    """
    model = arm_model(found.nominal, found.campaign, with_backlash=False)
    return model.errors(found.best.values)


def _draw_errors(figure: Any, found: Calibration) -> None:
    position_axes, rotation_axes = figure.subplots(2, 1, sharex=True)
    series = (
        ("uncalibrated", found.before, "tab:red", "o"),
        ("calibrated, backlash state left out", errors_without_backlash(found), "0.55", "x"),
        ("calibrated", found.after, "tab:blue", "."),
    )
    for axes, part, label in (
        (position_axes, slice(3, 6), "position [mm]"),
        (rotation_axes, slice(0, 3), "rotation [mrad]"),
    ):
        for name, error, colour, marker in series:
            size = 1e3 * np.linalg.norm(error[part], axis=0)
            axes.plot(size, marker, color=colour, label=name, markersize=4)
        _shade(axes, found)
        axes.set(ylabel=label, ylim=(0, None))
        unknown = np.flatnonzero(found.unknown.any(axis=0))
        off = 1e3 * np.linalg.norm(found.after[part][:, unknown], axis=0)
        name = "calibrated, side of a backlash unknown"
        axes.plot(unknown, off, "o", color="tab:blue", fillstyle="none", label=name, markersize=6)
    out = np.flatnonzero(~found.best.used)
    if out.size:
        left_out = 1e3 * np.linalg.norm(found.after[3:, out], axis=0)
        position_axes.plot(out, left_out, "ko", fillstyle="none", label="outlier")
    position_axes.legend(fontsize=8, ncols=3, loc="upper left")
    rotation_axes.set(xlabel="pose, in the order in which they were taken")


def _shade(axes: Any, found: Calibration) -> None:
    for k, branch in enumerate(found.campaign.branch):
        if branch.startswith("shoulder-in"):
            axes.axvspan(k - 0.5, k + 0.5, color="0.92", linewidth=0)
    for last in np.flatnonzero(np.diff(found.campaign.group)):
        axes.axvline(last + 0.5, color="0.7", linewidth=0.8)


def _draw_singular_values(figure: Any, found: Calibration) -> None:
    axes, values = figure.subplots(), found.frame_identifiability.singular_values
    rank = found.frame_identifiability.rank
    shown = np.maximum(values, 1e-3)
    axes.semilogy(np.arange(1, rank + 1), shown[:rank], "o", color="tab:blue", label="identified")
    axes.semilogy(
        np.arange(rank + 1, values.size + 1), shown[rank:], "o", color="tab:red", label="not identified"
    )
    axes.axvline(rank + 0.5, color="0.7", linewidth=0.8)
    axes.set(xlabel=f"combination; {rank} of {values.size} are identified", ylabel="sigmas per scale")
    axes.legend(fontsize=8)
