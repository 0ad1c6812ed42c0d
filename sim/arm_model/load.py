"""Arms by name or folder: each is made from its `arm.toml` and the looks beside it."""

import hashlib
import json
import tomllib
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params
from sim.arm_model.description import ArmDescription, BadArm, read_description
from sim.arm_model.flight import flight_params
from sim.arm_model.mjcf import arm_mjcf
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
    return load_arm(_default_name())


def arm_folder(name: str) -> Path:
    """Return the folder of an arm of the project, or the one of this name."""
    return ARMS / name if name in arm_names() else Path(name)


def has_description(name: str) -> bool:
    """Return whether there is an arm of the project of this name, or a folder with an `arm.toml`."""
    return bool(name) and (arm_folder(name) / FILE_NAME).is_file()


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
    try:
        visual = read_text(looks) if looks.is_file() else None
        return _make_arm(str(path), read_text(path), visual)
    except UnreadableText as error:
        raise BadArm(f"{path}: {error}") from error


@cache
def _default_name() -> str:
    name: str = tomllib.loads(DEFAULTS.read_text(encoding="utf-8"))["default_arm"]
    return name


@cache
def _make_arm(path: str, text: str, visual: str | None) -> ArmModel:
    """Make an arm once in a process; a changed file is another text."""
    description = read_description(text, path)
    digest = hashlib.sha256(json.dumps(asdict(description), sort_keys=True).encode()).hexdigest()
    params = flight_params(description, digest, DEFAULTS, SCENES / "rover.toml")
    return ArmModel(description, params, arm_mjcf(description, visual))
