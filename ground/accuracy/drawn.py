"""The sources of error as effects in the plant: systematic ones drawn once an arm, random ones each move."""

from collections.abc import Iterator

import numpy as np

from fsw.dictionary.enums import Frame, Joint, Tool
from fsw.dictionary.types import row6
from fsw.kinematics.transforms import Array
from ground.accuracy.sources import Case, ErrorModel, Source, Spread, is_compensated
from sim.effects.effect import Effect
from sim.effects.geometry import FrameError, LinkWarming
from sim.effects.joints import BacklashWidth, GearStiffness, HardstopAngle
from sim.effects.move_disturbances import FramePlay, ServoError, Windup
from sim.effects.structure import LinkStiffness

Z_TURN = 2
"""Of a screw: the turn about z."""


def drawn_effects(model: ErrorModel, case: Case, tool: Tool, rng: np.random.Generator) -> tuple[Effect, ...]:
    """An arm with all sources of a case at their magnitudes; errors of tool frames are this tool's."""
    effects: list[Effect] = []
    for name, factor in case.sources.items():
        effects.extend(effects_of(model.source[name], factor, tool, rng))
    return tuple(effects)


def effects_of(source: Source, factor: float, tool: Tool, rng: np.random.Generator) -> Iterator[Effect]:
    """One source at so many times its magnitude.

    A gap that nothing allows for is as it is; where one is allowed for, its width is off by this share.
    """
    theta, share = factor * source.theta, factor * source.share
    match source.effect:
        case "frame error":
            for frame in _frames(theta):
                yield FrameError(
                    frame, row6(theta[:, frame] * drawn(source.spread, 6, rng)), _at(frame, tool)
                )
        case "frame play":
            for frame in _frames(theta):
                yield FramePlay(frame, row6(theta[:, frame]), _at(frame, tool))
        case "servo error":
            yield from (ServoError(joint, float(theta[Z_TURN, joint])) for joint in Joint)
        case "windup":
            yield from (Windup(joint, float(theta[Z_TURN, joint])) for joint in Joint)
        case "hardstop angle":
            shift = theta[Z_TURN, : len(Joint)] * drawn(source.spread, len(Joint), rng)
            yield from (HardstopAngle(joint, float(shift[joint])) for joint in Joint)
        case "backlash":
            wider = 1 + factor * drawn(source.spread, len(Joint), rng) * is_compensated(factor)
            yield from (BacklashWidth(joint, float(wider[joint])) for joint in Joint)
        case "stiffness":
            stiffer = 1 / (1 + share * drawn(source.spread, len(Joint), rng))
            for joint in Joint:
                yield LinkStiffness(Frame(joint), float(stiffer[joint]))
                yield GearStiffness(joint, float(stiffer[joint]))
        case "warming":
            warming_K = share * source.warming_K * drawn(source.spread, len(Frame), rng)
            yield from (LinkWarming(frame, float(warming_K[frame]), _at(frame, tool)) for frame in Frame)


def drawn(spread: Spread, count: int, rng: np.random.Generator) -> Array:
    """Errors of magnitude 1."""
    match spread:
        case "normal":
            return rng.standard_normal(count) / 3
        case "uniform":
            return rng.uniform(-1.0, 1.0, count)
        case "either side":
            return rng.choice([-1.0, 1.0], count)


def _frames(theta: Array) -> list[Frame]:
    return [frame for frame in Frame if theta[:, frame].any()]


def _at(frame: Frame, tool: Tool) -> Tool | None:
    return tool if frame is Frame.TOOL else None
