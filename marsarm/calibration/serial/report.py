"""Report of a calibrated serial arm: JSON document, tables, and a plot of residuals and joint errors."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.table import Table

from marsarm.calibration.serial.execution import SerialReport
from simgap.common.console import plain_console
from simgap.common.figures import save_figure
from simgap.serial_arm.calibrate import contributions_m, joint_errors, periodic_error_rad
from simgap.serial_arm.model import GEOMETRY, GEOMETRY_NAMES, NON_PERIODIC, PERIODIC
from simgap.serial_arm.nested_models import NestedModel, TemperatureTest

MAX_NOISE_RATIO: Final = 1.5
"""Largest ratio of residuals to the noise of the file; above it, the model lacks an effect."""
BLUE: Final = "#31688e"
COLOURS: Final = ("0.7", "#d95f02", BLUE)
MAX_SPACING_RAD: Final = 0.03
"""Largest distance of two measured joint angles between which the curve is drawn."""
COLUMNS: Final = 3


def serial_json(report: SerialReport, picture_problem: str | None) -> dict[str, Any]:
    """Convert the calibration to a JSON document in metres and radians."""
    last = report.models[-1]
    fit = last.found.fit
    return {
        "arm": report.arm.name,
        "poses": report.poses,
        "fitted_poses": report.part.count,
        "terms": list(last.terms),
        "models": [_step_json(step) for step in report.models],
        "held_out_rms_m": None if last.fresh is None else last.fresh.rms_m,
        "held_out_rms_rad": None if last.fresh is None else last.fresh.rms_rad,
        "held_out_over_expected": report.ratio,
        "fit": {
            "parameters": len(fit.parameters),
            "rank": report.identifiability.rank,
            "condition": report.identifiability.condition if report.identifiability.rank else None,
            "converged": fit.converged,
            "iterations": fit.iterations,
            "sigma0": fit.sigma0,
            "outlier_rows": list(last.found.outliers),
            "unidentifiable": [
                {"names": list(group.names), "identified": group.identified}
                for group in report.identifiability.unidentifiable_groups()
            ],
        },
        "contributions_m": contributions_m(last.found),
        "joints": [
            {
                "name": one.name,
                "compliance_rad_per_Nm": one.compliance_rad_per_Nm,
                "compliance_sigma": one.compliance_sigma,
                "hysteresis_rad": one.hysteresis_rad,
                "hysteresis_sigma": one.hysteresis_sigma,
                "periodic_rms_rad": one.rms_rad,
                "periodic_peak_rad": one.peak_rad,
            }
            for one in joint_errors(last.found)
        ],
        "links": _links_json(report),
        "temperature": _temperature_json(report.temperature),
        "sha256": report.digests,
        "picture_problem": picture_problem,
    }


def _step_json(step: NestedModel) -> dict[str, Any]:
    is_first = step.gain_sigma_m == 0.0
    return {
        "terms": list(step.terms),
        "fitted_rms_m": step.fitted.rms_m,
        "cross_validated_rms_m": step.held_out.rms_m,
        "gain_m": None if is_first else step.gain_m,
        "gain_sigma_m": None if is_first else step.gain_sigma_m,
        "significant": step.is_significant,
        "held_out_rms_m": None if step.fresh is None else step.fresh.rms_m,
        "held_out_max_m": None if step.fresh is None else float(step.fresh.position_m.max()),
        "held_out_rms_rad": None if step.fresh is None else step.fresh.rms_rad,
    }


def _links_json(report: SerialReport) -> list[dict[str, Any]]:
    """List the difference of each link parameter from the file, with its sigma."""
    fit = report.models[-1].found.fit
    if GEOMETRY not in report.models[-1].terms:
        return []
    names = {parameter.name: k for k, parameter in enumerate(fit.parameters)}
    sigma = fit.sigma
    return [
        {
            "name": one.name,
            **{
                number: {
                    "difference": float(fit.values[names[f"{one.name}.{number}"]]),
                    "sigma": float(sigma[names[f"{one.name}.{number}"]]),
                }
                for number in GEOMETRY_NAMES
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


def serial_table(report: SerialReport, picture_problem: str | None) -> None:
    """Print the gain of each term, the errors of the joints, and the remaining errors."""
    console = plain_console()
    console.print(_steps(report))
    last = report.models[-1]
    if set(last.terms) - {GEOMETRY}:
        console.print(_joints(report))
    fit = last.found.fit
    console.print(
        f"{len(fit.parameters)} parameters; the poses identify "
        f"{report.identifiability.rank} combinations of them; {_noise_words(fit.sigma0)}"
    )
    rows = ", ".join(map(str, last.found.outliers))
    console.print(f"left out as outliers: {f'rows {rows}' if rows else 'no pose'}")
    if report.temperature is not None:
        console.print(temperature_words(report.temperature))
    if report.request.out is not None:
        console.print(f"arm  {report.request.out}")
    if report.request.picture is not None:
        console.print(f"picture  {picture_problem or report.request.picture}")


def _noise_words(sigma0: float) -> str:
    text = f"noise is {sigma0:.2f} of what the file says"
    return (
        text if sigma0 < MAX_NOISE_RATIO else f"{text}: the arm has errors that none of these terms explains"
    )


def _steps(report: SerialReport) -> Table:
    poses = f"{report.part.count} poses fitted, {report.poses - report.part.count} held out"
    table = Table(title=f"{report.arm.name}: position error, rms [mm]; {poses}", title_justify="left")
    table.add_column("with")
    for name in ("fitted", "validated", "less by", "+-", "held out", "largest"):
        table.add_column(name, justify="right")
    for k, step in enumerate(report.models):
        before = report.models[k - 1].terms if k else ()
        new = ", ".join(step.terms[len(before) :]) if k else "base, target"
        gain = (step.gain_m, step.gain_sigma_m) if k else ()
        fresh = () if step.fresh is None else (step.fresh.rms_m, step.fresh.position_m.max())
        cells = [_mm(step.fitted.rms_m, step.held_out.rms_m), _mm(*gain) or ["", ""], _mm(*fresh)]
        table.add_row(("+ " if k else "") + new, *(cell for group in cells for cell in group))
    return table


def _mm(*lengths_m: float) -> list[str]:
    return [f"{length * 1e3:.3f}" for length in lengths_m]


def _joints(report: SerialReport) -> Table:
    table = Table(title="Joint errors: urad/Nm, urad, mrad, mrad", title_justify="left")
    table.add_column("joint")
    for name in ("compliance", "+-", "hysteresis", "+-", "periodic", "largest"):
        table.add_column(name, justify="right")
    for one in joint_errors(report.models[-1].found):
        micro = (one.compliance_rad_per_Nm, one.compliance_sigma, one.hysteresis_rad, one.hysteresis_sigma)
        cells = [f"{value * 1e6:.1f}" for value in micro]
        table.add_row(one.name, *cells, f"{one.rms_rad * 1e3:.2f}", f"{one.peak_rad * 1e3:.2f}")
    return table


def temperature_words(test: TemperatureTest) -> str:
    """Describe the effect of the air temperature."""
    moved = f"the air's temperature, which moves by {test.range_K:.2f} K"
    gain_um, sigma_um, placebo_um = (
        length * 1e6 for length in (test.gain_m, test.gain_sigma_m, test.placebo_gain_m)
    )
    gain = f"the validated error falls by {gain_um:.1f} +- {sigma_um:.1f} um"
    if test.explains:
        return f"{moved}, explains something: {gain}, more than by any curve that is not the temperature"
    if test.range_K == 0.0:
        return f"{moved}, explains nothing"
    best = f"by {placebo_um:.1f} um with a curve that is not the temperature ({test.placebo})"
    return f"{moved}, explains nothing: {gain}; {best}"


def save_serial_figure(report: SerialReport, path: Path) -> str | None:
    """Save the plot as PNG.

    Returns:
        The reason if matplotlib is not installed, else None.

    Raises:
        BadOutput: The file cannot be written.
    """
    joints = len(report.arm.links) if PERIODIC in report.models[-1].terms else 0
    rows = -(-joints // COLUMNS)

    def draw(figure: Any) -> None:
        grid = figure.add_gridspec(1 + rows, COLUMNS, height_ratios=[1.6, *[1.0] * rows])
        _draw_errors(figure.add_subplot(grid[0, :]), report)
        for k in range(joints):
            _draw_joint(figure.add_subplot(grid[1 + k // COLUMNS, k % COLUMNS]), report, k)

    return save_figure(path, (12.0, 4.0 + 2.4 * rows), 100, draw)


def _draw_errors(axes: Any, report: SerialReport) -> None:
    count = report.part.count
    for step, colour in zip(_selected_steps(report), COLOURS, strict=False):
        axes.plot(_errors_mm(step), ".", markersize=2, color=colour, label=_label(step))
    axes.axvline(count, color="black", linewidth=1)
    axes.text(count, 0.02, " held out", transform=axes.get_xaxis_transform())
    axes.text(count, 0.02, "fitted ", transform=axes.get_xaxis_transform(), ha="right")
    axes.set(xlabel="pose, in order of time", ylabel="position error [mm]", yscale="log", ylim=(0.005, 10))
    axes.set_title(f"{report.arm.name}: distance between the measured and the predicted target")
    axes.legend(markerscale=5, loc="upper left", ncols=3, fontsize="small")


def _selected_steps(report: SerialReport) -> list[NestedModel]:
    """Select the first step, the one with the first term, and the last one."""
    steps = report.models
    return [*steps[:2], *steps[2:][-1:]]


def _errors_mm(step: NestedModel) -> Any:
    fresh = [] if step.fresh is None else [step.fresh.position_m]
    return np.concatenate([step.fitted.position_m, *fresh]) * 1e3


def _label(step: NestedModel) -> str:
    text = ", ".join(step.terms) if step.terms else "base and target only"
    shown, where = (step.fitted, "") if step.fresh is None else (step.fresh, ", held out")
    return f"{text}: {shown.rms_m * 1e3:.2f} mm rms{where}"


def _draw_joint(axes: Any, report: SerialReport, k: int) -> None:
    """Draw the periodic error of a joint at the measured angles."""
    found = report.models[-1].found
    one = found.arm.links[k]
    turn = np.mod(report.part.joint_rad[k] + np.pi, 2 * np.pi) - np.pi
    order = np.argsort(turn)
    waves = periodic_error_rad(
        found.model.features[k][:, len(NON_PERIODIC) :], one.periodic_rad(found.model.orders)
    )
    x, y = turn[order], waves[order] * 1e3
    ends = np.flatnonzero(np.diff(x) > MAX_SPACING_RAD) + 1
    for piece in np.split(np.arange(x.size), ends):
        axes.plot(np.degrees(x[piece]), y[piece], color=BLUE, linewidth=1)
    axes.set(title=one.name, xlim=(-180, 180), ylabel="error [mrad]", xlabel="angle [deg]")
    axes.set_xticks(range(-180, 181, 90))
    axes.grid(alpha=0.3)
