"""A calibrated serial arm as tables for people and as a document for programs."""

from typing import Any, Final

from rich.table import Table

from ground.calibration.serial.amounts import joint_errors, moved_m
from ground.calibration.serial.arm import SIX
from ground.calibration.serial.ladder import Step
from ground.calibration.serial.model import GEOMETRY
from ground.calibration.serial.request import SerialReport
from ground.calibration.serial.temperature import TemperatureTest
from ground.render.console import plain_console

MISSING: Final = 1.5
"""Times the noise that the file says: more is not noise."""


def serial_json(report: SerialReport, picture_lacks: str | None) -> dict[str, Any]:
    """The calibration as a JSON document; metres and radians."""
    last = report.steps[-1]
    fit = last.found.fit
    return {
        "arm": report.arm.name,
        "poses": report.poses,
        "fitted_poses": report.part.count,
        "terms": list(last.terms),
        "steps": [_step_json(step) for step in report.steps],
        "held_out_rms_m": None if last.fresh is None else last.fresh.rms_m,
        "held_out_rms_rad": None if last.fresh is None else last.fresh.rms_rad,
        "held_out_over_expected": report.ratio,
        "fit": {
            "parameters": len(fit.parameters),
            "rank": report.seen.rank,
            "condition": report.seen.condition if report.seen.rank else None,
            "converged": fit.converged,
            "passes": fit.passes,
            "sigma0": fit.sigma0,
            "outlier_rows": list(last.found.outliers),
            "not_told_apart": [
                {"names": list(group.names), "seen": group.seen} for group in report.seen.confused()
            ],
        },
        "moves_target_m": moved_m(last.found),
        "joints": [
            {
                "name": one.name,
                "compliance_rad_per_Nm": one.compliance_rad_per_Nm,
                "compliance_sigma": one.compliance_sigma,
                "approach_rad": one.approach_rad,
                "approach_sigma": one.approach_sigma,
                "waves_rms_rad": one.rms_rad,
                "waves_peak_rad": one.peak_rad,
            }
            for one in joint_errors(last.found)
        ],
        "links": _links_json(report),
        "temperature": _temperature_json(report.temperature),
        "sha256": report.digests,
        "picture_lacks": picture_lacks,
    }


def _step_json(step: Step) -> dict[str, Any]:
    is_first = step.gain_sigma_m == 0.0
    return {
        "terms": list(step.terms),
        "fitted_rms_m": step.fitted.rms_m,
        "cross_validated_rms_m": step.held_out.rms_m,
        "gain_m": None if is_first else step.gain_m,
        "gain_sigma_m": None if is_first else step.gain_sigma_m,
        "worth_it": step.is_worth_it,
        "held_out_rms_m": None if step.fresh is None else step.fresh.rms_m,
        "held_out_max_m": None if step.fresh is None else float(step.fresh.position_m.max()),
        "held_out_rms_rad": None if step.fresh is None else step.fresh.rms_rad,
    }


def _links_json(report: SerialReport) -> list[dict[str, Any]]:
    """By how much each number differs from the file's, and how well that is known."""
    fit = report.steps[-1].found.fit
    if GEOMETRY not in report.steps[-1].terms:
        return []
    names = {parameter.name: k for k, parameter in enumerate(fit.parameters)}
    sigma = fit.sigma
    return [
        {
            "name": one.name,
            **{
                number: {
                    "differs": float(fit.values[names[f"{one.name}.{number}"]]),
                    "sigma": float(sigma[names[f"{one.name}.{number}"]]),
                }
                for number in SIX
            },
        }
        for one in report.arm.links
    ]


def _temperature_json(test: TemperatureTest | None) -> dict[str, Any] | None:
    if test is None:
        return None
    return {
        "explains": "something" if test.explains else "nothing",
        "range_K": test.range_K,
        "cross_validated_rms_without_m": test.without_m,
        "cross_validated_rms_with_m": test.with_m,
        "gain_m": test.gain_m,
        "gain_sigma_m": test.gain_sigma_m,
        "best_placebo": test.placebo,
        "best_placebo_gain_m": test.placebo_gain_m,
    }


def serial_table(report: SerialReport, picture_lacks: str | None) -> None:
    """Print what each term explains, what the joints err by, and what is left."""
    console = plain_console()
    console.print(_steps(report))
    last = report.steps[-1]
    if set(last.terms) - {GEOMETRY}:
        console.print(_joints(report))
    fit = last.found.fit
    console.print(
        f"{len(fit.parameters)} parameters; the poses tell {report.seen.rank} combinations of them; "
        f"{_noise_words(fit.sigma0)}"
    )
    rows = ", ".join(map(str, last.found.outliers))
    console.print(f"left out, for they agree with no other: {f'rows {rows}' if rows else 'no pose'}")
    if report.temperature is not None:
        console.print(temperature_words(report.temperature))
    if report.request.out is not None:
        console.print(f"arm  {report.request.out}")
    if report.request.picture is not None:
        console.print(f"picture  {picture_lacks or report.request.picture}")


def _noise_words(sigma0: float) -> str:
    said = f"noise is {sigma0:.2f} of what the file says"
    return said if sigma0 < MISSING else f"{said}: the arm has errors that none of these terms explains"


def _steps(report: SerialReport) -> Table:
    poses = f"{report.part.count} poses fitted, {report.poses - report.part.count} held out"
    table = Table(title=f"{report.arm.name}: position error, rms [mm]; {poses}", title_justify="left")
    table.add_column("with")
    for name in ("fitted", "validated", "less by", "+-", "held out", "largest"):
        table.add_column(name, justify="right")
    for k, step in enumerate(report.steps):
        before = report.steps[k - 1].terms if k else ()
        new = ", ".join(step.terms[len(before) :]) if k else "base, target"
        fell = (step.gain_m, step.gain_sigma_m) if k else ()
        fresh = () if step.fresh is None else (step.fresh.rms_m, step.fresh.position_m.max())
        cells = [_mm(step.fitted.rms_m, step.held_out.rms_m), _mm(*fell) or ["", ""], _mm(*fresh)]
        table.add_row(("+ " if k else "") + new, *(cell for group in cells for cell in group))
    return table


def _mm(*lengths_m: float) -> list[str]:
    return [f"{length * 1e3:.3f}" for length in lengths_m]


def _joints(report: SerialReport) -> Table:
    table = Table(title="How the joints err: urad/Nm, urad, mrad, mrad", title_justify="left")
    table.add_column("joint")
    for name in ("compliance", "+-", "approach", "+-", "waves", "largest"):
        table.add_column(name, justify="right")
    for one in joint_errors(report.steps[-1].found):
        micro = (one.compliance_rad_per_Nm, one.compliance_sigma, one.approach_rad, one.approach_sigma)
        cells = [f"{value * 1e6:.1f}" for value in micro]
        table.add_row(one.name, *cells, f"{one.rms_rad * 1e3:.2f}", f"{one.peak_rad * 1e3:.2f}")
    return table


def temperature_words(test: TemperatureTest) -> str:
    """What the air's temperature explains."""
    moved = f"the air's temperature, which moves by {test.range_K:.2f} K"
    gain_um, sigma_um, placebo_um = (
        length * 1e6 for length in (test.gain_m, test.gain_sigma_m, test.placebo_gain_m)
    )
    fell = f"the validated error falls by {gain_um:.1f} +- {sigma_um:.1f} um"
    if test.explains:
        return f"{moved}, explains something: {fell}, more than by any curve that is not the temperature"
    if test.range_K == 0.0:
        return f"{moved}, explains nothing"
    best = f"by {placebo_um:.1f} um with a curve that is not the temperature ({test.placebo})"
    return f"{moved}, explains nothing: {fell}; {best}"
