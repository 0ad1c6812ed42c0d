"""Campaigns of calibrations: as-built arms, and a real one.

As-built arms: accuracy, and coverage of confidence intervals. Each arm is measured at equilibria of
the equations or by flight software in the plant. The truth is the noise-free equilibrium of the sampled arm.

The real arm is a UR10: measured poses of two series, with held-out parts and across series.
"""

import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.kinematics.transforms import Array, Integers
from marsarm.calibration.calibrate import (
    calibrate,
    calibrated_params,
    rms_m,
    save_parameter_file,
)
from marsarm.calibration.campaign import CampaignPlan, earth_reference, run_campaign
from marsarm.calibration.campaign_data import BadData, Campaign
from marsarm.calibration.execution import check_data, check_fit
from marsarm.calibration.residual_model import residual_model
from marsarm.calibration.verify import (
    compare_with_truth,
    hardstop_errors_rad,
    register_tools,
    simulate_campaign,
    zero_errors_rad,
)
from marsarm.common.rates import clopper_pearson
from sim.arms import BuiltArm, arm_named
from sim.params import nominal_params
from simgap.command.diagnosis import calibration_json
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from simgap.serial_arm.calibrate import periodic_error_rad
from simgap.serial_arm.files import read_arm, read_series
from simgap.serial_arm.tracker import TrackerFit, fit_tracker
from validation.campaigns import Context, Document

INTERVAL: Final = 1.645
"""Half width of a 90 % interval, in standard deviations."""


def measure(arm: BuiltArm, seed: int, closed_loop: bool) -> tuple[Campaign, Array]:
    """Measure an arm.

    Returns:
        The campaign, and the errors of the motor zeros, shape (5,), in rad.
    """
    plan = CampaignPlan(seed=seed)
    if not closed_loop:
        return simulate_campaign(arm, plan), hardstop_errors_rad(arm)
    reference = earth_reference(arm, no_progress)
    return run_campaign(arm, reference, plan, no_progress), zero_errors_rad(arm, reference)


def run(seed: int, closed_loop: bool, files: Path | None) -> dict[str, Any]:
    """Measure an arm, calibrate it, and compare the result with the truth.

    Args:
        files: Folder for its parameter file.
    """
    arm, nominal = arm_named(f"as-built:{seed}"), nominal_params()
    campaign, zero_error_rad = measure(arm, seed, closed_loop)
    check_data(nominal, campaign)
    found = calibrate(nominal, campaign)
    refused = ""
    try:
        check_fit(found)
    except BadData as error:
        refused = str(error)
    if files is not None:
        params = calibrated_params(found, register_tools(arm, seed))
        save_parameter_file(found, params, files / f"{seed}.toml")
    before, held = found.before[:, found.held_out_poses], found.held_out_error
    comparison = compare_with_truth(arm, found, zero_error_rad)
    state = residual_model(nominal, campaign, with_backlash=False).errors(found.best.values)
    inside = np.array([branch.startswith("shoulder-in") for branch in campaign.branch])
    length = np.linalg.norm(state[3:], axis=0)
    return {
        "seed": seed,
        "poses": campaign.count,
        "outliers": list(found.rejection.outliers),
        "refused": refused,
        "before_rms_mm": 1e3 * rms_m(before),
        "held_out_rms_mm": 1e3 * rms_m(held),
        "held_out_max_mm": 1e3 * float(np.linalg.norm(held[3:], axis=0).max()),
        "factor": rms_m(before) / rms_m(held),
        "held_out_over_expected": found.hold_out.ratio,
        "sigma0": found.best.sigma0,
        "p_value": found.best.p_value,
        "rank_frames": found.frame_identifiability.rank,
        "rank_all": found.identifiability.rank,
        "intervals_hold": [int(np.sum(np.abs(comparison.sigmas) < INTERVAL)), comparison.sigmas.size],
        "truth_rms_mm": 1e3 * rms_m(comparison.error),
        "stateless_mm": {
            "shoulder-in": float(1e3 * np.median(length[inside])),
            "shoulder-out": float(1e3 * np.median(length[~inside])),
        },
    }


def campaign(context: Context, arms: int = 20, closed_loop: bool = False) -> Document:
    """Calibrate all arms, and check the results.

    Args:
        context: Its folder takes the parameter files of the arms, SEED.toml each.
        arms: Number of as-built arms.
        closed_loop: Measure in the closed loop: three minutes an arm, not ten seconds.
    """
    if arms < 1:
        raise BadRequest("set: arms are 1 or more")
    files = context.out and context.out.absolute()  # a worker may be in another folder
    if files is not None:
        files.mkdir(exist_ok=True)
    results = context.each(run, ((context.seed + k, closed_loop, files) for k in range(arms)), "arms")
    inside, of = np.sum([result["intervals_hold"] for result in results], axis=0)
    low, high = clopper_pearson(int(inside), int(of))
    checks = {
        "five times better on held-out poses": min(r["factor"] for r in results) >= 5,
        "under 5 mm": max(r["held_out_max_mm"] for r in results) < 5,
        "held out within 1.3 of what is expected": max(r["held_out_over_expected"] for r in results) <= 1.3,
        "intervals of 90 % hold the truth in 90 %": low <= 0.9 <= high,
        "shoulder-in poses stand apart without backlash state": all(
            r["stateless_mm"]["shoulder-in"] > 2 * r["stateless_mm"]["shoulder-out"] for r in results
        ),
        "rank 26 of 42": all(r["rank_frames"] == 26 for r in results),
    }
    return {
        "arms": arms,
        "seed": context.seed,
        "closed_loop": closed_loop,
        "intervals": {"inside": int(inside), "of": int(of), "share": inside / of, "interval_95": [low, high]},
        "results": results,
        "checks": checks,
        "in_bounds": all(checks.values()),
    }


FILES = Path(__file__).parents[1] / "models" / "robots" / "ur10"
TABLES = {"a": "series_a_grid.csv", "c": "series_c_random_poses.csv"}
BOUNDS_MM = {"a": 0.50, "c": 0.52, "a_to_c": 0.60}
"""Bounds of the root mean square position error of held-out poses."""
JOINTS = 6
LEAST_VISITS = 3
"""Least number of poses of each series in a degree that is compared."""
LEAST_DEGREES = 8
"""Least number of degrees for a comparison."""
KEYS = ("models", "contributions_m", "joints", "temperature")


def ur10(context: Context, data: Path | None = None) -> Document:
    """Calibrate both series, validate one on the other, and compare the errors with their bounds.

    Args:
        context: Told of the progress.
        data: Folder with the data; that which MARSARM_DATA names if there is none.
    """
    folder = (data or Path(os.environ.get("MARSARM_DATA", ""))) / "ur10-tracker"
    if not folder.is_dir():
        raise BadRequest("set data: there is no folder ur10-tracker; name its folder here or by MARSARM_DATA")
    arm = read_arm(FILES / "arm.toml")
    series = {
        name: read_series(arm, folder / table, FILES / f"series_{name}.toml")
        for name, table in TABLES.items()
    }
    fits = {name: fit_tracker(arm, one, progress=context.progress) for name, one in series.items()}
    fits["a_to_c"] = fit_tracker(fits["a"].found.arm, series["c"], terms=(), progress=context.progress)
    documents = {name: calibration_json(one) for name, one in fits.items()}
    checks = {name: _check_error(fits[name], bound) for name, bound in BOUNDS_MM.items()}
    temperature = {name: documents[name]["temperature"]["explains"] for name in TABLES}
    return {
        "in_bounds": all(one["passed"] for one in checks.values())
        and set(temperature.values()) == {"nothing"},
        "held_out_position_rms": checks,
        "temperature_explains": temperature,
        "periodic_comparison": [_compare_periodic(fits["a"], fits["c"], k) for k in range(JOINTS)],
        **{name: {key: one[key] for key in KEYS} for name, one in documents.items()},
    }


def _check_error(fitted: TrackerFit, bound_mm: float) -> dict[str, Any]:
    fresh = fitted.models[-1].fresh
    rms_mm = fresh.rms_m * 1e3
    return {
        "rms_mm": rms_mm,
        "bound_mm": bound_mm,
        "poses": fresh.position_m.size,
        "passed": rms_mm <= bound_mm,
    }


def _compare_periodic(one: TrackerFit, other: TrackerFit, joint: int) -> dict[str, Any]:
    """Compare the periodic errors of a joint from two series, at degrees that both visit, without slopes."""
    at_rad = np.radians(np.arange(-179.5, 180.0))
    visits = [_visits(fitted, joint) for fitted in (one, other)]
    at_rad = at_rad[np.all(np.array(visits) >= LEAST_VISITS, axis=0)]
    name = one.found.model.arm.links[joint].name
    if at_rad.size < LEAST_DEGREES:
        return {"name": name, "degrees": at_rad.size}
    line = np.stack([np.ones(at_rad.size), at_rad], axis=1)
    curves = np.array([_periodic_rad(fitted, joint, at_rad) for fitted in (one, other)]).T
    curves -= line @ np.linalg.lstsq(line, curves, rcond=None)[0]
    return {
        "name": name,
        "degrees": at_rad.size,
        "rms_rad": np.std(curves, axis=0).tolist(),
        "rms_of_difference_rad": float(np.std(curves[:, 0] - curves[:, 1])),
        "correlation": float(np.corrcoef(curves.T)[0, 1]),
    }


def _visits(fitted: TrackerFit, joint: int) -> Integers:
    """Count the fitted poses in each degree of a joint, shape (360,)."""
    degrees = np.degrees(fitted.found.model.series.joint_rad[joint])
    return np.bincount(np.floor(np.mod(degrees + 180, 360)).astype(int), minlength=360)


def _periodic_rad(fitted: TrackerFit, joint: int, at_rad: Array) -> Array:
    """Compute the periodic error of a joint at angles of shape (n,)."""
    arm = fitted.found.arm
    phase = at_rad[:, None] * np.arange(1, arm.orders + 1)
    amplitudes = arm.links[joint].periodic_rad(arm.orders)
    return periodic_error_rad(np.concatenate([np.cos(phase), np.sin(phase)], axis=1), amplitudes)
