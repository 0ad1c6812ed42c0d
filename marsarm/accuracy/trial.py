"""Trial of one arm of a Monte Carlo: sample its errors, move it to placements, measure at the tool."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import BacklashMode
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import row6
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array
from marsarm.accuracy.placements import (
    MeasuredPlacement,
    closed_loop_model,
    configure_believed,
    measure_placements,
    random_placements,
    statics_model,
)
from marsarm.accuracy.request import MoveModel
from marsarm.accuracy.sources import BudgetCase, Distribution, ErrorModel, ErrorSource, is_compensated
from sim.arms import BuiltArm, arm_named
from sim.effects.effect import Effect
from sim.effects.environment import Ambient, StructureTemperature
from sim.effects.geometry import Expansion, FrameError, FramePlay
from sim.effects.joints import BacklashWidth, GearStiffness, HardstopAngle, ServoError, Windup
from sim.effects.structure import LinkStiffness
from sim.initialisation import RANDOM_TEMPERATURE_C, initial_reference, true_reference
from sim.world import WARM_C

Z_TURN = 2
"""Index of the rotation about z in a screw."""
ARM_SOURCES: Final = (
    "assembly",
    "calibration",
    "deflection",
    "rover_stiffness",
    "zero_offset",
    "backlash",
    "distortion_bulk",
)
"""Sources that a built, calibrated and initialised arm has itself."""


def sample_effects(
    model: ErrorModel, case: BudgetCase, tool: str, rng: np.random.Generator
) -> tuple[Effect, ...]:
    """Sample an arm with all sources of a case; errors of tool frames apply to this tool."""
    effects: list[Effect] = []
    for name, factor in case.sources.items():
        effects.extend(sample_source(model.source[name], factor, tool, rng))
    return tuple(effects)


def sample_source(
    source: ErrorSource, factor: float, tool: str, rng: np.random.Generator
) -> Iterator[Effect]:
    """Sample the effects of one source with a factor of its magnitude.

    Backlash without compensation keeps its width. With compensation, the factor is the error of the width.
    """
    theta, share = factor * source.theta, factor * source.share_by_frame
    match source.effect:
        case "frame error":
            for frame in _frames(theta):
                yield FrameError(
                    frame,
                    row6(theta[:, frame] * sample_errors(source.distribution, 6, rng)),
                    _tool_of(frame, tool),
                )
        case "frame play":
            for frame in _frames(theta):
                yield FramePlay(frame, row6(theta[:, frame]), _tool_of(frame, tool))
        case "servo error":
            yield from (ServoError(joint, float(theta[Z_TURN, joint])) for joint in Joint)
        case "windup":
            yield from (Windup(joint, float(theta[Z_TURN, joint])) for joint in Joint)
        case "hardstop angle":
            shift = theta[Z_TURN, : len(Joint)] * sample_errors(source.distribution, len(Joint), rng)
            yield from (HardstopAngle(joint, float(shift[joint])) for joint in Joint)
        case "backlash":
            width_factor = 1 + factor * sample_errors(source.distribution, len(Joint), rng) * is_compensated(
                factor
            )
            yield from (BacklashWidth(joint, float(width_factor[joint])) for joint in Joint)
        case "stiffness":
            stiffness_factor = 1 / (1 + share[:5] * sample_errors(source.distribution, len(Joint), rng))
            for joint in [joint for joint in Joint if share[joint]]:
                yield LinkStiffness(Frame(joint), float(stiffness_factor[joint]))
                yield GearStiffness(joint, float(stiffness_factor[joint]))
        case "warming":
            yield StructureTemperature(WARM_C - source.warming_K)
            expansion = 1 + share * sample_errors(source.distribution, len(Frame), rng)
            yield from (Expansion(frame, float(expansion[frame]), _tool_of(frame, tool)) for frame in Frame)


def sample_errors(distribution: Distribution, count: int, rng: np.random.Generator) -> Array:
    """Sample errors of magnitude 1.

    Args:
        distribution: Distribution of the errors.
        count: Number of errors.

    Returns:
        Errors, shape (count,).
    """
    match distribution:
        case "normal":
            return rng.standard_normal(count) / 3
        case "uniform":
            return rng.uniform(-1.0, 1.0, count)
        case "either side":
            return rng.choice([-1.0, 1.0], count)


def _frames(theta: Array) -> list[Frame]:
    return [frame for frame in Frame if theta[:, frame].any()]


def _tool_of(frame: Frame, tool: str) -> str | None:
    return tool if frame is Frame.TOOL else None


def run_sampled_trial(
    model: ErrorModel,
    case: BudgetCase,
    params: Params,
    places: int,
    move_model: MoveModel,
    seed: np.random.SeedSequence,
) -> list[MeasuredPlacement]:
    """Sample an arm of a case and measure it at random placements.

    Raises:
        RuntimeError: A move in the closed loop failed.
    """
    sample_seed, placement_seed = seed.spawn(2)
    rng = np.random.default_rng(sample_seed)
    tool = params.tool_names[int(rng.integers(len(params.tools)))]
    effects = sample_effects(model, case, tool, rng)
    backlash: BacklashMode = "on" if is_compensated(case.sources.get("backlash", 0.0)) else "off"
    arm = BuiltArm("drawn", effects, params)
    believed = configure_believed(arm)
    move = (
        statics_model(arm, believed, backlash)
        if move_model == "statics"
        else closed_loop_model(arm, _exact_reference(arm), backlash)
    )
    return measure_placements(move, random_placements(believed, tool, places, placement_seed))


def run_built_trial(
    model: ErrorModel,
    case: BudgetCase,
    name: str,
    params: Params,
    places: int,
    move_model: MoveModel,
    seed: np.random.SeedSequence,
) -> list[MeasuredPlacement]:
    """Measure a built arm at random placements.

    The arm has errors of its own and those that the case adds. It was initialised at its hardstops.

    Raises:
        RuntimeError: The arm was not initialised, or a move in the closed loop failed.
    """
    sample_seed, placement_seed = seed.spawn(2)
    rng = np.random.default_rng(sample_seed)
    tool = params.tool_names[int(rng.integers(len(params.tools)))]
    added = {name: factor for name, factor in case.sources.items() if name not in ARM_SOURCES}
    cold = Ambient(float(rng.uniform(*RANDOM_TEMPERATURE_C)))
    arm = arm_named(name, params)
    effects = (*sample_effects(model, replace(case, sources=added), tool, rng), cold)
    tested = replace(arm, effects=(*arm.effects, *effects))
    believed = configure_believed(tested)
    move = (
        statics_model(tested, believed, "on")
        if move_model == "statics"
        else closed_loop_model(tested, initial_reference(arm), "on")
    )
    return measure_placements(move, random_placements(believed, tool, places, placement_seed))


def _exact_reference(arm: BuiltArm) -> Reference:
    """Build the reference of an initialisation without errors, with the nominal backlash."""
    return replace(true_reference(arm), half_backlash_rad=configure(arm.params).half_backlash_rad)
