"""Text of a patch: elements and control laws of an MJCF file, and files of effects in TOML."""

import importlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from math import inf
from pathlib import Path
from typing import Annotated, Any, Final, Literal, cast, get_args, get_origin, get_type_hints
from xml.etree import ElementTree
from xml.etree.ElementTree import Comment, Element, TreeBuilder, XMLParser

import mujoco
import numpy as np
from pydantic import Field

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.common.modules import load_module
from simgap.common.toml import Record, parse_record, read_toml, toml_text
from simgap.effects.effect import Effect, JointEffect
from simgap.result import Rival
from simgap.robot import ControlMode, Robot, RobotJoint

ORIENTATIONS: Final = ("quat", "axisangle", "euler", "xyaxes", "zaxis", "fullinertia")
"""Attributes of an inertial element that say the same as `quat`, or what `diaginertia` says."""
BODY_OF: Final = "body of "
"""Before the name of a joint: the body that it moves, which has no name of its own."""
SHORTCUTS: Final = (
    *("kp", "kv", "dampratio", "inheritrange", "timeconst"),
    *("motorconst", "resistance", "nominal", "saturation", "inductance", "cogging"),
    *("controller", "thermal", "lugre", "input"),
)
"""Attributes of servos and DC motors that a general actuator lacks, or reads otherwise."""


@dataclass(frozen=True, slots=True)
class Change:
    """New attributes of one element, and the reason."""

    tag: str
    """"joint", "actuator", "inertial", "body", "geom", "tendon" or "option"."""
    name: str
    """Name of the element; of an actuator without a name, that of its joint; of an inertial element, that of
    its body; empty for options."""
    attributes: tuple[tuple[str, str], ...]
    reason: str


def change_text(text: str, changes: Sequence[Change]) -> str:
    """Return MJCF text with changes; RobotError if an element is not in it, as one that MuJoCo makes."""
    root = ElementTree.fromstring(text, XMLParser(target=TreeBuilder(insert_comments=True)))
    for change in changes:
        parent, element = _find(root, change)
        _set(element, change)
        said = Comment(f" {change.reason.replace('--', '- -')} ")
        said.tail = _indent(parent, element)
        parent.insert(list(parent).index(element), said)
    head = text[: text.index("<mujoco")]  # comments above the root, which the parser leaves out
    return f"{head}{ElementTree.tostring(root, encoding='unicode').replace(' />', '/>')}\n"


def number_text(*values: float) -> str:
    """Return numbers as an attribute, with all their digits."""
    return " ".join(repr(float(value)) for value in values)


def _find(root: Element, change: Change) -> tuple[Element, Element]:
    """Return an element and its parent."""
    if change.tag == "option":
        found = root.find("option")
        return root, (_add(root, "option") if found is None else found)
    if change.tag == "inertial":
        _, body = _body(root, change.name)
        found = body.find("inertial")
        return body, (_add(body, "inertial") if found is None else found)
    if change.tag == "body":
        return _body(root, change.name)
    if change.tag == "new actuator":
        section = root.find("actuator")
        if section is None:
            section = _add(root, "actuator")
            section.text, section.tail = f"{root.text or ''}  ", root.text
        section.append(Element("general"))  # the order of actuators is that of commands
        section[-1].tail = root.text
        return section, section[-1]
    return _named(root, change.tag, change.name)


def _body(root: Element, name: str) -> tuple[Element, Element]:
    """Return a body and its parent."""
    if not name.startswith(BODY_OF):
        return _named(root, "body", name)
    body, _ = _named(root, "joint", name.removeprefix(BODY_OF))
    return next(one for one in root.iter() if any(child is body for child in one)), body


def _named(root: Element, tag: str, name: str) -> tuple[Element, Element]:
    for section in root.findall({"actuator": "actuator", "tendon": "tendon"}.get(tag, "worldbody")):
        for parent in section.iter():
            for element in parent:
                is_kind = tag in ("actuator", "tendon") or element.tag == tag
                own = element.get("name") or (element.get("joint") if tag == "actuator" else None)
                if is_kind and own == name:
                    return parent, element
    raise RobotError(f"the model's text has no {tag} {name!r}")


def _set(element: Element, change: Change) -> None:
    new = dict(change.attributes)
    if change.tag == "inertial":
        for one in ORIENTATIONS:
            element.attrib.pop(one, None)
    if change.tag == "actuator" and "gainprm" in new:
        element.tag = "general"
        for one in SHORTCUTS:
            element.attrib.pop(one, None)
    element.attrib.update(new)


def _add(parent: Element, tag: str) -> Element:
    """Add an element as the first one of its parent."""
    element = Element(tag)
    element.tail = parent.text
    parent.insert(0, element)
    return element


def _indent(parent: Element, element: Element) -> str | None:
    """Return the white space before an element."""
    place = list(parent).index(element)
    return parent.text if place == 0 else list(parent)[place - 1].tail


def law_attributes(
    robot: Robot, joint: RobotJoint, kp: float, kd: float, limit: float
) -> tuple[tuple[str, str], ...]:
    """Return the attributes of an actuator with a law; its gear scales length and force."""
    gear = 1.0
    if joint.actuator_index >= 0:
        gear = float(robot.model.actuator_gear[joint.actuator_index, 0])
    position, velocity, gain = {
        ControlMode.POSITION: (kp / gear**2, kd / gear**2, kp / gear**2),
        ControlMode.VELOCITY: (0.0, kd / gear**2, kd / gear**2),
        ControlMode.VOLTAGE: (0.0, kd / gear**2, kp / gear),
    }.get(joint.mode, (0.0, 0.0, kp / gear))
    return _attributes(gain, position, velocity, limit / abs(gear))


def _attributes(gain: float, position: float, velocity: float, limit: float) -> tuple[tuple[str, str], ...]:
    """Return the attributes; numbers are in the units of the actuator."""
    is_limited = limit < inf
    force = (("forcerange", number_text(-limit, limit)),) if is_limited else ()
    return (
        ("dyntype", "none"),
        ("gaintype", "fixed"),
        ("biastype", "affine"),
        ("gainprm", number_text(gain)),
        ("biasprm", number_text(0.0, -position, -velocity)),
        ("ctrllimited", "false"),  # as in the engine: logged commands are what the robot took
        ("forcelimited", str(is_limited).lower()),
        *force,
    )


def model_law(model: mujoco.MjModel, number: int) -> tuple[tuple[str, str], ...] | None:
    """Return the attributes of an actuator as the model has it; None if it has no such law."""
    if number < 0 or model.actuator_dyntype[number] != mujoco.mjtDyn.mjDYN_NONE:
        return None
    bias = model.actuator_biasprm[number]
    low, high = model.actuator_forcerange[number] if model.actuator_forcelimited[number] else (-inf, inf)
    is_fixed = model.actuator_gaintype[number] == mujoco.mjtGain.mjGAIN_FIXED
    if model.actuator_ctrllimited[number] or not is_fixed or bias[0] != 0.0 or low != -high:
        return None
    return _attributes(float(model.actuator_gainprm[number, 0]), -bias[1], -bias[2], high)


PACKAGE: Final = "simgap"
"""Package whose effects are named by their module; those of other modules by their file."""


def effect_table(effect: Effect, size: Sequence[float]) -> dict[str, Any]:
    """Return a table from which `read_effect` makes the effect again."""
    kind = type(effect)
    is_own = kind.__module__.partition(".")[0] != PACKAGE
    file = {"file": str(Path(sys.modules[kind.__module__].__file__ or "").resolve())} if is_own else {}
    return {
        "effect": effect.name,
        "place": effect.place,
        "text": effect.describe(np.asarray(size, dtype=float)),
        **file,
        "class": kind.__qualname__ if is_own else f"{kind.__module__}:{kind.__qualname__}",
        "size": {one.name: float(value) for one, value in zip(effect.sizes, size, strict=True)},
        "fields": _plain(effect),
    }


def read_effect(table: Mapping[str, Any], path: Path) -> tuple[Effect, Array]:
    """Make effect and sizes, (n_sizes,), of a table, and run a file of one's own; RobotError if it fails."""
    if not isinstance(table, Mapping):
        raise RobotError(f"{path}: effects: {table!r} is no table; write the file again")
    try:
        kind = _effect_class(table)
        effect = cast(Effect, _build(kind, table["fields"]))
        size = {name: float(value) for name, value in table["size"].items()}
        names = [one.name for one in effect.sizes]
    except (KeyError, TypeError, ValueError, ImportError, AttributeError, OSError) as error:
        name = table.get("effect", "an effect")
        raise RobotError(f"{path}: {name}: cannot be made ({error}); write the file again") from error
    if list(size) != names:
        raise RobotError(f"{path}: {effect.key}: size has {', '.join(size)}; it takes {', '.join(names)}")
    _check_sizes(effect, [*size.values()], path)
    return effect, np.array([*size.values()])


def _effect_class(table: Mapping[str, Any]) -> type[Effect]:
    if "file" in table:
        file, name = Path(table["file"]), table["class"]
        loaded = (one for one in list(sys.modules.values()) if getattr(one, "__file__", None) == str(file))
        module: Any = next(loaded, None) or load_module(file)
    else:
        place, _, name = table["class"].partition(":")
        if place.partition(".")[0] != PACKAGE:
            raise ValueError(f"{place} is no module of {PACKAGE}")
        module = importlib.import_module(place)
    kind = getattr(module, name)
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise TypeError(f"{name} is no effect")
    return kind


def _plain(value: Any) -> Any:
    """Return a record as a table; None has no place in TOML and is left out."""
    if is_dataclass(value) and not isinstance(value, type):
        values = {one.name: getattr(value, one.name) for one in fields(value)}
        return {name: _plain(each) for name, each in values.items() if each is not None}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return value


def _build(kind: Any, value: Any) -> Any:
    """Make a value of a type from a table, by the types of the fields."""
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        known = {one.name: hints[one.name] for one in fields(kind)}
        made = {name: _build(known[name], each) for name, each in value.items()}
        absent = {one.name: None for one in fields(kind) if one.name not in made and one.default is MISSING}
        return cast(Any, kind)(**made, **absent)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        each = [inner[0]] * len(value) if inner[1:] == (...,) else inner
        return tuple(_build(one, part) for one, part in zip(each, value, strict=True))
    return float(value) if kind is float else value


MODEL_FILE: Final = "patched.xml"
FOUND_FILE: Final = "effects.toml"
FORMAT: Final = "robot effects 1"


def found_text(
    robot: Robot,
    effects: Sequence[Effect],
    sizes: Sequence[Sequence[float]],
    rivals: Sequence[Rival] = (),
    motions: Sequence[str] = (),
) -> str:
    """Return the text of the file, with the rivals of the findings and the names of the fitted motions."""
    known = {one.key for one in effects}
    others = {one.key: one for rival in rivals for one in rival.effects if one.key not in known}
    tables = {
        "format": FORMAT,
        "joints": [joint.name for joint in robot.joints],
        "motions": list(motions),
        "effects": [effect_table(one, size) for one, size in zip(effects, sizes, strict=True)],
        "rival_effects": [effect_table(one, [0.0] * len(one.sizes)) for one in others.values()],
        "rivals": [_rival_table(one) for one in rivals],
    }
    head = f"Effects of {robot.name} as a diagnosis found them; `simgap diagnose --start` goes on from here."
    return toml_text(tables, [head])


class FoundRival(Record):
    """Rival of a finding in the file."""

    finding: str
    effect: str
    p: Annotated[float, Field(ge=0, le=1)]
    kind: Literal["simulation", "inverse dynamics", "second encoder"]
    n_fitted: Annotated[int, Field(ge=1)]
    sizes: dict[str, list[float]]
    """Sizes of all effects that act, by the key of each."""


class FoundFile(Record):
    """Content of the file; see `found_text`."""

    format: Literal["robot effects 1"]
    joints: list[str]
    motions: list[str] = Field(default_factory=list)
    """Names of those that were fitted."""
    effects: list[dict[str, Any]]
    rival_effects: list[dict[str, Any]] = Field(default_factory=list)
    rivals: list[FoundRival] = Field(default_factory=list)


def read_found(robot: Robot, folder: Path) -> dict[Effect, Array]:
    """Read effects and sizes of a patch, and run files of effects of one's own; RobotError if it has none."""
    path, content = _read_file(robot, folder)
    return dict(_read_effects(robot, content.effects, path))


def read_rivals(robot: Robot, folder: Path, motions: Sequence[str]) -> tuple[Rival, ...]:
    """Read the rivals that a patch keeps, if it keeps any; RobotError as for `read_found`.

    The names of the fitted motions have to be those of the diagnosis.
    """
    path, content = _read_file(robot, folder)
    if content.motions and {*content.motions} != {*motions}:
        shown = ", ".join([*content.motions[:3], *(["..."] if len(content.motions) > 3 else [])])
        raise RobotError(
            f"{path}: {len(content.motions)} motions were fitted ({shown}), of these logs "
            f"{len(motions)} are: give the logs and the held-out motions of the diagnosis"
        )
    tables = (*content.effects, *content.rival_effects)
    effects = {one.key: one for one, _ in _read_effects(robot, tables, path)}
    found = []
    for rival in content.rivals:
        unknown = ({rival.finding, *rival.sizes} - {*effects}) | ({rival.effect} - {*rival.sizes})
        if unknown:
            raise RobotError(f"{path}: rivals: none has the key {min(unknown)!r}; write the patch again")
        for key, size in rival.sizes.items():
            _check_sizes(effects[key], size, path)
        if rival.n_fitted > len(rival.sizes):
            raise RobotError(f"{path}: rivals: n_fitted is {rival.n_fitted}; write 1 to {len(rival.sizes)}")
        acting, sizes = (tuple(effects[key] for key in rival.sizes), map(tuple, rival.sizes.values()))
        found.append(Rival(**rival.model_dump(exclude={"sizes"}), effects=acting, sizes=tuple(sizes)))
    return tuple(found)


def _read_effects(
    robot: Robot, tables: Sequence[Mapping[str, Any]], path: Path
) -> list[tuple[Effect, Array]]:
    """Read effects as `read_effect` does; RobotError if a joint of one is not as the robot has it."""
    found = [read_effect(table, path) for table in tables]
    if len({effect.key for effect, _ in found}) < len(found):
        raise RobotError(f"{path}: two effects have the same name and place; keep one")
    for effect, _ in found:
        joint = getattr(effect, "joint", None)
        # as texts, because a NaN is not equal to itself
        own = [k for k, one in enumerate(robot.joints) if repr(one) == repr(joint)]
        is_moved = isinstance(effect, JointEffect) and effect.place != effect.joint.name
        if joint is not None and (is_moved or getattr(effect, "index", min(own, default=-1)) not in own):
            raise RobotError(
                f"{path}: {effect.key}: mode, gains, limit or gear are not those of the robot file; give the "
                "robot file of the earlier diagnosis"
            )
    return found


def _check_sizes(effect: Effect, sizes: Sequence[float], path: Path) -> None:
    """Raise RobotError unless there is a number for each size, within its bounds."""
    if len(sizes) != len(effect.sizes):
        raise RobotError(f"{path}: {effect.key}: has {len(sizes)} sizes; it takes {len(effect.sizes)}")
    for one, value in zip(effect.sizes, sizes, strict=True):
        if not one.low <= value <= one.high:
            raise RobotError(
                f"{path}: {effect.key}: {one.name} is {value:g}; write {one.low:g} to {one.high:g}"
            )


def _rival_table(one: Rival) -> dict[str, Any]:
    sizes = {effect.key: list(size) for effect, size in zip(one.effects, one.sizes, strict=True)}
    own = {name: getattr(one, name) for name in ("finding", "effect", "p", "kind", "n_fitted")}
    return {**own, "sizes": sizes}


def _read_file(robot: Robot, folder: Path) -> tuple[Path, FoundFile]:
    path = folder / FOUND_FILE
    if not path.is_file():
        raise RobotError(f"{folder}: has no {FOUND_FILE}; give the folder of a patch that a diagnosis wrote")
    content = parse_record(FoundFile, read_toml(path), path)
    own = [joint.name for joint in robot.joints]
    if content.joints != own:
        raise RobotError(
            f"{path}: joints: are {content.joints}, and the robot has {own}; give the same robot file"
        )
    patched, model = folder / MODEL_FILE, robot.path.parent / (robot.file.model if robot.file else "")
    if patched.is_file() and model.is_file() and model.read_bytes() == patched.read_bytes():
        raise RobotError(
            f"{model}: is the patched model, in which the effects of {path} act already; give the model that "
            "was diagnosed"
        )
    return path, content
