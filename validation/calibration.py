"""Campaign of calibrations of as-built arms: accuracy, coverage of confidence intervals, and speed.

Each arm is measured at equilibria of the equations or, with --closed-loop, by flight software in the plant.
The truth is the noise-free equilibrium of the sampled arm.
"""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from fsw.kinematics.transforms import Array
from marsarm.calibration.arm_parameters import arm_parameters
from marsarm.calibration.calibrate import (
    Calibration,
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
from marsarm.common.pool import Runner
from marsarm.common.rates import clopper_pearson
from sim.arms import arm_named
from sim.params import nominal_params
from simgap.serial_arm.fit import fit
from validation.options import campaign_parser, campaign_runner

EXAMPLE: Final = "example: python -m validation.calibration --arms 20 --closed-loop > calibration.json"
INTERVAL: Final = 1.645
"""Half width of a 90 % interval, in standard deviations."""
NUMERIC: Final[dict[str, Any]] = {
    "method": "lm",
    "diff_step": 1e-4,
    "xtol": 1e-10,
    "ftol": 1e-10,
    "gtol": 1e-10,
}
"""Options of scipy; the equilibrium is accurate to 1e-11, so smaller steps give worse derivatives."""


@dataclass(frozen=True, slots=True)
class CalibrationTrial:
    """Calibration of one arm."""

    seed: int
    closed_loop: bool
    files: Path | None = None
    """Folder for its parameter file."""


def measure(trial: CalibrationTrial) -> tuple[Campaign, Array]:
    """Measure an arm.

    Returns:
        The campaign, and the errors of the motor zeros, shape (5,), in rad.
    """
    arm, plan = arm_named(f"as-built:{trial.seed}"), CampaignPlan(seed=trial.seed)
    if not trial.closed_loop:
        return simulate_campaign(arm, plan), hardstop_errors_rad(arm)
    reference = earth_reference(arm, _quiet)
    return run_campaign(arm, reference, plan, _quiet), zero_errors_rad(arm, reference)


def run(trial: CalibrationTrial) -> dict[str, Any]:
    """Measure an arm, calibrate it, and compare the result with the truth."""
    (campaign, zero_error_rad), nominal = measure(trial), nominal_params()
    check_data(nominal, campaign)
    found = calibrate(nominal, campaign)
    refused = ""
    try:
        check_fit(found)
    except BadData as error:
        refused = str(error)
    if trial.files is not None:
        _save(found, trial)
    before, held = found.before[:, found.held_out_poses], found.held_out_error
    comparison = compare_with_truth(arm_named(f"as-built:{trial.seed}"), found, zero_error_rad)
    state = residual_model(nominal, campaign, with_backlash=False).errors(found.best.values)
    inside = np.array([branch.startswith("shoulder-in") for branch in campaign.branch])
    length = np.linalg.norm(state[3:], axis=0)
    return {
        "seed": trial.seed,
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


def speed(campaign: Campaign) -> dict[str, Any]:
    """Time the calibration, its fit, and scipy's least squares with numeric derivatives on its residual."""
    nominal, parameters = nominal_params(), arm_parameters()
    model = residual_model(nominal, campaign)
    prior = np.array([parameter.prior_sigma for parameter in parameters])

    def residual(shifted: np.ndarray) -> np.ndarray:
        scaled = shifted - 1.0  # numeric derivatives use relative steps, so the start is at 1
        error = model.errors(scaled * prior)
        return np.concatenate([np.einsum("nij,jn->ni", model.whitener, error).ravel(), scaled])

    _best_time(lambda: model(np.zeros(prior.size)))  # warm-up
    whole_s, _ = _best_time(lambda: calibrate(nominal, campaign))
    ours_s, ours = _best_time(lambda: fit(parameters, model))
    theirs_s, theirs = _best_time(lambda: least_squares(residual, np.ones(prior.size), **NUMERIC))
    cost = np.sum(ours.at.residual**2) + np.sum((ours.values / prior) ** 2)
    return {
        "calibration_s": whole_s,
        "fit_s": ours_s,
        "least_squares_s": theirs_s,
        "ratio": theirs_s / ours_s,
        "largest_difference_sigma": float(
            np.abs((ours.values - (theirs.x - 1.0) * prior) / ours.sigma).max()
        ),
        "cost_ours_over_theirs": float(cost / (2 * theirs.cost)),
    }


def _best_time(work: Any) -> tuple[float, Any]:
    """Return the shortest of three times, and the result; other processes only add time."""
    spent = []
    for _ in range(3):
        start = time.perf_counter()
        result = work()
        spent.append(time.perf_counter() - start)
    return min(spent), result


def campaign(
    arms: int,
    seed: int,
    runner: Runner,
    closed_loop: bool,
    files: Path | None = None,
    with_speed: bool = True,
) -> dict[str, Any]:
    """Calibrate all arms, and check the results; checks of speed require an otherwise idle machine."""
    files = files and files.absolute()  # a worker may be in another folder
    trials = [CalibrationTrial(seed + k, closed_loop, files) for k in range(arms)]
    results = []
    for result in runner(run, trials):
        results.append(result)
        print(f"marsarm: {len(results)} of {arms} arms", file=sys.stderr)
    results.sort(key=lambda result: int(result["seed"]))
    fast = speed(measure(CalibrationTrial(seed, False))[0]) if with_speed else None
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
    if fast is not None:
        checks |= {
            "under 2 s": fast["calibration_s"] < 2,
            "five times faster than least_squares": fast["ratio"] >= 5,
            "to the same optimum": fast["largest_difference_sigma"] < 0.01,
        }
    return {
        "arms": arms,
        "seed": seed,
        "closed_loop": closed_loop,
        "intervals": {"inside": int(inside), "of": int(of), "share": inside / of, "interval_95": [low, high]},
        "speed": fast,
        "results": results,
        "checks": checks,
        "in_bounds": all(checks.values()),
    }


def _save(found: Calibration, trial: CalibrationTrial) -> None:
    tools = register_tools(arm_named(f"as-built:{trial.seed}"), trial.seed)
    assert trial.files is not None
    save_parameter_file(found, calibrated_params(found, tools), trial.files / f"{trial.seed}.toml")


def _quiet(*_: Any) -> None:
    """Ignore progress."""


def main() -> int:
    """Print the result as JSON; return 1 if a check fails."""
    parser = campaign_parser("calibration", __doc__, EXAMPLE)
    parser.add_argument("--arms", type=int, default=20, help="as-built arms (default 20)")
    parser.add_argument(
        "--closed-loop",
        action="store_true",
        help="use the closed loop: three minutes an arm, not ten seconds",
    )
    parser.add_argument("--files", type=Path, help="folder for the arms' parameter files, SEED.toml each")
    parser.add_argument(
        "--without-speed", action="store_true", help="do not check the speed, on a machine that is not idle"
    )
    options = parser.parse_args()
    if options.arms < 1 or options.seed < 0:
        parser.error("arms are 1 or more, the seed is not negative")
    if options.files is not None:
        options.files.mkdir(exist_ok=True)
    result = campaign(
        options.arms,
        options.seed,
        campaign_runner(options),
        options.closed_loop,
        options.files,
        not options.without_speed,
    )
    print(json.dumps(result, indent=2))
    return 0 if result["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
