"""Arm that a solver does not know: random effects of detectable size, its random background, and its logs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.campaign_sensitivities import NOMINAL
from marsarm.diagnosis.arm.record import record_campaign
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.problem import BOUND_SHARE, Hypothesis
from sim.arms import BuiltArm, arm_named, effects_of_run
from sim.diagnosis_campaign import DiagnosisSession
from sim.effects.effect import Effect
from sim.effects.environment import Numerics
from sim.effects.joints import GearFriction
from sim.effects.sensors import CounterStart
from sim.initialisation import DAILY_FRICTION_SIGMA, true_reference
from sim.tolerances import draw_calibration_errors
from simgap.common.progress import Progress, no_progress

PLANT_NUMERICS: Final = Numerics("explicit", 7)
"""Numerics of the plant: finer than the solver's, and of a scheme that the solver does not know. With steps
that are not much finer, this scheme nearly diverges, and gears settle elsewhere than with finer steps."""
LIMIT_MULTIPLES: Final = (0.5, 4.0)
"""Range of the sampled amplitudes, in detection limits."""


@dataclass(frozen=True, slots=True)
class DetectableEffect:
    """Effect with its detection limit in typical sizes and its class; None for an out-of-catalogue effect."""

    hypothesis: Hypothesis
    limit: float
    label: int | None


@dataclass(frozen=True, slots=True, eq=False)
class SampledEffect:
    """Sampled effect: its departures in typical sizes, shape (n,), and its amplitude in detection limits."""

    source: DetectableEffect
    departures: Array
    times_limit: float

    def switch_on(self) -> Effect:
        """Return the effect of the plant."""
        return self.source.hypothesis.switch_on(self.departures)


def can_sample(one: DetectableEffect, multiples: tuple[float, float] = LIMIT_MULTIPLES) -> bool:
    """Check that the campaign detects the effect and that its bounds allow the smallest amplitude."""
    room = max(_room(one, sign) for sign in (-1, 1))
    return bool(np.isfinite(one.limit)) and room >= multiples[0] * one.limit


def sample_effect(some: Sequence[DetectableEffect], rng: np.random.Generator) -> DetectableEffect:
    """Sample an effect uniformly, then one of its places: many places do not make it more frequent."""
    names = sorted({one.hypothesis.effect for one in some})
    name = names[int(rng.integers(len(names)))]
    places = [one for one in some if one.hypothesis.effect == name]
    return places[int(rng.integers(len(places)))]


def sample_amplitude(
    one: DetectableEffect, rng: np.random.Generator, multiples: tuple[float, float] = LIMIT_MULTIPLES
) -> SampledEffect:
    """Sample an amplitude within multiples of the detection limit, log-uniformly, with a random sign.

    It stays within the bounds. All parameters depart from neutral by the same number of typical sizes.
    """
    times = float(np.exp(rng.uniform(*np.log(multiples))))
    sign = int(rng.choice((-1, 1)))
    if _room(one, sign) < multiples[0] * one.limit:
        sign = -sign
    typical = min(times * one.limit, _room(one, sign))
    departures = np.full(len(one.hypothesis.parameters), sign * typical)
    return SampledEffect(one, departures, typical / one.limit)


def list_detectable(model: DiagnosisModel, limits: Array) -> list[DetectableEffect]:
    """List the hypotheses of a model with their equivalence classes.

    Args:
        limits: Detection limits, without a unit (typical sizes), shape (h,).
    """
    rows = zip(model.sensitivities.hypotheses, limits.tolist(), model.label.tolist(), strict=True)
    return [DetectableEffect(*row) for row in rows]


def _room(one: DetectableEffect, sign: int) -> float:
    """Return how many typical sizes all amplitudes together may depart to one side."""
    ends = [parameter.departure_range for parameter in one.hypothesis.parameters]
    return BOUND_SHARE * min(most if sign > 0 else -least for least, most in ends)


def sample_background(rng: np.random.Generator, arm: str = NOMINAL) -> tuple[Effect, ...]:
    """Sample what a calibration of an arm leaves, friction of the day, counter offsets, other numerics."""
    errors = draw_calibration_errors(arm_named(arm).model, int(rng.integers(2**31)))
    friction = tuple(
        GearFriction(joint, float(np.exp(DAILY_FRICTION_SIGMA * rng.standard_normal()))) for joint in Joint
    )
    counters = tuple(CounterStart(joint, float(rng.uniform(-np.pi, np.pi))) for joint in Joint)
    return (PLANT_NUMERICS, *counters, *errors, *friction)


def record_blind(
    folder: Path,
    effects: tuple[Effect, ...],
    sessions: Sequence[DiagnosisSession],
    seed: int,
    progress: Progress,
    arm: str = NOMINAL,
) -> bool:
    """Record sessions of an arm with effects in a folder; return whether every motion completed."""
    built = arm_named(arm).with_effects(effects)
    reference, begun = blind_reference(built, arm), effects_of_run(effects)
    numbers = np.random.default_rng(seed).integers(2**31, size=len(sessions))
    made = []
    for done, (session, number) in enumerate(zip(sessions, numbers, strict=True)):
        progress(done, len(sessions), "recording")
        made += record_campaign(folder, [session], built, reference, int(number), no_progress, begun)
    return len(made) == len(sessions)


def blind_reference(built: BuiltArm, arm: str) -> Reference:
    """Return the joint zeros that homing of a built arm finds; all else is that of the named one."""
    return replace(nominal_reference(arm), zero_rad=true_reference(built).zero_rad)


@cache
def nominal_reference(arm: str = NOMINAL) -> Reference:
    """Return the homing result of a named arm; computed once in each process."""
    return true_reference(arm_named(arm))
