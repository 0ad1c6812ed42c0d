"""Arms that can be simulated, by name, and their random manufacturing tolerances."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Row6, row6
from sim.effects.effect import Effect, check_effects, params_with_effects
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
from sim.params import nominal_params

# assumed, one sigma each; see models/mjcf/PROVENANCE.md
FRAME_SIGMA_RAD, FRAME_SIGMA_M = 2e-3, 1.5e-3
ZERO_SIGMA_RAD: Final = 4e-3
RESOLVER_SIGMA_RAD: Final = 2e-3
STIFFNESS_SIGMA, BACKLASH_SIGMA, MASS_SIGMA, FRICTION_SIGMA = 0.20, 0.10, 0.03, 0.20
COM_SIGMA_M: Final = 5e-3
CALIBRATED_FRAME_SIGMA_RAD, CALIBRATED_FRAME_SIGMA_M = 0.25e-3, 0.15e-3
CALIBRATED_ZERO_SIGMA_RAD, CALIBRATED_STIFFNESS_SIGMA = 0.2e-3, 0.03
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


class UnknownArm(ValueError):
    """Name that is not an arm."""


@dataclass(frozen=True, slots=True)
class BuiltArm:
    """Arm: its differences from the drawing, and its flight parameters."""

    name: str
    effects: tuple[Effect, ...]
    params: Params

    def with_effects(self, effects: Iterable[Effect]) -> "BuiltArm":
        """Return the arm with those of these effects that it has before a run begins.

        Raises:
            EffectMisfit: one of them is at a tool or a contact switch that the arm does not have.
        """
        effects = tuple(effects)
        check_effects(effects, self.params)
        return replace(self, effects=(*self.effects, *(effect for effect in effects if effect.built_in)))


def arm_named(name: str, params: Params | None = None) -> BuiltArm:
    """Make the arm of this name: `nominal`, `as-built:SEED` or `calibrated:SEED`.

    `params` replaces the nominal flight parameters. The tolerances depend on the seed alone.

    Raises:
        UnknownArm: the name has none of these forms.
    """
    flight_params = params or nominal_params()
    if name == "nominal":
        return BuiltArm(name, (), flight_params)
    match = re.fullmatch(r"(as-built|calibrated):([0-9]{1,9})", name)
    if match is None:
        raise UnknownArm(f"arm {name!r} is not known; write nominal, as-built:SEED or calibrated:SEED")
    seed = int(match[2])
    effects = draw_tolerances(flight_params.tool_names, seed)
    if match[1] == "calibrated":
        flight_params = params_with_effects(
            (*effects, *draw_calibration_errors(flight_params.tool_names, seed)), flight_params
        )
    return BuiltArm(name, effects, replace(flight_params, arm_name=name))


def effects_of_run(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects that begin with a run, not with the making of the arm."""
    return tuple(effect for effect in effects if not effect.built_in)


def draw_tolerances(tools: Sequence[str], seed: int) -> tuple[Effect, ...]:
    """Draw the manufacturing tolerances of an as-built arm."""
    rng = np.random.default_rng([seed, 0])
    effects: list[Effect] = []
    for frame, tool in _all_frames(tools):
        effects.append(FrameError(frame, _draw_screw(rng, FRAME_SIGMA_RAD, FRAME_SIGMA_M), tool))
    for joint in Joint:
        effects.append(HardstopAngle(joint, -ZERO_SIGMA_RAD * rng.standard_normal()))
        effects.append(ResolverBias(joint, RESOLVER_SIGMA_RAD * rng.standard_normal()))
        effects.append(BacklashWidth(joint, _draw_factor(rng, BACKLASH_SIGMA)))
        effects.append(GearStiffness(joint, _draw_factor(rng, STIFFNESS_SIGMA)))
        effects.append(GearFriction(joint, _draw_factor(rng, FRICTION_SIGMA)))
    for frame in SPRING_FRAMES:
        effects.append(LinkStiffness(frame, _draw_factor(rng, STIFFNESS_SIGMA)))
    for frame in (*SPRING_FRAMES[1:], Frame.ARM6):
        x, y, z = (float(v) for v in COM_SIGMA_M * rng.standard_normal(3))
        effects.append(LinkMass(frame, _draw_factor(rng, MASS_SIGMA), (x, y, z)))
    for joint in Joint:
        effects.append(HardstopStiffness(joint, _draw_factor(rng, STIFFNESS_SIGMA)))
    return tuple(effects)


def draw_calibration_errors(tools: Sequence[str], seed: int) -> tuple[Effect, ...]:
    """Draw the errors that flight parameters of arm `seed` keep after a calibration."""
    rng = np.random.default_rng([seed, 1])
    effects: list[Effect] = []
    for frame, tool in _all_frames(tools):
        determined = np.isin(np.arange(6), IDENTIFIABLE_AXES[frame])
        screw = np.where(
            determined, _draw_screw(rng, CALIBRATED_FRAME_SIGMA_RAD, CALIBRATED_FRAME_SIGMA_M), 0.0
        )
        effects.append(FrameError(frame, row6(screw), tool))
    for joint in Joint:
        effects.append(HardstopAngle(joint, -CALIBRATED_ZERO_SIGMA_RAD * rng.standard_normal()))
        effects.append(GearStiffness(joint, _draw_factor(rng, CALIBRATED_STIFFNESS_SIGMA)))
    for frame in SPRING_FRAMES:
        effects.append(LinkStiffness(frame, _draw_factor(rng, CALIBRATED_STIFFNESS_SIGMA)))
    return tuple(effects)


def _all_frames(tools: Sequence[str]) -> list[tuple[Frame, str | None]]:
    inner: list[tuple[Frame, str | None]] = [(frame, None) for frame in Frame if frame is not Frame.TOOL]
    return inner + [(Frame.TOOL, tool) for tool in tools]


def _draw_factor(rng: np.random.Generator, sigma: float) -> float:
    """Draw a log-normal factor with median 1, so that a stiffness stays positive."""
    return float(np.exp(sigma * rng.standard_normal()))


def _draw_screw(rng: np.random.Generator, angle_rad: float, length_m: float) -> Row6:
    return row6(rng.standard_normal(6) * np.repeat([angle_rad, length_m], 3))
