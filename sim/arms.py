"""Arms that can be simulated, by name, and their random manufacturing tolerances."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Row6, row6
from sim.arm_check import POSE_NAMES, check_arm, compute_hardstop_loads, equalise_loads, with_poses
from sim.arm_model.description import BadArm
from sim.arm_model.load import ArmModel, arm_names, default_arm, default_name, has_description, load_arm
from sim.effects.effect import Effect, check_effects, params_with_effects
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
from sim.effects.structure import LinkMass, LinkStiffness, StandInTurret
from sim.params_table import BadParams
from sim.world import World

MAX_SEED_DIGITS: Final = 9
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


ARM_PATTERN: Final = re.compile(r"nominal|(?:as-built|calibrated):[0-9]+")


class UnknownArm(ValueError):
    """Name that is not an arm."""


@dataclass(frozen=True, slots=True)
class BuiltArm:
    """Arm: its differences from the drawing, and its flight parameters."""

    name: str
    """Name that leads back to it; see `own_name`."""
    effects: tuple[Effect, ...]
    params: Params
    model: ArmModel = field(default_factory=default_arm)
    """Drawing that the arm is built from."""

    def with_effects(self, effects: Iterable[Effect]) -> "BuiltArm":
        """Return the arm with those of these effects that it has before a run begins.

        Raises:
            EffectMisfit: one of them is at a tool or a contact switch that the arm does not have.
        """
        effects = tuple(effects)
        check_effects(effects, self.params)
        return replace(self, effects=(*self.effects, *(effect for effect in effects if effect.built_in)))


def arm_named(name: str, params: Params | None = None) -> BuiltArm:
    """Make the arm of this name: `nominal`, `as-built:SEED` or `calibrated:SEED`, of the default drawing.

    `MODEL/NAME`, or `MODEL` alone for `MODEL/nominal`, is an arm of another drawing: the name of one that
    comes with the project, or a folder with an `arm.toml`.

    Args:
        params: Flight parameters in place of those of the drawing.

    Raises:
        UnknownArm: the name has none of these forms, or the drawing is wrong.
    """
    known = _parse_name(name)
    model, flight_params = known.model, params or known.model.params
    named = known.own_name if known.folder is None else name  # a folder is found by its name only
    if known.kind == "nominal":
        return BuiltArm(named, (), flight_params, model)
    effects = draw_tolerances(model, known.seed)
    if known.kind == "calibrated":
        errors = draw_calibration_errors(model, known.seed)
        # a calibration at one temperature does not show the expansion
        known_effects = [effect for effect in effects if not isinstance(effect, Expansion)]
        flight_params = params_with_effects((*known_effects, *errors), flight_params)
    return BuiltArm(named, effects, replace(flight_params, arm_name=known.own_name), model)


def own_name(name: str) -> str:
    """Return the name of an arm in its parameters: the same for all names and folders that lead to it.

    It is the name of the drawing, unless that is the default one, and kind and seed: `m2020/as-built:7`.

    Raises:
        UnknownArm: there is no such arm.
    """
    return _parse_name(name).own_name


@dataclass(frozen=True, slots=True)
class _ArmName:
    """Parts of the name of an arm."""

    model: ArmModel
    folder: str | None
    """Folder of the drawing; None if it comes with the project."""
    kind: str
    seed: int

    @property
    def own_name(self) -> str:
        """Return the name in parameters."""
        drawing = "" if self.model.name == default_name() else f"{self.model.name}/"
        return f"{drawing}{self.kind}" + ("" if self.kind == "nominal" else f":{self.seed}")


def _parse_name(name: str) -> _ArmName:
    folder, slash, last = name.rpartition("/")
    is_kind = ARM_PATTERN.fullmatch(last) is not None
    model = name if not is_kind else folder if slash else default_name()
    if not has_description(model):
        raise UnknownArm(
            f"arm {name!r} is not known; write nominal, as-built:SEED or calibrated:SEED, or put a drawing "
            f"and / before it: {', '.join(arm_names())}, or a folder with an arm.toml"
        )
    kind, _, seed = (last if is_kind else "nominal").partition(":")
    if len(seed) > MAX_SEED_DIGITS:
        raise UnknownArm(
            f"arm {kind}: its seed has {len(seed)} digits; give one with {MAX_SEED_DIGITS} at most"
        )
    is_ours = model in arm_names()
    try:
        drawing = default_arm() if model == default_name() else load_arm(model)
        if not is_ours:
            check_arm(drawing)
    except (BadArm, BadParams) as error:
        raise UnknownArm(str(error)) from error
    return _ArmName(drawing, None if is_ours else model, kind, int(seed or 0))


def effects_of_run(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects that begin with a run, not with the making of the arm."""
    return tuple(effect for effect in effects if not effect.built_in)


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


def list_frames(tools: Sequence[str]) -> list[tuple[Frame, str | None]]:
    """List all frames, that of each tool with its name."""
    inner: list[tuple[Frame, str | None]] = [(frame, None) for frame in Frame if frame is not Frame.TOOL]
    return inner + [(Frame.TOOL, tool) for tool in tools]


def _draw_factor(rng: np.random.Generator, sigma: float) -> float:
    """Draw a log-normal factor with median 1, so that a stiffness stays positive."""
    return float(np.exp(sigma * rng.standard_normal()))


def _draw_screw(rng: np.random.Generator, angle_rad: float, length_m: float) -> Row6:
    return row6(rng.standard_normal(6) * np.repeat([angle_rad, length_m], 3))


def without_turret(arm: BuiltArm, on_earth: bool) -> BuiltArm:
    """Return the arm without its turret, which flight software knows.

    On Earth its poses have the torques of the whole arm in its own poses on Mars.
    """
    turret = StandInTurret(0.0)
    bare = replace(arm, effects=(*arm.effects, turret), params=turret.on_params(arm.params))
    if not on_earth:
        return bare
    wanted_Nm = compute_hardstop_loads(arm.params, World().gravity_N_m_s2).torque_Nm
    drawn = arm.model.description.poses
    poses = {name: getattr(drawn, f"bare_hardstop_{name}") for name in POSE_NAMES}
    guess = with_poses(bare.params, poses)
    return replace(bare, params=equalise_loads(guess, World("earth").gravity_N_m_s2, wanted_Nm))
