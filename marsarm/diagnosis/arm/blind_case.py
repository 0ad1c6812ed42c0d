"""Recording of an arm that a solver does not know: the random background of every arm, and its logs."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from marsarm.diagnosis.arm.record import record_campaign
from sim.arm_model.load import default_arm
from sim.arms import BuiltArm, arm_named, draw_calibration_errors, effects_of_run
from sim.diagnosis_campaign import DiagnosisSession, SessionFailed
from sim.effects.effect import Effect
from sim.effects.environment import Numerics
from sim.effects.joints import GearFriction
from sim.effects.sensors import CounterStart
from sim.initialisation import DAILY_FRICTION_SIGMA, true_reference
from sim.plant import PlantDiverged
from simgap.common.progress import Progress, no_progress

PLANT_NUMERICS: Final = Numerics("explicit", 7)
"""Numerics of the plant: finer than the solver's, and of a scheme that the solver does not know. With steps
that are not much finer, this scheme nearly diverges, and gears settle elsewhere than with finer steps."""


def sample_background(rng: np.random.Generator) -> tuple[Effect, ...]:
    """Sample the errors left by a calibration, friction of the day, counter offsets and other numerics."""
    errors = draw_calibration_errors(default_arm(), int(rng.integers(2**31)))
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
) -> bool:
    """Record sessions of an arm with effects; one whose motion does not complete gets no log.

    Args:
        folder: Folder of the logs.
        effects: Effects that are switched on, and numerics.
        sessions: Sessions of the campaign.
        seed: Seed of the sensor noise.
        progress: Called with done, total and step.

    Returns:
        True if all sessions have a log.
    """
    arm = arm_named("nominal").with_effects(effects)
    reference, begun = blind_reference(arm), effects_of_run(effects)
    is_complete = True
    numbers = np.random.default_rng(seed).integers(2**31, size=len(sessions))
    for done, (session, number) in enumerate(zip(sessions, numbers, strict=True)):
        progress(done, len(sessions), "recording")
        try:
            record_campaign(folder, [session], arm, reference, int(number), no_progress, begun)
        except (SessionFailed, PlantDiverged):
            (folder / f"{session.name}.mcap").unlink(missing_ok=True)
            is_complete = False
    return is_complete


def blind_reference(arm: BuiltArm) -> Reference:
    """Return the joint zeros that homing of this arm finds; all else is nominal."""
    return replace(nominal_reference(), zero_rad=true_reference(arm).zero_rad)


@cache
def nominal_reference() -> Reference:
    """Return the homing result of the nominal arm; computed once in each process."""
    return true_reference(arm_named("nominal"))
