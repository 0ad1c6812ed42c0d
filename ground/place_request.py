"""What a placement request may ask, and every check that can be made before anything moves or is written."""

import math
import os
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Final, Literal

import numpy as np

from fsw.dictionary.commands import Vector3
from fsw.dictionary.joints import SWITCHES_OF, Tool
from ground.report.picture import PictureError, check_path
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.params import BadParams, params_over_nominal
from sim.placement import Placement
from sim.preview import preview, unstow_s
from sim.world import GRAVITY_M_S2, MAX_TILT_RAD, Surface, World, inside_rover

FARTHEST_M: Final = 100.0
"""A target beyond this is a slip of the pen, and its square need not be a number."""

SHORTEST_NORMAL: Final = 1e-6


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
    if math.hypot(*request.target_m) > FARTHEST_M:
        raise BadRequest(
            f"target: {_numbers(request.target_m)} m is farther than {FARTHEST_M:g} m from the rover; "
            "the workspace is around 2.1 0 -0.3"
        )
    normal = _scaled(request.normal)
    if request.scene not in GRAVITY_M_S2:
        raise BadRequest(f"scene: {request.scene!r} is not known; there are {', '.join(GRAVITY_M_S2)}")
    if request.seed < 0:
        raise BadRequest(f"seed: {request.seed} must not be negative")
    try:
        arm = arm_named(request.arm, None if request.params is None else params_over_nominal(request.params))
    except (UnknownArm, BadParams) as error:
        raise BadRequest(str(error)) from error
    world = _world(request, normal)
    if inside_rover(request.target_m):
        raise BadRequest(
            f"target: {_numbers(request.target_m)} m is inside the rover; the workspace is around 2.1 0 -0.3"
        )
    _writable(request)
    seen = preview(arm, world, Placement(tool, request.target_m, normal), stowed=True)
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


def _scaled(normal: Vector3) -> Vector3:
    """The normal with a largest component of 1, so that its length is a number."""
    largest = max(abs(component) for component in normal)
    if largest < SHORTEST_NORMAL:
        raise BadRequest(
            f"normal: {_numbers(normal)} has no direction; "
            "give the direction out of the surface, such as 0 0 -1 for up"
        )
    x, y, z = (component / largest for component in normal)
    return (x, y, z)


def _world(request: PlaceRequest, normal: Vector3) -> World:
    tilt_deg = (request.tilt_roll_deg, request.tilt_pitch_deg)
    if not np.all(np.isfinite(tilt_deg)):
        raise BadRequest(f"tilt: {_numbers(tilt_deg)} deg is not finite")
    roll, pitch = (float(np.radians(angle)) for angle in tilt_deg)
    world = World(request.scene, roll, pitch, Surface(request.target_m, normal))
    most = max(abs(roll), abs(pitch), world.tilt_rad)
    if most > MAX_TILT_RAD + 1e-12:
        limit_deg = round(math.degrees(MAX_TILT_RAD), 9)
        raise BadRequest(
            f"tilt: roll {request.tilt_roll_deg} and pitch {request.tilt_pitch_deg} deg tilt the rover by "
            f"{_beyond(math.degrees(most), limit_deg)} deg; the arm is used up to {limit_deg:g} deg"
        )
    return world


def _writable(request: PlaceRequest) -> None:
    """Nothing is written over anything else; the log itself is opened before the run and says the rest."""
    files = {
        "params": request.params,
        "log": request.log,
        "picture": request.picture,
        "movie": request.movie,
    }
    given = [(name, path) for name, path in files.items() if path is not None]
    for (one, path), (other, same) in combinations(given, 2):
        if _same_file(path, same):
            raise BadRequest(f"{other} {same}: this is the file of {one} too; give each a file of its own")
    if request.log is not None and request.log.suffix.lower() != ".mcap":
        raise BadRequest(f"log {request.log}: its name must end in .mcap")
    try:
        if request.picture is not None:
            check_path(request.picture, ".png", "picture")
        if request.movie is not None:
            check_path(request.movie, ".gif", "movie")
    except PictureError as error:
        raise BadRequest(str(error)) from error


def _same_file(one: Path, other: Path) -> bool:
    if os.path.realpath(one) == os.path.realpath(other):
        return True
    return os.path.exists(one) and os.path.exists(other) and os.path.samefile(one, other)


def _beyond(value: float, limit: float) -> str:
    """A number with as many digits, three at least, as show that it is beyond its limit."""
    texts = (f"{value:.{digits}g}" for digits in range(3, 17))
    return next((text for text in texts if float(text) > limit), f"{value!r}")


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
