"""File of the effects that a diagnosis has found, with which a later diagnosis starts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.common.toml import read_toml, toml_text
from simgap.effects.effect import Effect
from simgap.patch.text import effect_table, read_effect
from simgap.result import Rival
from simgap.robot import Robot

FOUND_FILE: Final = "effects.toml"
FORMAT: Final = "robot effects 1"


def found_text(
    robot: Robot, effects: Sequence[Effect], sizes: Sequence[Sequence[float]], rivals: Sequence[Rival] = ()
) -> str:
    """Return the text of the file, with the rivals of the findings."""
    known = {one.key for one in effects}
    others = {one.key: one for rival in rivals for one in rival.effects if one.key not in known}
    tables = {
        "format": FORMAT,
        "joints": [joint.name for joint in robot.joints],
        "effects": [effect_table(one, size) for one, size in zip(effects, sizes, strict=True)],
        "rival_effects": [effect_table(one, [0.0] * len(one.sizes)) for one in others.values()],
        "rivals": [_rival_table(one) for one in rivals],
    }
    head = f"Effects of {robot.name} as a diagnosis found them; `simgap diagnose --start` goes on from here."
    return toml_text(tables, [head])


def read_found(robot: Robot, folder: Path) -> dict[Effect, Array]:
    """Read effects and sizes of a patch, and run files of effects of one's own; RobotError if it has none."""
    path, content = _read_file(robot, folder)
    return {one: np.asarray(size) for one, size in (read_effect(each, path) for each in content["effects"])}


def read_rivals(robot: Robot, folder: Path) -> tuple[Rival, ...]:
    """Read the rivals that a patch keeps, if it keeps any; RobotError as for `read_found`."""
    path, content = _read_file(robot, folder)
    tables = (*content["effects"], *content.get("rival_effects", ()))
    effects = {one.key: one for one, _ in (read_effect(each, path) for each in tables)}
    found = []
    for table in content.get("rivals", ()):
        sizes = {key: tuple(map(float, size)) for key, size in table["sizes"].items()}
        unknown = next((key for key in sizes if key not in effects), "")
        if unknown:
            raise RobotError(f"{path}: rivals: no effect has the key {unknown!r}; write the patch again")
        own = {name: table[name] for name in ("finding", "effect", "p", "kind", "n_fitted")}
        found.append(Rival(**own, effects=tuple(effects[key] for key in sizes), sizes=tuple(sizes.values())))
    return tuple(found)


def _rival_table(one: Rival) -> dict[str, Any]:
    sizes = {effect.key: list(size) for effect, size in zip(one.effects, one.sizes, strict=True)}
    own = {name: getattr(one, name) for name in ("finding", "effect", "p", "kind", "n_fitted")}
    return {**own, "sizes": sizes}


def _read_file(robot: Robot, folder: Path) -> tuple[Path, dict[str, Any]]:
    path = folder / FOUND_FILE
    if not path.is_file():
        raise RobotError(f"{folder}: has no {FOUND_FILE}; give the folder of a patch that a diagnosis wrote")
    content = read_toml(path)
    if content.get("format") != FORMAT:
        raise RobotError(f"{path}: format: is not {FORMAT!r}; write the patch again")
    own, named = [joint.name for joint in robot.joints], content.get("joints")
    if named != own:
        raise RobotError(f"{path}: joints: are {named}, and the robot has {own}; give the same robot file")
    return path, content
