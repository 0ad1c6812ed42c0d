"""Calibration by the poses of a tracker: its terms, its JSON document, and its tables."""

from typing import Any

from rich.console import Console
from rich.table import Table

from simgap.common.errors import BadRequest
from simgap.serial_arm.calibrate import contributions_m, held_out_ratio, joint_errors
from simgap.serial_arm.fit import assess_identifiability
from simgap.serial_arm.model import GEOMETRY, GEOMETRY_NAMES, TERMS
from simgap.serial_arm.nested_models import NestedModel, TemperatureTest
from simgap.serial_arm.tracker import TrackerFit


def parse_terms(text: str) -> tuple[str, ...]:
    """Return the terms that a text names, in the order of TERMS.

    Raises:
        BadRequest: a word is not known, or `all` or `none` stands with others.
    """
    if text in ("all", "none"):
        return TERMS if text == "all" else ()
    words = [word.strip() for word in text.split(",")]
    wrong = next((word for word in words if word not in TERMS), None)
    if wrong in ("all", "none"):
        raise BadRequest(f"terms: {text!r}: all and none stand alone")
    if wrong is not None:
        raise BadRequest(f"terms: {wrong!r:.60} is not known; there are {', '.join(TERMS)}, all and none")
    return tuple(term for term in TERMS if term in words)


def calibration_json(fitted: TrackerFit) -> dict[str, Any]:
    """Convert a calibration to a JSON document in metres and radians."""
    last, fit = fitted.models[-1], fitted.found.fit
    seen = assess_identifiability(fit.parameters, fit.at, fit.used)
    return {
        "fitted_poses": fitted.found.model.series.count,
        "terms": list(last.terms),
        "models": [_model_json(one) for one in fitted.models],
        "held_out_rms_m": last.fresh.rms_m,
        "held_out_rms_rad": last.fresh.rms_rad,
        "held_out_over_expected": held_out_ratio(fitted.found, fitted.fresh),
        "fit": {
            "parameters": len(fit.parameters),
            "rank": seen.rank,
            "condition": seen.condition if seen.rank else None,
            "converged": fit.converged,
            "iterations": fit.iterations,
            "sigma0": fit.sigma0,
            "outlier_rows": list(fitted.found.outliers),
            "unidentifiable": [
                {"names": list(group.names), "identified": group.identified}
                for group in seen.unidentifiable_groups()
            ],
        },
        "contributions_m": contributions_m(fitted.found),
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
            for one in joint_errors(fitted.found)
        ],
        "links": _links_json(fitted) if GEOMETRY in last.terms else [],
        "temperature": _temperature_json(fitted.temperature),
    }


def _model_json(model: NestedModel) -> dict[str, Any]:
    is_first = model.gain_sigma_m == 0.0
    return {
        "terms": list(model.terms),
        "fitted_rms_m": model.fitted.rms_m,
        "cross_validated_rms_m": model.held_out.rms_m,
        "gain_m": None if is_first else model.gain_m,
        "gain_sigma_m": None if is_first else model.gain_sigma_m,
        "significant": model.is_significant,
        "held_out_rms_m": model.fresh.rms_m,
        "held_out_max_m": float(model.fresh.position_m.max()),
        "held_out_rms_rad": model.fresh.rms_rad,
    }


def _links_json(fitted: TrackerFit) -> list[dict[str, Any]]:
    """List the difference of each link parameter from the file, with its sigma."""
    fit = fitted.found.fit
    found = {
        one.name: {"difference": float(value), "sigma": float(sigma)}
        for one, value, sigma in zip(fit.parameters, fit.values, fit.sigma, strict=True)
    }
    return [
        {"name": one.name, **{number: found[f"{one.name}.{number}"] for number in GEOMETRY_NAMES}}
        for one in fitted.found.model.arm.links
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


def print_calibration(fitted: TrackerFit, console: Console) -> None:
    """Print the gain of each term, the errors of the joints, and the noise."""
    console.print(_model_table(fitted))
    if set(fitted.models[-1].terms) - {GEOMETRY}:
        console.print(_joint_table(fitted))
    fit = fitted.found.fit
    console.print(f"{len(fit.parameters)} parameters; noise is {fit.sigma0:.2f} of what the file says")


def _model_table(fitted: TrackerFit) -> Table:
    poses = f"{fitted.found.model.series.count} poses fitted, {fitted.fresh.count} held out"
    table = Table(title=f"Position error, rms [mm]; {poses}", title_justify="left", box=None)
    table.add_column("with")
    for name in ("fitted", "validated", "less by", "+-", "held out", "largest"):
        table.add_column(name, justify="right")
    for k, one in enumerate(fitted.models):
        name = f"+ {one.terms[-1]}" if k else "base, target"
        gain = [one.gain_m, one.gain_sigma_m] if k else [None, None]
        lengths_m = [one.fitted.rms_m, one.held_out.rms_m, *gain, one.fresh.rms_m, one.fresh.position_m.max()]
        table.add_row(name, *("" if length is None else f"{length * 1e3:.3f}" for length in lengths_m))
    return table


def _joint_table(fitted: TrackerFit) -> Table:
    table = Table(title="Joint errors: urad/Nm, urad, mrad, mrad", title_justify="left", box=None)
    table.add_column("joint")
    for name in ("compliance", "+-", "hysteresis", "+-", "periodic", "largest"):
        table.add_column(name, justify="right")
    for one in joint_errors(fitted.found):
        micro = (one.compliance_rad_per_Nm, one.compliance_sigma, one.hysteresis_rad, one.hysteresis_sigma)
        cells = [f"{value * 1e6:.1f}" for value in micro]
        table.add_row(one.name, *cells, f"{one.rms_rad * 1e3:.2f}", f"{one.peak_rad * 1e3:.2f}")
    return table
