"""Campaign of the hardstop initialisation: its repeatability, its error, and the effect of its corrections.

As-built arms find every hardstop many times, each time with another temperature, friction, noise and pose.
On Mars they have the turret and the planned poses. On Earth, a fifth as often, they have no turret. There the
poses are those of equal torque, and those of Mars, in which the torque differs.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from fsw.dictionary.enums import Joint
from marsarm.common.pool import Runner
from sim.arms import BuiltArm, arm_named, without_turret
from sim.initialisation import InitialisationResult, prepare_random_homing
from sim.sequence import Outcome
from sim.world import World
from validation.options import campaign_parser, campaign_runner

EXAMPLE = "example: python -m validation.hardstops --arms 5 --repeats 50 > hardstops.json"
ROUNDING: Final = 1e-9
HARD_NM: Final = 360.0
"""Press torque of the elevation on Earth in the poses of Mars: 0.6 of it exceeds gravity, 206 N m."""
Place = Literal["mars", "earth", "earth, poses of mars"]
PLACES: Final[tuple[Place, ...]] = ("mars", "earth", "earth, poses of mars")


@dataclass(frozen=True, slots=True)
class HardstopTrial:
    """One repetition with one joint of one arm."""

    place: Place
    arm: int
    joint: Joint
    repetition: int


@dataclass(frozen=True, slots=True)
class TrialResult:
    """Errors and loads of a trial."""

    trial: HardstopTrial
    outcome: str
    zero_error_mrad: float
    uncorrected_mrad: float
    half_backlash_error_mrad: float
    load_Nm: float
    max_torque_Nm: float
    max_current_ratio: float


def arm_at(place: Place, seed: int) -> tuple[BuiltArm, World]:
    """Return an as-built arm and the world in which it is initialised."""
    arm = arm_named(f"as-built:{seed}")
    if place == "mars":
        return arm, World()
    bare = without_turret(arm, on_earth=place == "earth")
    return (bare if place == "earth" else with_harder_press(bare)), World("earth")


def with_harder_press(arm: BuiltArm) -> BuiltArm:
    """Raise the press torque of the elevation, which is too small for its load on Earth in poses of Mars."""
    elevation = replace(arm.params.joints.elevation, hardstop_press_Nm=HARD_NM)
    return replace(arm, params=replace(arm.params, joints=replace(arm.params.joints, elevation=elevation)))


def run(trial: HardstopTrial) -> TrialResult:
    """Carry out a trial."""
    arm, world = arm_at(trial.place, trial.arm)
    running = prepare_random_homing(arm, trial.joint, world, 1000 * trial.arm + trial.repetition)
    return _result(trial, running.finish())


def _result(trial: HardstopTrial, found: InitialisationResult) -> TrialResult:
    stop = found.stops[0] if found.outcome is Outcome.DONE else None
    return TrialResult(
        trial,
        found.outcome.value,
        np.nan if stop is None else 1e3 * stop.zero_error_rad,
        np.nan if stop is None else 1e3 * stop.uncorrected_error_rad,
        np.nan if stop is None else 1e3 * stop.half_backlash_error_rad,
        np.nan if stop is None else stop.load_Nm,
        float(found.max_torque_Nm[trial.joint]),
        float(found.max_current_ratio[trial.joint]),
    )


def campaign(
    arms: int, repeats: int, seed: int, runner: Runner, joints: Sequence[Joint] = tuple(Joint)
) -> dict[str, Any]:
    """Run all trials; the same arguments give the same result."""
    trials = [
        HardstopTrial(place, seed + arm, joint, repetition)
        for place in PLACES
        for arm in range(arms)
        for joint in joints
        for repetition in range(repeats if place == "mars" else max(2, repeats // 5))
    ]
    results: list[TrialResult] = []
    for done, result in enumerate(runner(run, trials), 1):
        results.append(result)
        if done % 50 == 0 or done == len(trials):
            print(f"marsarm: {done} of {len(trials)} trials", file=sys.stderr)
    never = {
        "failed": sum(r.outcome != "done" for r in results),
        "above_rated_torque": sum(r.max_torque_Nm > _rated_Nm(r) for r in results),
        "above_current_limit": sum(r.max_current_ratio > 1.0 + ROUNDING for r in results),
    }
    return {
        "arms": arms,
        "repeats": repeats,
        "seed": seed,
        "in_bounds": not any(never.values()),
        **never,
        "failures": [
            f"{r.trial.joint.name.lower()} of as-built:{r.trial.arm}, {r.trial.place}, trial "
            f"{r.trial.repetition}: {r.outcome}"
            for r in results
            if r.outcome != "done"
        ],
        "max_torque_Nm": {joint.name.lower(): _most(results, joint) for joint in joints},
        "max_current_ratio": max(r.max_current_ratio for r in results),
        **{place: _summarize_place(results, place, joints) for place in PLACES},
        "earth_less_mars_mrad": {
            "equal torque": _mean_difference(results, "earth", joints),
            "other torque": _mean_difference(results, "earth, poses of mars", joints),
        },
    }


def _summarize_place(results: Sequence[TrialResult], place: Place, joints: Sequence[Joint]) -> dict[str, Any]:
    here = [r for r in results if r.trial.place == place]
    return {
        joint.name.lower(): _summarize_joint([r for r in here if r.trial.joint is joint]) for joint in joints
    }


def _summarize_joint(results: Sequence[TrialResult]) -> dict[str, Any]:
    """Compute the repeatability within an arm, pooled and of the worst arm, and the means of the arms."""
    corrected, uncorrected = _by_arm(results, "zero_error_mrad"), _by_arm(results, "uncorrected_mrad")
    means = np.nanmean(corrected, axis=1)
    return {
        "repeatability_3_sigma_mrad": _three_sigma(corrected),
        "repeatability_3_sigma_worst_arm_mrad": _worst_three_sigma(corrected),
        "mean_error_worst_arm_mrad": float(np.abs(means).max()),
        "mean_error_rms_over_arms_mrad": float(np.sqrt(np.mean(means**2))),
        "without_wind_up": {
            "repeatability_3_sigma_mrad": _three_sigma(uncorrected),
            "mean_error_worst_arm_mrad": float(np.abs(np.nanmean(uncorrected, axis=1)).max()),
        },
        "half_backlash_error_rms_mrad": float(
            np.sqrt(np.nanmean([r.half_backlash_error_mrad**2 for r in results]))
        ),
        "load_Nm": float(np.nanmean([r.load_Nm for r in results])),
    }


def _mean_difference(results: Sequence[TrialResult], place: Place, joints: Sequence[Joint]) -> dict[str, Any]:
    """Compute the largest difference of an arm's mean from its mean on Mars, for both kinds of error."""
    found = {}
    for joint in joints:
        of_joint = [r for r in results if r.trial.joint is joint]
        here, mars = ([r for r in of_joint if r.trial.place == p] for p in (place, "mars"))
        largest = {}
        for name in ("zero_error_mrad", "uncorrected_mrad"):
            differences = np.nanmean(_by_arm(here, name), axis=1) - np.nanmean(_by_arm(mars, name), axis=1)
            largest[name.removesuffix("_mrad")] = float(np.abs(differences).max())
        found[joint.name.lower()] = largest
    return found


def _by_arm(results: Sequence[TrialResult], name: str) -> np.ndarray:
    """Arrange a value of the results in an array, shape (arms, repetitions)."""
    arms = sorted({r.trial.arm for r in results})
    rows = [sorted((r for r in results if r.trial.arm == arm), key=_repetition) for arm in arms]
    return np.array([[getattr(r, name) for r in row] for row in rows])


def _repetition(result: TrialResult) -> int:
    return result.trial.repetition


def _three_sigma(by_arm: np.ndarray) -> float:
    return 3 * float(np.sqrt(np.mean(np.nanvar(by_arm, axis=1, ddof=1))))


def _worst_three_sigma(by_arm: np.ndarray) -> float:
    return 3 * float(np.nanstd(by_arm, axis=1, ddof=1).max())


def _rated_Nm(result: TrialResult) -> float:
    return arm_named("nominal").params.joints.in_order()[result.trial.joint].hardstop_rated_Nm


def _most(results: Sequence[TrialResult], joint: Joint) -> float:
    return max(r.max_torque_Nm for r in results if r.trial.joint is joint)


def main() -> int:
    """Print the result as JSON; return 1 if a joint failed, or exceeded its torque or current limit."""
    parser = campaign_parser("hardstops", __doc__, EXAMPLE)
    parser.add_argument("--arms", type=int, default=5, help="as-built arms (default 5)")
    parser.add_argument("--repeats", type=int, default=50, help="repetitions (default 50)")
    parser.add_argument("--joint", choices=list(Joint.__members__), help="only this joint, not all")
    options = parser.parse_args()
    if options.arms < 1 or options.repeats < 2 or options.seed < 0:
        parser.error("arms are 1 or more, repeats 2 or more, the seed is not negative")
    joints = (Joint[options.joint],) if options.joint else tuple(Joint)
    result = campaign(options.arms, options.repeats, options.seed, campaign_runner(options), joints)
    print(json.dumps(result, indent=2))
    return 0 if result["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
