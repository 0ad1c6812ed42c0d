"""What every arm of a blind case has of its own, with an effect or without, so that no simulator is it."""

from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from sim.arms import draw_calibration_errors
from sim.effects.effect import Effect
from sim.effects.joints import GearFriction
from sim.effects.numerics import Numerics
from sim.effects.sensors import CounterStart
from sim.initialisation import DAILY_FRICTION_SIGMA

NUMERICS: Final = Numerics("explicit", 7)
"""Finer and by another scheme than the solver's, and none that it knows; where steps are not much finer, that
scheme nearly diverges, and gears lie otherwise than finer computations have them."""


def background(rng: np.random.Generator) -> tuple[Effect, ...]:
    """Errors that a calibration leaves, friction of the day, counters anywhere, and another computation."""
    errors = draw_calibration_errors(int(rng.integers(2**31)))
    friction = tuple(
        GearFriction(joint, float(np.exp(DAILY_FRICTION_SIGMA * rng.standard_normal()))) for joint in Joint
    )
    counters = tuple(CounterStart(joint, float(rng.uniform(-np.pi, np.pi))) for joint in Joint)
    return (NUMERICS, *counters, *errors, *friction)
