"""Built arms: sets of effects drawn at random, and what a calibration leaves unknown."""

from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint, Tool
from fsw.dictionary.types import Row6, row6
from sim.effects.effect import Effect
from sim.effects.geometry import FrameError
from sim.effects.joints import (
    BacklashWidth,
    GearFriction,
    GearStiffness,
    HardstopAngle,
    HardstopStiffness,
    ResolverBias,
)
from sim.effects.structure import LinkMass, LinkStiffness

# one sigma each, assumed; see models/mjcf/PROVENANCE.md
FRAME_RAD, FRAME_M = 2e-3, 1.5e-3
ZERO_RAD: Final = 4e-3
RESOLVER_RAD: Final = 2e-3
STIFFNESS, BACKLASH, MASS, FRICTION = 0.20, 0.10, 0.03, 0.20
COM_M: Final = 5e-3
LEFT_FRAME_RAD, LEFT_FRAME_M = 0.25e-3, 0.15e-3
LEFT_ZERO_RAD, LEFT_STIFFNESS = 0.2e-3, 0.03

SPRINGS: Final = (Frame.ARM1, Frame.ARM2, Frame.ARM3, Frame.ARM4, Frame.ARM5)
IDENTIFIABLE: Final[dict[Frame, tuple[int, ...]]] = {
    Frame.ARM1: (0, 1, 2, 3, 4, 5),
    Frame.ARM2: (0, 1, 2, 3),
    Frame.ARM3: (0, 1, 2, 3),
    Frame.ARM4: (0, 1, 2, 3),
    Frame.ARM5: (0, 3),
    Frame.ARM6: (),
    Frame.TOOL: (0, 1, 2, 3, 4, 5),
}
"""Frame screw axes that tool poses can tell apart: 26 of 42, the tool's first, then from the rover out."""


def as_built(seed: int) -> tuple[Effect, ...]:
    """An arm as it leaves the workshop."""
    rng = np.random.default_rng([seed, 0])
    effects: list[Effect] = []
    for frame, tool in _frames():
        effects.append(FrameError(frame, _screw(rng, FRAME_RAD, FRAME_M), tool))
    for joint in Joint:
        effects.append(HardstopAngle(joint, -ZERO_RAD * rng.standard_normal()))
        effects.append(ResolverBias(joint, RESOLVER_RAD * rng.standard_normal()))
        effects.append(BacklashWidth(joint, _factor(rng, BACKLASH)))
        effects.append(GearStiffness(joint, _factor(rng, STIFFNESS)))
        effects.append(GearFriction(joint, _factor(rng, FRICTION)))
    for frame in SPRINGS:
        effects.append(LinkStiffness(frame, _factor(rng, STIFFNESS)))
    for frame in (*SPRINGS[1:], Frame.ARM6):
        x, y, z = (float(v) for v in COM_M * rng.standard_normal(3))
        effects.append(LinkMass(frame, _factor(rng, MASS), (x, y, z)))
    for joint in Joint:
        effects.append(HardstopStiffness(joint, _factor(rng, STIFFNESS)))
    return tuple(effects)


def left_by_calibration(seed: int) -> tuple[Effect, ...]:
    """By how much flight parameters still miss the truth of arm `seed` after a calibration."""
    rng = np.random.default_rng([seed, 1])
    effects: list[Effect] = []
    for frame, tool in _frames():
        seen = np.isin(np.arange(6), IDENTIFIABLE[frame])
        screw = np.where(seen, _screw(rng, LEFT_FRAME_RAD, LEFT_FRAME_M), 0.0)
        effects.append(FrameError(frame, row6(screw), tool))
    for joint in Joint:
        effects.append(HardstopAngle(joint, -LEFT_ZERO_RAD * rng.standard_normal()))
        effects.append(GearStiffness(joint, _factor(rng, LEFT_STIFFNESS)))
    for frame in SPRINGS:
        effects.append(LinkStiffness(frame, _factor(rng, LEFT_STIFFNESS)))
    return tuple(effects)


def _frames() -> list[tuple[Frame, Tool | None]]:
    inner: list[tuple[Frame, Tool | None]] = [(frame, None) for frame in Frame if frame is not Frame.TOOL]
    return inner + [(Frame.TOOL, tool) for tool in Tool]


def _factor(rng: np.random.Generator, sigma: float) -> float:
    """Log-normal about one: a stiffness drawn at random stays positive."""
    return float(np.exp(sigma * rng.standard_normal()))


def _screw(rng: np.random.Generator, angle_rad: float, length_m: float) -> Row6:
    return row6(rng.standard_normal(6) * np.repeat([angle_rad, length_m], 3))
