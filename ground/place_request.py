"""What a placement request may ask, and every check that can be made before anything moves or is written."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fsw.dictionary.commands import Vector3
from fsw.dictionary.joints import SWITCHES_OF, Tool
from ground.report.picture import PictureError, check_path
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.params import BadParams, params_over_nominal
from sim.placement import Placement
from sim.preview import preview, unstow_s
from sim.world import GRAVITY_M_S2, MAX_TILT_RAD, Surface, World, inside_rover


class BadRequest(ValueError):
    """A request that cannot be carried out; nothing moved and nothing was written."""


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
    has_surface: bool = True
    log: Path | None = None
    picture: Path | None = None
    movie: Path | None = None


@dataclass(frozen=True, slots=True)
class PlaceJob:
    """A request that can be carried out."""

    arm: BuiltArm
    world: World
    placement: Placement
    expected_s: float


def checked(request: PlaceRequest) -> PlaceJob:
    """The job, after every check that can be made before anything moves or is written."""
    tool = _tool(request.tool)
    for name, values in (("target", request.target_m), ("normal", request.normal)):
        if not np.all(np.isfinite(values)):
            raise BadRequest(f"{name}: {_numbers(values)} is not three finite numbers")
    if np.linalg.norm(request.normal) < 1e-6:
        raise BadRequest(
            "normal: 0 0 0 has no direction; give the direction out of the surface, such as 0 0 -1 for up"
        )
    if request.scene not in GRAVITY_M_S2:
        raise BadRequest(f"scene: {request.scene!r} is not known; there are {', '.join(GRAVITY_M_S2)}")
    if request.seed < 0:
        raise BadRequest(f"seed: {request.seed} must not be negative")
    try:
        arm = arm_named(request.arm, None if request.params is None else params_over_nominal(request.params))
    except (UnknownArm, BadParams) as error:
        raise BadRequest(str(error)) from error
    world = _world(request)
    if inside_rover(request.target_m):
        raise BadRequest(
            f"target: {_numbers(request.target_m)} m is inside the rover; the workspace is around 2.1 0 -0.3"
        )
    _writable(request)
    seen = preview(arm, world, Placement(tool, request.target_m, request.normal))
    if seen.problem is not None:
        raise BadRequest(f"target: {_numbers(request.target_m)} m cannot be reached: {seen.problem}")
    if not request.has_surface:
        world = replace(world, surface=None)
    return PlaceJob(arm, world, seen.placement, seen.duration_s + unstow_s(arm))


def _tool(name: str) -> Tool:
    known = {tool.name.lower(): tool for tool in Tool if SWITCHES_OF[tool]}
    if name.lower() not in known:
        raise BadRequest(
            f"tool: {name!r} cannot be placed; the tools with contact switches are {', '.join(known)}"
        )
    return known[name.lower()]


def _world(request: PlaceRequest) -> World:
    tilt_deg = (request.tilt_roll_deg, request.tilt_pitch_deg)
    if not np.all(np.isfinite(tilt_deg)):
        raise BadRequest(f"tilt: {_numbers(tilt_deg)} deg is not finite")
    roll, pitch = (float(np.radians(angle)) for angle in tilt_deg)
    world = World(request.scene, roll, pitch, Surface(request.target_m, request.normal))
    if max(abs(roll), abs(pitch), world.tilt_rad) > MAX_TILT_RAD + 1e-12:
        raise BadRequest(
            f"tilt: roll {request.tilt_roll_deg} and pitch {request.tilt_pitch_deg} deg tilt the rover by "
            f"{np.degrees(world.tilt_rad):.1f} deg; the arm is used up to {np.degrees(MAX_TILT_RAD):.0f} deg"
        )
    return world


def _writable(request: PlaceRequest) -> None:
    try:
        for path, suffix in ((request.picture, ".png"), (request.movie, ".gif")):
            if path is not None:
                check_path(path, suffix)
    except PictureError as error:
        raise BadRequest(str(error)) from error


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
