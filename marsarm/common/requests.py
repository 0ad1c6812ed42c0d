"""Checks and conversions of requests and tables that several verbs share, made before any work begins."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.params import Params
from fsw.dictionary.types import Position, match_name
from fsw.kinematics.transforms import Array
from sim.arm_model.load import ArmModel
from sim.arm_model.mismatch import find_mismatches
from sim.arms import BuiltArm, UnknownArm, arm_named, own_name, params_over
from sim.effects.effect import Effect, EffectMisfit
from sim.params import BadParams
from sim.scenario.effects import BadEffect, parse_effect_text, read_effect_file
from sim.setting import GRAVITY_M_S2, MAX_TILT_RAD, World
from simgap.common.errors import BadRequest

MAX_TARGET_DISTANCE_M: Final[float] = get_args(Position)[1].high
"""Largest distance of a target, that of a command; the squares of farther ones may overflow."""
NOMINAL_ARM: Final = "nominal"
"""Arm name of the nominal parameters, with which any arm may be flown."""
MIN_COMPONENT: Final = 1e-6
"""A vector whose largest component is below this has no direction."""


def check_targets(position_m: Array, direction: Array, names: tuple[str, str], what: str) -> Array:
    """Check points [m] and directions of any length, shape (3, n) each, in the words of the user.

    The directions are returned with a largest component of 1, so that no length can overflow. BadRequest says
    that a number is not finite, a point too far from the rover, or a direction 0.
    """

    def refuse(wrong: NDArray[np.bool_], which: int, complaint: str) -> None:
        if wrong.any():
            first = int(np.argmax(wrong))
            numbers = format_numbers(tuple((position_m, direction)[which][:, first].tolist()))
            number = f"[{first}]" if wrong.size > 1 else ""
            raise BadRequest(f"{names[which]}{number}: {numbers} {complaint}")

    for which, values in enumerate((position_m, direction)):
        refuse(~np.isfinite(values).all(axis=0), which, "is not three finite numbers")
    with np.errstate(over="ignore"):
        distance_m = np.hypot(np.hypot(position_m[0], position_m[1]), position_m[2])
    far = f"m is farther than {MAX_TARGET_DISTANCE_M:g} m from the rover; give metres, as in 2.1 0 -0.3"
    refuse(distance_m > MAX_TARGET_DISTANCE_M, 0, far)
    largest = np.abs(direction).max(axis=0)
    refuse(largest < MIN_COMPONENT, 1, f"has no direction; give {what}")
    return np.asarray(direction / largest)


def select_arm(name: str, params: Path | None, mismatch: bool = False) -> BuiltArm:
    """Return the arm of this name, with flight parameters of a TOML file; BadRequest if one is wrong."""
    try:
        return arm_named(name, None if params is None else load_params(name, params, mismatch))
    except UnknownArm as error:
        raise BadRequest(str(error)) from error


def load_params(name: str, path: Path, mismatch: bool = False) -> Params:
    """Read a TOML file of flight parameters over those of the arm's drawing; BadRequest if it is wrong."""
    try:
        model, own = arm_named(name).model, own_name(name)
    except UnknownArm as error:
        raise BadRequest(str(error)) from error
    params = load_fitting_params(model, path, mismatch)
    if params.arm_name not in (NOMINAL_ARM, own):
        raise BadRequest(
            f"params {path}: these are of the arm {params.arm_name}, not of {own}; give its own, or leave "
            "arm_name out"
        )
    return params


def load_fitting_params(model: ArmModel, path: Path, mismatch: bool = False) -> Params:
    """Read flight parameters over those of a drawing, which they fit without `mismatch`; else BadRequest."""
    try:
        params = params_over(model.params, path)
    except BadParams as error:
        raise BadRequest(str(error)) from error
    problems = () if mismatch else tuple(find_mismatches(params, model))
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise BadRequest(
            f"params {path}: {problems[0]}{more}; no built arm is so far from its drawing: give the "
            "--arm of these, parameters of this arm, or --mismatch if it is meant"
        )
    return params


def parse_tool(name: str, tools: Sequence[str]) -> str:
    """Return the tool of this name, in any case; BadRequest if the arm has no such tool."""
    tool = match_name(name, tools)
    if tool is None:
        raise BadRequest(f"tool: {name!r} is not known; there are {', '.join(tools)}")
    return tool


def parse_effects(texts: tuple[str, ...], tools: Sequence[str]) -> tuple[Effect, ...]:
    """Parse effects, each a text or a TOML file, for an arm with these tools; BadRequest lists all errors."""
    effects: list[Effect] = []
    problems: list[str] = []
    for text in texts:
        try:
            if text.endswith(".toml"):
                effects += read_effect_file(Path(text), tools)
            else:
                effects.append(parse_effect_text(text, tools))
        except BadEffect as error:
            problems.append(str(error))
    if problems:
        raise BadRequest("\n".join(problems))
    return tuple(effects)


def fit_effects(arm: BuiltArm, effects: tuple[Effect, ...]) -> BuiltArm:
    """Return the arm with those effects that it has before a run; BadRequest if it cannot have one."""
    try:
        return arm.with_effects(effects)
    except EffectMisfit as error:
        raise BadRequest(str(error)) from error


def make_world(scene: str, roll_deg: float, pitch_deg: float, scene_option: str = "scene") -> World:
    """Make a world without a surface, its rover tilted; BadRequest if scene or tilt are wrong."""
    if scene not in GRAVITY_M_S2:
        raise BadRequest(f"{scene_option}: {scene!r} is not known; there are {', '.join(GRAVITY_M_S2)}")
    if not np.all(np.isfinite((roll_deg, pitch_deg))):
        raise BadRequest(f"tilt: {format_numbers((roll_deg, pitch_deg))} deg is not finite")
    roll, pitch = (float(np.radians(angle)) for angle in (roll_deg, pitch_deg))
    world = World(cast(Literal["mars", "earth"], scene), roll, pitch)
    largest_rad = max(abs(roll), abs(pitch), world.tilt_rad)
    if largest_rad > MAX_TILT_RAD + 1e-12:
        limit_deg = round(math.degrees(MAX_TILT_RAD), 9)
        raise BadRequest(
            f"tilt: roll {roll_deg} and pitch {pitch_deg} deg tilt the rover by "
            f"{_format_beyond(math.degrees(largest_rad), limit_deg)} deg; the arm is used up to "
            f"{limit_deg:g} deg"
        )
    return world


def format_numbers(values: tuple[float, ...]) -> str:
    """Format numbers as a user types them."""
    return " ".join(f"{value:g}" for value in values)


def _format_beyond(value: float, limit: float) -> str:
    """Format a number with three digits, or with as many as show that it exceeds its limit."""
    texts = (f"{value:.{digits}g}" for digits in range(3, 17))
    return next((text for text in texts if float(text) > limit), f"{value!r}")
