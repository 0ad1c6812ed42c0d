"""File of the effects that a diagnosis has found, with which a later diagnosis starts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.common.toml import read_toml, toml_text
from simgap.effects.effect import Effect
from simgap.patch.text import effect_table, read_effect
from simgap.robot import Robot

FOUND_FILE: Final = "effects.toml"
FORMAT: Final = "robot effects 1"


def found_text(robot: Robot, effects: Sequence[Effect], sizes: Sequence[Sequence[float]]) -> str:
    """Return the text of the file."""
    tables = {
        "format": FORMAT,
        "joints": [joint.name for joint in robot.joints],
        "effects": [effect_table(one, size) for one, size in zip(effects, sizes, strict=True)],
    }
    head = f"Effects of {robot.name} as a diagnosis found them; `simgap diagnose --start` goes on from here."
    return toml_text(tables, [head])


def read_found(robot: Robot, folder: Path) -> dict[Effect, Array]:
    """Read what an earlier diagnosis of a robot has found, with sizes in the units of their names.

    Args:
        folder: Folder of its patch. Files of effects of one's own that it names are run.

    Raises:
        RobotError: The folder has no such file, or it is of another robot.
    """
    path = folder / FOUND_FILE
    if not path.is_file():
        raise RobotError(f"{folder}: has no {FOUND_FILE}; give the folder of a patch that a diagnosis wrote")
    content = read_toml(path)
    if content.get("format") != FORMAT:
        raise RobotError(f"{path}: format: is not {FORMAT!r}; write the patch again")
    own, named = [joint.name for joint in robot.joints], content.get("joints")
    if named != own:
        raise RobotError(f"{path}: joints: are {named}, and the robot has {own}; give the same robot file")
    return {one: np.asarray(size) for one, size in (read_effect(each, path) for each in content["effects"])}
