"""Campaigns of joint angles: repeated hardstops, and the estimated side of the backlash.

Hardstops: as-built arms find every hardstop many times, each time with another temperature, friction, noise
and pose. On Mars they have the turret and the planned poses. On Earth, a fifth as often, they have no turret.
There the poses are those of equal torque.

Backlash: each tour is a sequence of poses at a random tilt, in all branches, with reversals and small moves.
Tours run with backlash compensation, and a fifth of them also without.

Figure 7 of the paper: there are four groups of poses over the workspace, on Earth, with stand-in turrets of 8
and 19 kg, level and rolled by 20 degrees. In each group 70 % of the poses are shoulder-out, then 30 % are
shoulder-in. The position of the drill is predicted from the encoders after the hardstop initialisation. One
prediction assumes the side of the backlash at the hardstop for every joint, the other uses the estimate of
flight software.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Literal

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import BacklashMode
from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.statics import settle, settle_output
from marsarm.calibration.campaign import PAPER_GROUPS, SHOULDER_IN_SHARE
from marsarm.render.svg import save_figure
from sim.arms import BuiltArm, arm_named, without_turret
from sim.effects.structure import StandInTurret
from sim.initialisation import InitialisationResult, initial_reference, prepare_random_homing
from sim.pose_sequence import RestState, pose_in_workspace, random_poses, visit_poses
from sim.sequence import Outcome
from sim.world import World
from simgap.common.errors import BadOutput, BadRequest
from validation.campaigns import Context, Document

ROUNDING: Final = 1e-9
Place = Literal["mars", "earth"]
PLACES: Final[tuple[Place, ...]] = ("mars", "earth")


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
    max_torque_Nm: float
    max_current_ratio: float


def arm_at(place: Place, seed: int) -> tuple[BuiltArm, World]:
    """Return an as-built arm and the world in which it is initialised."""
    arm = arm_named(f"as-built:{seed}")
    return (arm, World()) if place == "mars" else (without_turret(arm, on_earth=True), World("earth"))


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
        **{place: _summarize_place(results, place, joints) for place in PLACES},
        "earth_less_mars_mrad": {
            "equal torque": _mean_difference(results, joints),
        },
    }


def _summarize_place(results: Sequence[TrialResult], place: Place, joints: Sequence[Joint]) -> dict[str, Any]:
    here = [r for r in results if r.trial.place == place]
    return {
        joint.name.lower(): _summarize_joint([r for r in here if r.trial.joint is joint]) for joint in joints
    }


def _summarize_joint(results: Sequence[TrialResult]) -> dict[str, Any]:
    """Compute the repeatability within an arm, and the means of the arms."""
    corrected, uncorrected = _by_arm(results), _by_arm(results, "uncorrected_mrad")
    means = np.nanmean(corrected, axis=1)
    return {
        "repeatability_3_sigma_mrad": _three_sigma(corrected),
        "mean_error_worst_arm_mrad": float(np.abs(means).max()),
        "without_wind_up": {
            "mean_error_worst_arm_mrad": float(np.abs(np.nanmean(uncorrected, axis=1)).max())
        },
        "half_backlash_error_rms_mrad": float(
            np.sqrt(np.nanmean([r.half_backlash_error_mrad**2 for r in results]))
        ),
    }


def _mean_difference(results: Sequence[TrialResult], joints: Sequence[Joint]) -> dict[str, Any]:
    """Compute the largest difference of an arm's mean on Earth from its mean on Mars."""
    found = {}
    for joint in joints:
        of_joint = [r for r in results if r.trial.joint is joint]
        mean = {p: np.nanmean(_by_arm([r for r in of_joint if r.trial.place == p]), axis=1) for p in PLACES}
        found[joint.name.lower()] = {"zero_error": float(np.abs(mean["earth"] - mean["mars"]).max())}
    return found


def _by_arm(results: Sequence[TrialResult], name: str = "zero_error_mrad") -> np.ndarray:
    """Arrange a value of the results in an array, shape (arms, repetitions)."""
    arms = sorted({r.trial.arm for r in results})
    rows = [
        sorted((r for r in results if r.trial.arm == arm), key=lambda r: r.trial.repetition) for arm in arms
    ]
    return np.array([[getattr(r, name) for r in row] for row in rows])


def _three_sigma(by_arm: np.ndarray) -> float:
    return 3 * float(np.sqrt(np.mean(np.nanvar(by_arm, axis=1, ddof=1))))


def _rated_Nm(result: TrialResult) -> float:
    return arm_named("nominal").params.joints.in_order()[result.trial.joint].hardstop_rated_Nm


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


def summary(settled: Sequence[RestState]) -> dict[str, Any]:
    """Summarize the claimed sides of the backlash, and the errors of outputs and tool."""
    claimed = np.array([s.side for s in settled])
    true = np.array([s.true_side for s in settled])
    error = np.array([s.output_rad - s.pose_rad for s in settled])
    known = claimed != 0
    shift = np.linalg.norm([s.backlash_shift_m for s in settled], axis=1)
    return {
        "poses": len(settled),
        "joint_poses": int(known.size),
        "claimed_share": float(known.mean()),
        "wrong_claims": int(np.count_nonzero((claimed != true) & known)),
        "output_error_rms_mrad": {"claimed": _rms_mrad(error[known]), "floating": _rms_mrad(error[~known])},
        "tool_error_from_backlash_mm": {
            "rms": 1e3 * float(np.sqrt(np.mean(shift**2))),
            "max": 1e3 * float(shift.max()),
        },
    }


def backlash(context: Context, sequences: int = 20, poses: int = 50, arm: str = "nominal") -> Document:
    """Run all sequences, with and without compensation; the same arguments give the same result."""
    if min(sequences, poses) < 1:
        raise BadRequest("set: sequences and poses are 1 or more")
    seed = context.seed
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
        result[f"backlash_{mode}"] = summary(found[mode])
    tool = "tool_error_from_backlash_mm"
    result["tool_error_ratio"] = result["backlash_off"][tool]["rms"] / result["backlash_on"][tool]["rms"]
    wrong = sum(result[f"backlash_{mode}"]["wrong_claims"] for mode in modes)
    result["in_bounds"] = wrong == 0 and result["tool_error_ratio"] > LEAST_RATIO
    return result


def _rms_mrad(error: np.ndarray) -> float | None:
    return 1e3 * float(np.sqrt(np.mean(error**2))) if error.size else None


GROUP_POSES: Final = PAPER_GROUPS[0].count
"""Number of poses in each group."""
MOST_LEFT: Final = 0.1
"""Largest ratio of the prediction error with the estimated side to that with the side at the hardstop."""
WITH_SHOULDER: Final = {
    shoulder: [name for name in BRANCHES if name.startswith(f"shoulder-{shoulder}")]
    for shoulder in ("out", "in")
}
SERIES: Final = (
    ("as_initialised_mm", "#c1121f", "backlash taken to be as at the hardstop"),
    ("with_state_mm", "#31688e", "with the estimated side of the backlash"),
)


@dataclass(frozen=True, slots=True)
class Prediction:
    """Prediction errors of the drill in a pose."""

    shoulder_in: bool
    as_initialised_mm: float
    """Error with the side of the backlash at the hardstop."""
    with_state_mm: float
    """Error with the estimated side."""
    joints_on_other_side: int
    """Number of joints that have changed the side of their backlash."""


def with_stand_in_turret(mass_kg: float) -> BuiltArm:
    """Return the nominal arm with a stand-in turret that flight software knows."""
    turret, nominal = StandInTurret(mass_kg), arm_named("nominal")
    return replace(nominal, effects=(*nominal.effects, turret), params=turret.on_params(nominal.params))


def group(index: int, seed: int, poses: int, reference: Reference) -> list[Prediction]:
    """Predict one group of poses, shoulder-out and then shoulder-in."""
    mass_kg, roll_rad = _load(index)
    arm = with_stand_in_turret(mass_kg)
    world = World("earth", tilt_roll_rad=roll_rad)
    config = configure(arm.params)
    rng = np.random.default_rng([seed, index, 6])
    inside = round(SHOULDER_IN_SHARE * poses)
    shoulders = ["out"] * (poses - inside) + ["in"] * inside
    goals = [pose_in_workspace(config, rng, "drill", WITH_SHOULDER[shoulder]) for shoulder in shoulders]
    settled = visit_poses(arm, reference, world, goals, "off", seed)
    return [_predict(config, s, shoulder == "in") for s, shoulder in zip(settled, shoulders, strict=True)]


def _load(index: int) -> tuple[float, float]:
    """Return mass [kg] of the stand-in turret and roll [rad] of the rover of a group of the campaign."""
    group = PAPER_GROUPS[index]
    assert group.turret_kg is not None
    return group.turret_kg, group.roll_rad


def shoulder_in(context: Context, poses: int = GROUP_POSES, groups: int = len(PAPER_GROUPS)) -> Document:
    """Predict the first groups, or all, and draw the picture where one is wanted."""
    if not 1 <= groups <= len(PAPER_GROUPS) or poses < 2:
        raise BadRequest(f"set: groups are 1 .. {len(PAPER_GROUPS)}, poses 2 or more")
    reference = initial_reference(arm_named("nominal"), context.seed)
    one_group = partial(group, seed=context.seed, poses=poses, reference=reference)
    found = context.each(one_group, ((number,) for number in range(groups)), "groups")
    if context.out is not None:
        problem = save_figure(context.out, (11, 4.2), 110, partial(draw, found))
        if problem is not None:
            raise BadOutput(problem)
    return summarize_predictions(found)


def _predict(config: Config, s: RestState, shoulder_in: bool) -> Prediction:
    pressed = settle(config.arm, s.motor_rad, config.half_backlash_rad, s.gravity_R_m_s2)
    believed = settle_output(config.arm, s.motor_rad + s.believed_gear_rad, s.gravity_R_m_s2)
    error_mm = [
        1e3 * float(np.linalg.norm(tool_pose(config.arm, pose.frames, "drill").p - s.p_RoTo_R_m))
        for pose in (pressed, believed)
    ]
    return Prediction(shoulder_in, error_mm[0], error_mm[1], int(np.count_nonzero(s.true_side < 0)))


def summarize_predictions(groups: Sequence[Sequence[Prediction]]) -> Document:
    """Return the mean errors."""
    every = [p for poses in groups for p in poses]
    found = {
        name: {
            "as_initialised_mm": _mean([p.as_initialised_mm for p in every if p.shoulder_in == inside]),
            "with_state_mm": _mean([p.with_state_mm for p in every if p.shoulder_in == inside]),
            "joints_on_other_side": _mean([p.joints_on_other_side for p in every if p.shoulder_in == inside]),
        }
        for name, inside in (("shoulder_out", False), ("shoulder_in", True))
    }
    in_bounds = [one["with_state_mm"] <= MOST_LEFT * one["as_initialised_mm"] for one in found.values()]
    return {"poses": len(every), "in_bounds": all(in_bounds), **found}


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def draw(groups: Sequence[Sequence[Prediction]], figure: Any) -> None:
    """Draw both prediction errors over the poses, as in the figure of the paper."""
    axes = figure.subplots()
    every = [p for poses in groups for p in poses]
    number = np.arange(1, len(every) + 1)
    for k, poses in enumerate(groups):
        inside = sum(p.shoulder_in for p in poses)
        last = (k + 1) * len(poses) + 0.5
        axes.axvspan(last - inside, last, color="0.92", label="shoulder-in" if k == 0 else None)
        mass_kg, roll_rad = _load(k)
        text, top = f"{mass_kg:g} kg, roll {np.degrees(roll_rad):.0f} deg", axes.get_xaxis_transform()
        axes.text(k * len(poses) + 1, 0.97, text, va="top", fontsize=8, transform=top)
    for name, colour, label in SERIES:
        axes.plot(number, [getattr(p, name) for p in every], ".-", color=colour, linewidth=0.6, label=label)
    axes.set(xlabel="pose", ylabel="position error of the drill [mm]")
    axes.set(xlim=(0, len(every) + 1), ylim=(0, None))
    figure.legend(loc="outside lower center", ncols=3, fontsize=9)
