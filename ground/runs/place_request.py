"""What a placement request may ask, and every check that can be made before anything moves or is written."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from fsw.dictionary.enums import TOOL_SWITCHES, Tool
from fsw.dictionary.types import Vector3
from ground.common.requests import (
    WORKSPACE,
    BadRequest,
    check_finite,
    check_near,
    check_seed,
    chosen_arm,
    chosen_effects,
    numbers,
    scaled,
    tilted_world,
)
from ground.runs.artifacts import NO_FILES, Files, check_files
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.placement import Placement
from sim.preview import preview_placement, unstow_duration_s
from sim.world import Surface, World, inside_rover


@dataclass(frozen=True, slots=True)
class PlaceRequest:
    """What is asked; RNAV, metres, degrees."""

    tool: str = "apxs"
    target_m: Vector3 = (2.05, 0.1, -0.25)
    normal: Vector3 = (-0.5, 0.1, -0.85)
    tilt_roll_deg: float = 0.0
    tilt_pitch_deg: float = 0.0
    arm: str = "nominal"
    scene: Literal["mars", "earth"] = "mars"
    seed: int = 0
    params: Path | None = None
    effects: tuple[str, ...] = ()
    """As the command line writes them."""
    has_surface: bool = True
    files: Files = NO_FILES


@dataclass(frozen=True, slots=True)
class PlaceJob:
    """A request that can be carried out."""

    arm: BuiltArm
    world: World
    placement: Placement
    expected_s: float
    effects: tuple[Effect, ...]
    """Those that were asked for."""


def checked(request: PlaceRequest) -> PlaceJob:
    """The job, after every check that can be made before anything moves or is written."""
    tool = _tool(request.tool)
    check_finite("target", request.target_m)
    check_finite("normal", request.normal)
    check_near("target", request.target_m)
    normal = scaled("normal", request.normal, "the direction out of the surface, such as 0 0 -1 for up")
    check_seed(request.seed)
    effects = chosen_effects(request.effects)
    arm = chosen_arm(request.arm, request.params).with_effects(effects)
    level = tilted_world(request.scene, request.tilt_roll_deg, request.tilt_pitch_deg)
    world = replace(level, surface=Surface(request.target_m, normal))
    if inside_rover(request.target_m):
        raise BadRequest(f"target: {numbers(request.target_m)} m is inside the rover; {WORKSPACE}")
    check_files(request.files, params=request.params)
    seen = preview_placement(arm, world, Placement(tool, request.target_m, normal), stowed=True)
    if seen.problem is not None:
        raise BadRequest(f"target: {numbers(request.target_m)} m cannot be reached: {seen.problem}")
    if not request.has_surface:
        world = level
    return PlaceJob(arm, world, seen.placement, seen.duration_s + unstow_duration_s(arm), effects)


def _tool(name: str) -> Tool:
    known = {tool.name.lower(): tool for tool in Tool if TOOL_SWITCHES[tool]}
    if name.lower() not in known:
        raise BadRequest(
            f"tool: {name!r} cannot be placed; the tools with contact switches are {', '.join(known)}"
        )
    return known[name.lower()]
