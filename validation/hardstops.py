"""Campaign of repeated hardstops.

As-built arms find every hardstop many times, each time with another temperature, friction, noise and pose. On
Mars they have the turret and the planned poses. On Earth, a fifth as often, they have no turret. There the
poses are those of equal torque.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from fsw.dictionary.enums import Joint
from sim.arm_check import without_turret
from sim.arms import BuiltArm, arm_named
from sim.initialisation import prepare_random_homing
from sim.sequence import Outcome
from sim.setting import World
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document

ROUNDING: Final = 1e-9
Place = Literal["mars", "earth"]
PLACES: Final[tuple[Place, ...]] = ("mars", "earth")


@dataclass(frozen=True, slots=True)
class TrialResult:
    """Errors and loads of one repetition with one joint of one arm."""

    place: Place
    arm: int
    joint: Joint
    repetition: int
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


def run_trial(place: Place, number: int, joint: Joint, repetition: int) -> TrialResult:
    """Carry out a trial."""
    arm, world = arm_at(place, number)
    found = prepare_random_homing(arm, joint, world, 1000 * number + repetition).finish()
    errors_mrad = (np.nan, np.nan, np.nan)
    if found.outcome is Outcome.DONE:
        stop = found.stops[0]
        zero_mrad, plain_mrad = 1e3 * stop.zero_error_rad, 1e3 * stop.uncorrected_error_rad
        errors_mrad = (zero_mrad, plain_mrad, 1e3 * stop.half_backlash_error_rad)
    most = float(found.max_torque_Nm[joint]), float(found.max_current_ratio[joint])
    return TrialResult(place, number, joint, repetition, found.outcome.value, *errors_mrad, *most)


def campaign(context: Context, arms: int = 5, repeats: int = 50, joint: str = "") -> Document:
    """Run all trials of some as-built arms, at all joints or one; the same arguments give the same result."""
    if arms < 1 or repeats < 2 or joint not in ("", *Joint.__members__):
        raise BadRequest("set: arms are 1 or more, repeats 2 or more, the joint is a name like ELBOW")
    joints, seed = (Joint[joint],) if joint else tuple(Joint), context.seed
    trials = [
        (place, seed + arm, one, repetition)
        for place in PLACES
        for arm in range(arms)
        for one in joints
        for repetition in range(repeats if place == "mars" else max(2, repeats // 5))
    ]
    results = context.each(run_trial, trials, "trials")
    rated_Nm = [one.hardstop_rated_Nm for one in arm_named("nominal").params.joints.in_order()]
    never = {
        "failed": sum(r.outcome != "done" for r in results),
        "above_rated_torque": sum(r.max_torque_Nm > rated_Nm[r.joint] for r in results),
        "above_current_limit": sum(r.max_current_ratio > 1.0 + ROUNDING for r in results),
    }
    failed = (r for r in results if r.outcome != "done")
    found: Document = {"arms": arms, "repeats": repeats, "seed": seed, "in_bounds": not any(never.values())}
    for place in PLACES:
        own = {one: [r for r in results if (r.place, r.joint) == (place, one)] for one in joints}
        found[place] = {one.name.lower(): _summarize_joint(trials) for one, trials in own.items()}
    return {
        **found,
        **never,
        "failures": [
            f"{r.joint.name.lower()} of as-built:{r.arm}, {r.place}, trial {r.repetition}: {r.outcome}"
            for r in failed
        ],
        "earth_less_mars_mrad": {"equal torque": _mean_difference(results, joints)},
    }


def _summarize_joint(results: Sequence[TrialResult]) -> dict[str, Any]:
    """Compute the repeatability within an arm, and the means of the arms."""
    corrected, uncorrected = _by_arm(results), _by_arm(results, "uncorrected_mrad")
    means, plain = np.nanmean(corrected, axis=1), np.nanmean(uncorrected, axis=1)
    squares = [r.half_backlash_error_mrad**2 for r in results]
    return {
        "repeatability_3_sigma_mrad": 3 * float(np.sqrt(np.mean(np.nanvar(corrected, axis=1, ddof=1)))),
        "mean_error_worst_arm_mrad": float(np.abs(means).max()),
        "without_wind_up": {"mean_error_worst_arm_mrad": float(np.abs(plain).max())},
        "half_backlash_error_rms_mrad": float(np.sqrt(np.nanmean(squares))),
    }


def _mean_difference(results: Sequence[TrialResult], joints: Sequence[Joint]) -> dict[str, Any]:
    """Compute the largest difference of an arm's mean on Earth from its mean on Mars."""
    found = {}
    for joint in joints:
        of_joint = [r for r in results if r.joint is joint]
        mean = {p: np.nanmean(_by_arm([r for r in of_joint if r.place == p]), axis=1) for p in PLACES}
        found[joint.name.lower()] = {"zero_error": float(np.abs(mean["earth"] - mean["mars"]).max())}
    return found


def _by_arm(results: Sequence[TrialResult], name: str = "zero_error_mrad") -> np.ndarray:
    """Arrange a value of the results in an array, shape (arms, repetitions)."""
    arms = sorted({r.arm for r in results})
    rows = [sorted((r for r in results if r.arm == arm), key=lambda r: r.repetition) for arm in arms]
    return np.array([[getattr(r, name) for r in row] for row in rows])
