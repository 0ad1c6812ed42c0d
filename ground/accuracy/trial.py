"""One arm of a Monte Carlo: its errors drawn, moved to places of the workspace, measured at the tool."""

from dataclasses import replace
from typing import Final, Literal

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import BacklashMode
from fsw.dictionary.enums import Tool
from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from ground.accuracy.drawn import drawn_effects
from ground.accuracy.places import Measured, measured, random_places
from ground.accuracy.sources import Case, ErrorModel, is_compensated
from ground.accuracy.ways import by_closed_loop, by_statics
from sim.arms import BuiltArm, arm_named
from sim.effects.environment import Ambient
from sim.initialisation import RANDOM_TEMPERATURE_C, initial_reference, true_reference

How = Literal["closed-loop", "statics"]
OF_THE_ARM: Final = ("assembly", "calibration", "deflection", "zero_offset", "backlash")
"""Sources that an arm has which was built, calibrated and initialised."""


def drawn_trial(
    model: ErrorModel, case: Case, params: Params, places: int, how: How, seed: np.random.SeedSequence
) -> list[Measured]:
    """An arm of a case, drawn from this seed, at so many places.

    Raises:
        RuntimeError: a move in the closed loop did not come to its end.
    """
    draw, own = seed.spawn(2)
    rng = np.random.default_rng(draw)
    tool = Tool(int(rng.integers(len(Tool))))
    effects = drawn_effects(model, case, tool, rng)
    backlash: BacklashMode = "on" if is_compensated(case.sources.get("backlash", 0.0)) else "off"
    arm = BuiltArm("drawn", effects, params)
    moved = by_statics(arm, backlash) if how == "statics" else by_closed_loop(arm, _believed(arm), backlash)
    return measured(moved, random_places(params, tool, places, own))


def built_trial(
    model: ErrorModel,
    case: Case,
    name: str,
    params: Params,
    places: int,
    how: How,
    seed: np.random.SeedSequence,
) -> list[Measured]:
    """An arm with errors of its own, initialised at its hardstops, in the cold, with what the case adds.

    Raises:
        RuntimeError: it was not initialised, or a move in the closed loop did not come to its end.
    """
    draw, own = seed.spawn(2)
    rng = np.random.default_rng(draw)
    tool = Tool(int(rng.integers(len(Tool))))
    added = {name: factor for name, factor in case.sources.items() if name not in OF_THE_ARM}
    cold = Ambient(float(rng.uniform(*RANDOM_TEMPERATURE_C)))
    arm = arm_named(name, params)
    effects = (cold, *drawn_effects(model, replace(case, sources=added), tool, rng))
    there = replace(arm, effects=(*arm.effects, *effects))
    moved = (
        by_statics(there, "on") if how == "statics" else by_closed_loop(there, initial_reference(arm), "on")
    )
    return measured(moved, random_places(arm.params, tool, places, own))


def _believed(arm: BuiltArm) -> Reference:
    """Zeros as a faultless initialisation would find them, gaps as the parameters have them."""
    return replace(true_reference(arm), half_gap_rad=configure(arm.params).half_gap_rad)
