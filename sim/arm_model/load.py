"""Arms by name or folder: each is made from its `arm.toml` and the looks beside it."""

import hashlib
import json
import math
import os
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from fsw.dictionary.params import Box, Capsule, JointParams, Params, PointMass, PoseParams, Transform6
from sim.arm_model.description import (
    LINK_PARTS,
    VISCOUS_COLD,
    ArmDescription,
    BadArm,
    Hull,
    LinkDescription,
    Shape,
    default_rover,
    on_rover,
    read_description,
)
from sim.arm_model.mjcf import BadLooks, arm_mjcf
from sim.arm_model.validity import check_description, reserved_of_flight
from sim.frames import PRIMARY, Workspace
from sim.params import merge_tables, params_from_table
from simgap.common.errors import RobotError
from simgap.common.toml import read_text, read_toml

ROUNDING: Final = 1e-18
"""Expansions below this, in m/K, are rounding errors of a right angle."""


def flight_params(arm: ArmDescription, hull: Hull, digest: str, defaults: Path, source: str) -> Params:
    """Make the flight parameters of the drawing.

    Args:
        defaults: TOML file of the flight parameters that do not depend on the arm.
        source: File of the description, for errors.

    Raises:
        BadArm: the table `[flight]` sets what another table sets.
        BadParams: flight software does not accept them; the message names every wrong value.
    """
    shared = read_toml(defaults)
    del shared["default_arm"]
    own = {
        "arm_name": "nominal",
        "model": {"name": arm.name, "sha256": digest},
        "links": {f"arm{k + 1}": _link_table(link) for k, link in enumerate(arm.links.in_order())},
        "tools": {name: _tool_table(arm, name) for name in arm.tools},
        "switches": {name: switch.tool for name, switch in arm.switches.items()},
        "joints": {name: _joint_table(arm, name) for name in arm.joints.by_name()},
        "hardstop": {
            name: getattr(arm.poses, f"hardstop_{name}")
            for name in ("start_rad", "park_rad", "second_start_rad")
        },
        "poses": _values_of(PoseParams, arm.poses),
        "collision": {
            "arm": {part: _shape_tables(arm.shapes[part]) for part in LINK_PARTS},
            "rover": {part: _shape_tables(shapes) for part, shapes in hull.items()},
        },
        "teach": [asdict(point) for point in arm.teach],
    }
    reserved = [f"flight.{place}" for place in reserved_of_flight(own, shared, arm.flight)]
    if reserved:
        raise BadArm(f"{source}: {', '.join(reserved)}: other tables set this; leave it out of [flight]")
    return params_from_table(merge_tables(merge_tables(shared, arm.flight), own), source)


def _link_table(link: LinkDescription) -> dict[str, Any]:
    table: dict[str, Any] = {
        "transform": asdict(link.transform),
        "expansion_1_K": _expansion(link.transform, link.expansion_1_K),
        "elastic_centre_m": link.elastic_centre_m,
        "far": _values_of(PointMass, link.far),
    }
    if link.near is not None:
        table["near"] = _values_of(PointMass, link.near)
    if any(link.stiffness):
        table["compliance"] = [
            [1 / k if row == column else 0.0 for column in range(6)] for row, k in enumerate(link.stiffness)
        ]
    return table


def _expansion(X: Transform6, per_K: float) -> list[float]:
    """Return the growth of a link per kelvin, in axes of its end: along a, b and d of its transform."""
    along = (X.a_m, X.b_m + X.d_m * math.sin(X.alpha_rad), X.d_m * math.cos(X.alpha_rad))
    growth = [per_K * length for length in along]
    return [0.0, 0.0, 0.0, *(0.0 if abs(value) < ROUNDING else value for value in growth)]


def _tool_table(arm: ArmDescription, name: str) -> dict[str, Any]:
    tool = arm.tools[name]
    table = {
        "transform": asdict(tool.transform),
        "expansion_1_K": _expansion(tool.transform, tool.expansion_1_K),
        "geometry": _shape_tables(arm.shapes[name]),
    }
    return table if tool.title is None else table | {"title": tool.title}


def _joint_table(arm: ArmDescription, name: str) -> dict[str, Any]:
    joint, actuator = arm.joints.by_name()[name], arm.actuator_of(name)
    soft_min_rad, soft_max_rad = joint.soft_limits_rad
    given = asdict(actuator) | asdict(joint) | {"soft_min_rad": soft_min_rad, "soft_max_rad": soft_max_rad}
    given["damping_Nms_rad"] *= VISCOUS_COLD
    given["hardstop_rad"], given["upper_hardstop_rad"] = joint.hardstops_rad
    return {field.name: given[field.name] for field in fields(JointParams)}


def _shape_tables(shapes: tuple[Shape, ...]) -> dict[str, Any]:
    seen = [shape for shape in shapes if shape.of != "plant"]
    return {
        table: [_values_of(record, shape) for shape in seen if shape.kind == kind]
        for table, kind, record in (("capsules", "capsule", Capsule), ("boxes", "box", Box))
    }


def _values_of(record: type, source: object) -> dict[str, Any]:
    """Return the values of a record of flight software, by their names, from the description."""
    return {field.name: getattr(source, field.name) for field in fields(record)}


MODELS: Final = Path(str(files("sim") / "models"))
ARMS: Final = MODELS / "arms"
SCENES: Final = MODELS / "mjcf"
DEFAULTS: Final = ARMS / "defaults.toml"
ROVER: Final = SCENES / "rover.toml"
FILE_NAME: Final = "arm.toml"
LOOKS_NAME: Final = "visual.xml"


@dataclass(frozen=True, slots=True)
class ArmModel:
    """Drawing of an arm: description, plant and flight parameters."""

    description: ArmDescription
    params: Params
    """Flight parameters of the drawing."""
    mjcf: str
    """MJCF of arm and hull, which scenes include."""
    has_own_rover: bool = False
    """Whether the file gives the rover; that of the scenes looks like Curiosity."""

    def __hash__(self) -> int:
        """Return a number by which checks remember the arm."""
        return hash(self.mjcf)

    @property
    def name(self) -> str:
        """Return the name of the arm."""
        return self.description.name

    @property
    def workspace(self) -> Workspace:
        """Return the workspace of the arm."""
        return self.description.workspace or PRIMARY


def arm_names() -> tuple[str, ...]:
    """Return the names of the arms that come with the project."""
    return tuple(sorted(folder.name for folder in ARMS.iterdir() if (folder / FILE_NAME).is_file()))


@cache
def default_arm() -> ArmModel:
    """Return the arm that is meant if none is named."""
    return load_arm(default_name())


def arm_folder(name: str) -> Path:
    """Return the folder of an arm of the project, or the one of this name."""
    return ARMS / name if name in arm_names() else Path(name)


def has_description(name: str) -> bool:
    """Return whether there is an arm of the project of this name, or a folder with an `arm.toml`."""
    return bool(name) and os.path.isfile(arm_folder(name) / FILE_NAME)  # Path.is_file may raise


def load_arm(name: str) -> ArmModel:
    """Make an arm of the project, or of a folder with an `arm.toml`; BadArm or BadParams if it is wrong."""
    folder = arm_folder(name)
    path = folder / FILE_NAME
    if not has_description(name):
        if name and os.path.isdir(folder):
            raise BadArm(f"arm {name!r}: this folder has no {FILE_NAME}")
        known = ", ".join(arm_names())
        raise BadArm(f"arm {name!r} is not known; there are {known}, or give a folder with an {FILE_NAME}")
    looks = folder / LOOKS_NAME
    visual = _read(looks) if os.path.lexists(looks) else None
    model = _make_arm(str(path), _read(path), str(looks), visual)
    if name in arm_names() and model.name != name:
        raise BadArm(f"{path}: name: {model.name!r} is not that of its folder, {name!r}")
    return model


@cache
def default_name() -> str:
    """Return the name of the arm that is meant if none is named."""
    name: str = read_toml(DEFAULTS)["default_arm"]
    return name


def _read(path: Path) -> str:
    try:
        return read_text(path)
    except RobotError as error:
        raise BadArm(str(error)) from error


@cache
def _make_arm(path: str, text: str, looks: str, visual: str | None) -> ArmModel:
    """Make an arm once in a process; a changed file is another text."""
    description = read_description(text, path)
    check_description(description, path)
    given = {name: value for name, value in asdict(description).items() if value is not None}
    digest = hashlib.sha256(json.dumps(given, sort_keys=True).encode()).hexdigest()
    arm, hull = on_rover(description, description.rover or default_rover(ROVER))
    params = flight_params(arm, hull, digest, DEFAULTS, path)
    has_own_rover = description.rover is not None
    try:
        mjcf = arm_mjcf(arm, hull, visual, has_own_rover)
    except BadLooks as error:
        raise BadArm(f"{looks}: {error}") from error
    return ArmModel(arm, params, mjcf, has_own_rover)
