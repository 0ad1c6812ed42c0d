"""Arms by name or folder: each is made from its `arm.toml` and the looks beside it."""

import hashlib
import json
import os
import tomllib
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params
from sim.arm_model.description import ArmDescription, BadArm, read_description
from sim.arm_model.flight import flight_params
from sim.arm_model.mjcf import BadLooks, arm_mjcf
from sim.arm_model.validity import check_description
from sim.text_file import UnreadableText, read_text

MODELS: Final = Path(str(files("sim") / "models"))
ARMS: Final = MODELS / "arms"
SCENES: Final = MODELS / "mjcf"
DEFAULTS: Final = ARMS / "defaults.toml"
FILE_NAME: Final = "arm.toml"
LOOKS_NAME: Final = "visual.xml"


@dataclass(frozen=True, slots=True)
class ArmModel:
    """Drawing of an arm: description, plant and flight parameters."""

    description: ArmDescription
    params: Params
    """Flight parameters of the drawing."""
    mjcf: str
    """MJCF of the plant, which scenes include."""

    @property
    def name(self) -> str:
        """Return the name of the arm."""
        return self.description.name


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
    name: str = tomllib.loads(DEFAULTS.read_text(encoding="utf-8"))["default_arm"]
    return name


def _read(path: Path) -> str:
    try:
        return read_text(path)
    except UnreadableText as error:
        raise BadArm(f"{path}: {error}") from error


@cache
def _make_arm(path: str, text: str, looks: str, visual: str | None) -> ArmModel:
    """Make an arm once in a process; a changed file is another text."""
    description = read_description(text, path)
    check_description(description, path)
    digest = hashlib.sha256(json.dumps(asdict(description), sort_keys=True).encode()).hexdigest()
    params = flight_params(description, digest, DEFAULTS, SCENES / "rover.toml", path)
    try:
        mjcf = arm_mjcf(description, visual)
    except BadLooks as error:
        raise BadArm(f"{looks}: {error}") from error
    return ArmModel(description, params, mjcf)
