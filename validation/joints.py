"""Campaigns of joint angles: repeated hardstops, and the estimated side of the backlash.

Hardstops: as-built arms find every hardstop many times, each time with another temperature, friction, noise
and pose. On Mars they have the turret and the planned poses. On Earth, a fifth as often, they have no turret.
There the poses are those of equal torque, and those of Mars, in which the torque differs.

Backlash: each tour is a sequence of poses at a random tilt, in all branches, with reversals and small moves.
Tours run with backlash compensation, and a fifth of them also without.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import BacklashMode
from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from sim.arms import BuiltArm, arm_named, without_turret
from sim.initialisation import InitialisationResult, initial_reference, prepare_random_homing
from sim.pose_sequence import RestState, random_poses, visit_poses
from sim.sequence import Outcome
from sim.world import World
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document

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


def run_trial(trial: HardstopTrial) -> TrialResult:
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


def hardstops(context: Context, arms: int = 5, repeats: int = 50, joint: str = "") -> Document:
    """Run all trials of some as-built arms, at all joints or one; the same arguments give the same result."""
    if arms < 1 or repeats < 2 or joint not in ("", *Joint.__members__):
        raise BadRequest("set: arms are 1 or more, repeats 2 or more, the joint is a name like ELBOW")
    joints, seed = (Joint[joint],) if joint else tuple(Joint), context.seed
    trials = [
        HardstopTrial(place, seed + arm, one, repetition)
        for place in PLACES
        for arm in range(arms)
        for one in joints
        for repetition in range(repeats if place == "mars" else max(2, repeats // 5))
    ]
    results = context.each(run_trial, ((trial,) for trial in trials), "trials")
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
        "max_torque_Nm": {one.name.lower(): _most(results, one) for one in joints},
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


MAX_TILT_RAD: Final = float(np.radians(30.0))
LEAST_RATIO: Final = 10.0
"""Least ratio of the tool error from backlash without compensation to that with it."""


def one_tour(
    arm_name: str, reference: Reference, backlash: BacklashMode, poses: int, seed: int
) -> list[RestState]:
    """Visit the poses of a tour, with tilt and poses from the seed."""
    arm = arm_named(arm_name)
    rng = np.random.default_rng([seed, 4])
    tilt, heading = rng.uniform(0.0, MAX_TILT_RAD), rng.uniform(-np.pi, np.pi)
    world = World("mars", float(tilt * np.cos(heading)), float(tilt * np.sin(heading)))
    goals = random_poses(configure(arm.params), rng, poses)
    return list(visit_poses(arm, reference, world, goals, backlash, seed))


def summary(friction_Nm: np.ndarray, settled: Sequence[RestState]) -> dict[str, Any]:
    """Summarize the claimed sides of the backlash, and the errors of outputs and tool.

    Args:
        friction_Nm: Friction of the outputs, shape (5,).
        settled: States of the arm at rest.
    """
    claimed = np.array([s.side for s in settled])
    true = np.array([s.true_side for s in settled])
    loaded = np.abs([s.load_Nm for s in settled]) > friction_Nm
    error = np.array([s.output_rad - s.pose_rad for s in settled])
    known = claimed != 0
    shift = np.linalg.norm([s.backlash_shift_m for s in settled], axis=1)
    believed = np.array([s.gear_rad - s.believed_gear_rad for s in settled])
    return {
        "poses": len(settled),
        "joint_poses": int(known.size),
        "claimed_share": float(known.mean()),
        "claimed_share_of_loaded": float(known[loaded].mean()),
        "floating_share": float(1.0 - known.mean()),
        "right_share_of_claimed": float((claimed == true)[known].mean()),
        "wrong_claims": int(np.count_nonzero((claimed != true) & known)),
        "output_error_rms_mrad": {"claimed": _rms_mrad(error[known]), "floating": _rms_mrad(error[~known])},
        "believed_output_error_rms_mrad": {
            "claimed": _rms_mrad(believed[known]),
            "floating": _rms_mrad(believed[~known]),
        },
        "by_joint": {
            joint.name.lower(): {
                "claimed_share": float(known[:, joint].mean()),
                "output_error_rms_mrad": _rms_mrad(error[known[:, joint], joint]),
            }
            for joint in Joint
        },
        "tool_error_from_backlash_mm": {
            "rms": 1e3 * float(np.sqrt(np.mean(shift**2))),
            "max": 1e3 * float(shift.max()),
        },
    }


def backlash(context: Context, sequences: int = 20, poses: int = 50, arm: str = "nominal") -> Document:
    """Run all sequences, with and without compensation; the same arguments give the same result."""
    if min(sequences, poses) < 1:
        raise BadRequest("set: sequences and poses are 1 or more")
    friction, seed = configure(arm_named(arm).params).output_friction_Nm, context.seed
    result: Document = {"arm": arm, "pose_sequences": sequences, "seed": seed}
    modes: tuple[BacklashMode, ...] = ("on", "off")
    # A fifth of the sequences is enough to measure the effect of backlash without compensation.
    jobs = [
        (mode, seed + k)
        for mode in modes
        for k in range(sequences if mode == "on" else max(1, sequences // 5))
    ]
    found: dict[str, list[RestState]] = {mode: [] for mode in modes}
    seeds = range(seed, seed + sequences)
    built = arm_named(arm)
    known = dict(zip(seeds, context.each(initial_reference, ((built, s) for s in seeds)), strict=True))
    tours = context.each(one_tour, ((arm, known[s], mode, poses, s) for mode, s in jobs), "sequences")
    for (mode, _), rests in zip(jobs, tours, strict=True):
        found[mode].extend(rests)
    for mode in modes:
        result[f"backlash_{mode}"] = summary(friction, found[mode])
    tool = "tool_error_from_backlash_mm"
    result["tool_error_ratio"] = result["backlash_off"][tool]["rms"] / result["backlash_on"][tool]["rms"]
    wrong = sum(result[f"backlash_{mode}"]["wrong_claims"] for mode in modes)
    result["in_bounds"] = wrong == 0 and result["tool_error_ratio"] > LEAST_RATIO
    return result


def _rms_mrad(error: np.ndarray) -> float | None:
    return 1e3 * float(np.sqrt(np.mean(error**2))) if error.size else None
