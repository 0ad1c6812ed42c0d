"""Arms by name or folder: each is made from its `arm.toml` and the looks beside it."""

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params
from sim.arm_model.description import ArmDescription, BadArm, read_description
from sim.arm_model.flight import flight_params
from sim.arm_model.mjcf import BadLooks, arm_mjcf
from sim.arm_model.rover import default_rover, on_rover
from sim.arm_model.validity import check_description
from sim.workspace import PRIMARY, Workspace
from simgap.common.errors import RobotError
from simgap.common.toml import read_text, read_toml

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
    """Make an arm from its files.

    Args:
        name: Name of an arm of the project, or a folder with an `arm.toml`.

    Raises:
        BadArm: there is no such arm, or its description is wrong.
        BadParams: flight software does not accept its parameters.
    """
    folder = arm_folder(name)
    path = folder / FILE_NAME
    if not has_description(name):
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
