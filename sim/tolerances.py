"""Tolerances of built arms: how they differ from their drawing, and what a calibration leaves."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import Row6, row6
from sim.arm_model.load import ArmModel
from sim.effects.effect import Effect
from sim.effects.geometry import Expansion, FrameError
from sim.effects.joints import (
    BacklashWidth,
    GearFriction,
    GearStiffness,
    HardstopAngle,
    HardstopStiffness,
    ResolverBias,
)
from sim.effects.sensors import StructureSensor
from sim.effects.structure import LinkMass, LinkStiffness

SPRING_FRAMES: Final = (Frame.ARM1, Frame.ARM2, Frame.ARM3, Frame.ARM4, Frame.ARM5)
IDENTIFIABLE_AXES: Final[dict[Frame, tuple[int, ...]]] = {
    Frame.ARM1: (0, 1, 2, 3, 4, 5),
    Frame.ARM2: (0, 1, 2, 3),
    Frame.ARM3: (0, 1, 2, 3),
    Frame.ARM4: (0, 1, 2, 3),
    Frame.ARM5: (0, 3),
    Frame.ARM6: (),
    Frame.TOOL: (0, 1, 2, 3, 4, 5),
}
"""Axes of the frame screws that tool poses can determine: 26 of 42, those of the tool first."""


def draw_tolerances(model: ArmModel, seed: int) -> tuple[Effect, ...]:
    """Draw the manufacturing tolerances of an as-built arm."""
    rng, sigma = np.random.default_rng([seed, 0]), model.description.tolerances.built
    effects: list[Effect] = []
    for frame, tool in list_frames(model.params.tool_names):
        effects.append(FrameError(frame, _draw_screw(rng, sigma.frame_rad, sigma.frame_m), tool))
    for joint in Joint:
        effects.append(HardstopAngle(joint, -sigma.hardstop_rad * rng.standard_normal()))
        effects.append(ResolverBias(joint, sigma.resolver_rad * rng.standard_normal()))
        effects.append(BacklashWidth(joint, _draw_factor(rng, sigma.backlash_share)))
        effects.append(GearStiffness(joint, _draw_factor(rng, sigma.stiffness_share)))
        effects.append(GearFriction(joint, _draw_factor(rng, sigma.friction_share)))
    for frame in SPRING_FRAMES:
        effects.append(LinkStiffness(frame, _draw_factor(rng, sigma.stiffness_share)))
    for frame in (*SPRING_FRAMES[1:], Frame.ARM6):
        x, y, z = (float(v) for v in sigma.com_m * rng.standard_normal(3))
        effects.append(LinkMass(frame, _draw_factor(rng, sigma.mass_share), (x, y, z)))
    for joint in Joint:
        effects.append(HardstopStiffness(joint, _draw_factor(rng, sigma.stiffness_share)))
    for frame, tool in list_frames(model.params.tool_names):
        effects.append(Expansion(frame, _draw_factor(rng, sigma.expansion_share), tool))
    effects.append(StructureSensor(sigma.structure_sensor_K * rng.standard_normal()))
    return tuple(effects)


def draw_calibration_errors(model: ArmModel, seed: int) -> tuple[Effect, ...]:
    """Draw the errors that flight parameters of arm `seed` keep after a calibration."""
    rng, sigma = np.random.default_rng([seed, 1]), model.description.tolerances.calibrated
    effects: list[Effect] = []
    for frame, tool in list_frames(model.params.tool_names):
        determined = np.isin(np.arange(6), IDENTIFIABLE_AXES[frame])
        screw = np.where(determined, _draw_screw(rng, sigma.frame_rad, sigma.frame_m), 0.0)
        effects.append(FrameError(frame, row6(screw), tool))
    for joint in Joint:
        effects.append(HardstopAngle(joint, -sigma.hardstop_rad * rng.standard_normal()))
        effects.append(GearStiffness(joint, _draw_factor(rng, sigma.stiffness_share)))
    for frame in SPRING_FRAMES:
        effects.append(LinkStiffness(frame, _draw_factor(rng, sigma.stiffness_share)))
    return tuple(effects)


def is_calibrated(effect: Effect) -> bool:
    """Return whether a calibration finds an effect: at one temperature it does not show the expansion."""
    return not isinstance(effect, Expansion)


def list_frames(tools: Sequence[str]) -> list[tuple[Frame, str | None]]:
    """List all frames, that of each tool with its name."""
    inner: list[tuple[Frame, str | None]] = [(frame, None) for frame in Frame if frame is not Frame.TOOL]
    return inner + [(Frame.TOOL, tool) for tool in tools]


def _draw_factor(rng: np.random.Generator, sigma: float) -> float:
    """Draw a log-normal factor with median 1, so that a stiffness stays positive."""
    return float(np.exp(sigma * rng.standard_normal()))


def _draw_screw(rng: np.random.Generator, angle_rad: float, length_m: float) -> Row6:
    return row6(rng.standard_normal(6) * np.repeat([angle_rad, length_m], 3))
