"""Nuisance parameters of the arm: errors left by a calibration, and friction that varies from day to day."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import row6
from marsarm.diagnosis.arm.rest_poses import STEP_NUMERICS
from marsarm.diagnosis.problem import LOG_UNIT, Nuisance
from sim.arm_model.load import default_arm
from sim.arms import IDENTIFIABLE_AXES, SPRING_FRAMES, list_frames
from sim.effects.catalogue import effect_name
from sim.effects.effect import Effect
from sim.effects.environment import Numerics
from sim.effects.geometry import FrameError
from sim.effects.joints import GearFriction, GearStiffness, HardstopAngle, ResolverBias
from sim.effects.sensors import CurrentBias, EncoderZero
from sim.effects.structure import LinkStiffness
from sim.initialisation import DAILY_FRICTION_SIGMA
from sim.params import nominal_params
from sim.plant import SCREW_AXES

NUMERICS: Final = {"time step": STEP_NUMERICS, "scheme": Numerics("explicit", 6)}
"""Other numerics of the plant. The integrator is of first order, so that twice the change by half the time
step is the change to the limit of short steps; the explicit scheme, whose steps cannot be as long, has an
error of its own at 21 steps, which looks like friction at the elbow."""
LEFT: Final = default_arm().description.tolerances.calibrated
"""Errors that a calibration leaves."""
COUNT_RAD: Final = 3.3e-6
"""Encoder count: the position of a set-point within a count is random but constant."""
NUMERICS_SIGMA: Final = 2.0
"""Prior sigma of numerical errors, in differences to half the time step."""
_TURN_SHIFT: Final = ({"rad": "link-angle", "m": "link-length"}, {"rad": "tool-turn", "m": "tool-offset"})
"""Effects of rotation and shift, of frames and of tools."""


@dataclass(frozen=True, slots=True)
class NuisanceEffect:
    """Nuisance parameter, and the effect that it switches on."""

    nuisance: Nuisance
    effect: Callable[[float], Effect]
    """Effect for a departure."""
    same_as: str
    """Name of the hypothesis or nuisance that equals it for small departures."""
    one_sided: bool = False
    """One-sided nuisance: it departs only to positive values."""
    only_place: str = ""
    """Place of the only features that it influences; empty for all."""


def list_nuisance_effects() -> Iterator[NuisanceEffect]:
    """Yield calibration errors (sim.arms), friction of the day, and numerical errors."""
    yield from _frame_nuisances()
    for joint in Joint:
        yield _joint_nuisance(joint, "zero", "rad", LEFT.hardstop_rad, HardstopAngle)
        yield _joint_nuisance(joint, "gear stiffness", LOG_UNIT, LEFT.stiffness_share, GearStiffness)
        yield _joint_nuisance(joint, "friction", LOG_UNIT, DAILY_FRICTION_SIGMA, GearFriction)
    for frame in SPRING_FRAMES:
        yield _joint_nuisance(frame, "link stiffness", LOG_UNIT, LEFT.stiffness_share, LinkStiffness)
    for joint in Joint:
        yield _joint_nuisance(joint, "counter", "rad", COUNT_RAD, EncoderZero)
        for word, numerics in NUMERICS.items():
            yield _numerics_nuisance(word, numerics, joint.name.lower())
    yield from _session_nuisances()


def _frame_nuisances() -> Iterator[NuisanceEffect]:
    """Yield rotations and shifts of frames; the last frame has those of every tool."""
    for frame, tool in list_frames(nominal_params().tool_names):
        for axis in IDENTIFIABLE_AXES[frame]:
            named = frame.name.lower() if tool is None else tool
            unit, sigma = ("rad", LEFT.frame_rad) if axis < 3 else ("m", LEFT.frame_m)
            word = SCREW_AXES[axis]
            yield NuisanceEffect(
                Nuisance(f"frame {named}.{word}", unit, sigma),
                partial(_displaced_frame, frame, tool, axis),
                f"{_TURN_SHIFT[tool is not None][unit]} at {named}.{word[1]}",
            )


def _session_nuisances() -> Iterator[NuisanceEffect]:
    """Yield small variations between sessions."""
    for joint in Joint:
        yield _joint_nuisance(joint, "friction", LOG_UNIT, 0.01, GearFriction, random_per_block=True)
        yield _joint_nuisance(joint, "gear stiffness", LOG_UNIT, 0.02, GearStiffness, random_per_block=True)
        yield _joint_nuisance(joint, "current", "A", 0.003, CurrentBias, random_per_block=True)
        yield _joint_nuisance(joint, "resolver", "rad", 6e-6, ResolverBias, random_per_block=True)


def _numerics_nuisance(word: str, numerics: Numerics, place: str) -> NuisanceEffect:
    """Return other numerics at one joint, on or off."""
    nuisance = Nuisance(f"{word} {place}", "1", NUMERICS_SIGMA)
    return NuisanceEffect(nuisance, lambda _: numerics, word, one_sided=True, only_place=place)


def _joint_nuisance(
    place: Joint | Frame,
    word: str,
    unit: str,
    sigma: float,
    kind: Any,
    random_per_block: bool = False,
) -> NuisanceEffect:
    """Return an effect of one parameter at a joint or frame; a factor is given by its logarithm."""
    name = place.name.lower()
    full_name = f"{word} {name} of a session" if random_per_block else f"{word} {name}"
    effect = partial(_scaled_effect, kind, place) if unit == LOG_UNIT else partial(kind, place)
    return NuisanceEffect(
        Nuisance(full_name, unit, sigma, random_per_block), effect, f"{effect_name(kind)} at {name}"
    )


def _scaled_effect(kind: Callable[[Any, float], Effect], place: Joint | Frame, logarithm: float) -> Effect:
    return kind(place, float(np.exp(logarithm)))


def _displaced_frame(frame: Frame, tool: str | None, axis: int, value: float) -> Effect:
    return FrameError(frame, row6(value * np.eye(6)[axis]), tool)
