"""A calibration, printed for people and as a document for programs."""

from math import degrees
from typing import Any

import numpy as np
from rich.table import Table

from fsw.config import digest
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from ground.calibration.calibrate import Calibration, rms_m
from ground.calibration.parameter_file import data_sha256
from ground.calibration.request import CalibrateReport
from ground.calibration.seen import Confused
from ground.calibration.verify import Place, Verification
from ground.render.console import plain_console
from ground.render.words import counted


def calibration_json(report: CalibrateReport) -> dict[str, Any]:
    """Everything that was found; SI units."""
    found = report.found
    best = found.best
    return {
        "arm": found.campaign.arm_name,
        "poses": found.campaign.count,
        "outliers": list(found.cleaned.outliers),
        "data_sha256": data_sha256(found.campaign),
        "params_sha256": digest(report.params),
        "position_error_m": {
            "before": _errors(found.before),
            "after": _errors(found.after[:, best.used]),
            "held_out": _errors(found.held_out_error),
        },
        "sigma0": best.sigma0,
        "p_value": best.p_value,
        "held_out_over_expected": found.judged.ratio,
        "rank": {
            "frames": found.frames_seen.rank,
            "of_frames": len(found.frames_seen.parameters),
            "all": found.seen.rank,
            "of_all": len(best.parameters),
            "condition_frames": found.frames_seen.condition,
            "singular_values_frames": found.frames_seen.singular_values.tolist(),
        },
        "confused": [
            {"names": list(group.names), "seen": group.seen} for group in found.frames_seen.confused()
        ],
        "parameters": {
            parameter.name: {"unit": parameter.unit, "value": value, "sigma": sigma}
            for parameter, value, sigma in zip(
                best.parameters, best.values.tolist(), best.sigma.tolist(), strict=True
            )
        },
        "verification": None if report.verification is None else _verification_json(report.verification),
    }


def _errors(error: Array) -> dict[str, float]:
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
    """Print what was found, what could not be, and what it is good for."""
    console = plain_console()
    found = report.found
    console.print(_summary(found))
    console.print(_zeros(found))
    console.print("Told apart by no pose of this campaign, and left by the drawing:")
    for group in found.frames_seen.confused():
        console.print(f"  {confused_words(group)}")
    if report.verification is not None:
        console.print(_verification(report.verification))
    for name in ("out", "save_data", "report"):
        path = getattr(report.request, name)
        if path is not None:
            console.print(f"{name.replace('_', '-'):<9} {path}")


def confused_words(group: Confused) -> str:
    """What cannot be told apart, as one."""
    names = ", ".join(group.names)
    if group.seen == 0:
        return f"{names}: not seen"
    return f"{names}: seen as {counted(group.seen, 'combination')}"


def summary_rows(found: Calibration) -> list[tuple[str, str]]:
    """The calibration in ten lines."""
    best = found.best
    errors = (
        ("before", found.before),
        ("after", found.after[:, best.used]),
        ("held out", found.held_out_error),
    )
    outliers = ", ".join(map(str, found.cleaned.outliers)) or "none"
    return [
        ("poses", f"{found.campaign.count}; left out as outliers: {outliers}"),
        *(
            (
                f"position error, {name}",
                f"{1e3 * rms_m(e):.2f} mm rms, {1e3 * _errors(e)['max']:.2f} mm at most",
            )
            for name, e in errors
        ),
        ("residuals", f"{best.sigma0:.3f} of the noise, p = {best.p_value:.2g}"),
        ("held-out poses", f"{found.judged.ratio:.3f} of what noise and covariance let expect"),
        ("rank, frames", f"{found.frames_seen.rank} of 42, condition {found.frames_seen.condition:.0f}"),
        ("rank, all", f"{found.seen.rank} of {len(best.parameters)}"),
    ]


def _summary(found: Calibration) -> Table:
    table = Table(title=f"Calibration of {found.campaign.arm_name}", title_justify="left", show_header=False)
    for row in summary_rows(found):
        table.add_row(*row)
    return table


def zero_rows(found: Calibration) -> list[tuple[str, str, str]]:
    """Encoder zeros, as the turns about z of the frames before the joints."""
    best = found.best
    rows = []
    for joint, of_joint in zip(Joint, found.nominal.joints.in_order(), strict=True):
        k = best.index(f"arm{joint + 1}.rz")
        zero, sigma = best.values[k], best.sigma[k]
        hardstop = f"{degrees(of_joint.hardstop_rad + zero):.4f} deg"
        rows.append((joint.name.lower(), f"{1e3 * zero:+.2f} ± {1e3 * sigma:.2f} mrad", hardstop))
    return rows


def _zeros(found: Calibration) -> Table:
    table = Table(title="Encoder zeros, as new hardstop angles", title_justify="left")
    for name in ("joint", "zero (rz of its frame)", "hardstop at"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for row in zero_rows(found):
        table.add_row(*row)
    return table


def place_rows(found: Verification) -> list[tuple[str, str, str, str, str]]:
    """What tools missed their targets by."""
    return [_place_row(place) for place in found.places]


def _place_row(place: Place) -> tuple[str, str, str, str, str]:
    rms = 1e3 * float(np.sqrt(np.mean(place.total_m**2)))
    return (
        place.name,
        f"{rms:.2f} mm",
        f"{1e3 * place.total_m.max():.2f} mm",
        f"{1e3 * place.lateral_m.max():.2f} mm",
        f"{degrees(float(place.axis_rad.max())):.3f} deg",
    )


def _verification(found: Verification) -> Table:
    apart = 1e3 * np.abs(found.zero_rad - found.expected_rad).max()
    title = f"Fresh targets, full turret; hardstops anew, within {apart:.3f} mrad of what was written"
    table = Table(title=title, title_justify="left")
    for name in ("", "rms", "largest", "lateral", "axis"):
        table.add_column(name, justify="right" if name else "left")
    for row in place_rows(found):
        table.add_row(*row)
    return table
