"""MJCF models: their text with all that it includes, and joints that are taken out of them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import TreeBuilder, XMLParser

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files.robot_file import ConditionTable, SettingTable

FILE_ATTRIBUTES: Final = {"mesh": "meshdir", "texture": "texturedir", "hfield": "meshdir", "skin": "meshdir"}
"""Elements of MJCF that name files, and the setting of the folder that they are relative to."""


def read_model_text(path: Path) -> str:
    """Read an MJCF file such that its text compiles from any folder; RobotError if it is no XML."""
    text, root = _read_xml(path)
    if root.tag != "mujoco":
        raise RobotError(f"{path}: its root is <{root.tag}>; name an MJCF file, which begins with <mujoco>")
    if not any(one.tag in (*FILE_ATTRIBUTES, "include") and "file" in one.attrib for one in root.iter()):
        return text
    _insert_includes(root, path.parent, (path.resolve(),))
    settings = {name: value for one in root.iter("compiler") for name, value in one.attrib.items()}
    for one in root.iter():
        if one.tag in FILE_ATTRIBUTES and "file" in one.attrib:
            below = settings.get(FILE_ATTRIBUTES[one.tag], settings.get("assetdir", ""))
            one.set("file", str((path.parent / below / one.attrib["file"]).resolve()))
    return ElementTree.tostring(root, encoding="unicode")


def _insert_includes(root: ElementTree.Element, folder: Path, within: tuple[Path, ...]) -> None:
    """Put the elements of included files in the place of each include; paths begin at `folder`."""
    for parent in [*root.iter()]:
        for k, child in reversed([*enumerate(parent)]):
            if child.tag == "include":
                path = (folder / child.attrib.get("file", "")).resolve()
                if path in within:
                    raise RobotError(f"{path}: includes itself; remove this include")
                _, included = _read_xml(path)
                _insert_includes(included, folder, (*within, path))
                parent[k : k + 1] = [*included]


def set_conditions(
    xml: str, tables: Mapping[str, ConditionTable], values: Mapping[str, float], path: Path
) -> str:
    """Return the text of a model with numbers that conditions set; RobotError if it has no place for one."""
    root = ElementTree.fromstring(xml)
    is_changed = False
    for name, table in tables.items():
        for one in table.sets:
            element, numbers = _find_place(root, one, f"{path}: conditions.{name}.sets")
            if name in values:
                numbers[one.index or 0] = repr(one.offset + one.factor * values[name])
                element.set(one.attribute.split("/")[-1], " ".join(numbers))
                is_changed = True
    return ElementTree.tostring(root, encoding="unicode") if is_changed else xml


def _find_place(
    root: ElementTree.Element, one: SettingTable, where: str
) -> tuple[ElementTree.Element, list[str]]:
    """Return the element with a number, and all numbers of its attribute."""
    *inner, attribute = one.attribute.split("/")
    named = [each for each in root.iter(one.element) if each.get("name", "") == one.name]
    found = [part for each in named for part in (each.findall("/".join(inner)) if inner else [each])]
    if len(found) != 1:
        words = f"<{one.element}>" + (f" named {one.name!r}" if one.name else " without a name")
        inside = f" with <{'/'.join(inner)}>" if inner else ""
        raise RobotError(f"{where}: the model has {len(found)} {words}{inside}; name what it has once")
    numbers = [""] if one.index is None else found[0].get(attribute, "").split()
    if (one.index or 0) >= len(numbers):
        raise RobotError(
            f"{where}: {attribute} of {one.name or one.element!r} has {len(numbers)} numbers in the model; "
            "write all of them there, or take an index below"
        )
    return found[0], numbers


def _read_xml(path: Path) -> tuple[str, ElementTree.Element]:
    """Read a file of XML as text and as a tree."""
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise RobotError(f"{path}: is no regular file; name an MJCF file")
        text = path.read_text(encoding="utf-8")
        return text, ElementTree.fromstring(text, XMLParser(target=TreeBuilder(insert_comments=True)))
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror}); name an MJCF file") from error
    except ElementTree.ParseError as error:
        raise RobotError(f"{path}: is not XML: {error}") from error
    except UnicodeDecodeError as error:
        raise RobotError(f"{path}: is not UTF-8 text; name an MJCF file") from error
    except ValueError as error:  # a zero byte in the name
        raise RobotError(f"{str(path)!r}: is no name of a file; name an MJCF file") from error


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return the name of a joint, or that of its body if it has none."""
    return str(model.joint(joint).name or model.body(int(model.jnt_bodyid[joint])).name)


def tied_joints(model: mujoco.MjModel, joint: int) -> list[str]:
    """Return the names of a joint and of all that tendons and equalities of joints tie to it."""
    found, groups = {joint}, list(_tied(model))
    while any(found & group and not group <= found for group in groups):
        found |= set().union(*(group for group in groups if found & group))
    return [joint_name(model, one) for one in sorted(found)]


def _tied(model: mujoco.MjModel) -> Iterator[set[int]]:
    """Yield the joints of each equality of joints and of each fixed tendon."""
    for k in range(model.neq):
        if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT:
            yield {int(one) for one in (model.eq_obj1id[k], model.eq_obj2id[k]) if one >= 0}
    for k in range(model.ntendon):
        yield joints_of_tendon(model, k)


def place_tied(model: mujoco.MjModel, dofs: Sequence[int], qpos: Array, qvel: Array) -> None:
    """Set joints that equalities tie to others where these put them; else a start would jerk both.

    A joint on which others depend is set only if they depend on it in proportion.

    Args:
        dofs: Degrees of freedom that are set.
        qpos: Positions of hinges and slides, (..., nq).
        qvel: Speeds, (..., nv).
    """
    if not model.neq:
        return
    known = {int(model.dof_jntid[dof]) for dof in dofs}
    for k in np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & model.eq_active0.astype(bool)):
        first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        law = np.polynomial.Polynomial(model.eq_data[k, :5])
        if second in known and first not in known:
            own, other = first, second
        elif (
            first in known and second >= 0 and second not in known and law.coef[1] and not law.coef[2:].any()
        ):
            own, other = second, first
            law = np.polynomial.Polynomial(np.array([-law.coef[0], 1.0]) / law.coef[1])
        else:
            continue
        (q, from_q), (v, from_v) = model.jnt_qposadr[[own, other]], model.jnt_dofadr[[own, other]]
        moved = qpos[..., from_q] - model.qpos0[from_q]
        qpos[..., q] = model.qpos0[q] + law(moved)
        qvel[..., v] = law.deriv()(moved) * qvel[..., from_v]
        known.add(own)


def joints_of_tendon(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Return the joints of a fixed tendon."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    return {int(model.wrap_objid[k]) for k in wraps if model.wrap_type[k] == mujoco.mjtWrap.mjWRAP_JOINT}


def take_out_joints(spec: mujoco.MjSpec, names: Sequence[str]) -> None:
    """Take joints out of a model, with what drives, ties and measures them: their bodies stand still.

    Args:
        names: Names as `joint_name` has them; all joints that are tied to one another are among them.
    """
    if not names:
        return
    model = spec.compile()
    out = {k for k in range(model.njnt) if joint_name(model, k) in names}
    joints = {model.joint(k).name for k in out} - {""}
    cut = [one for k, one in enumerate(spec.tendons) if joints_of_tendon(model, k) & out]
    tendons = {one.name for one in cut} - {""}
    parts: list[Any] = [*spec.keys, *spec.sensors]
    for one in spec.actuators:
        in_tendon = one.trntype == mujoco.mjtTrn.mjTRN_TENDON
        parts += [one] * (one.target in (tendons if in_tendon else joints))
    for one in spec.equalities:
        in_tendon = one.type == mujoco.mjtEq.mjEQ_TENDON
        ties = one.type == mujoco.mjtEq.mjEQ_JOINT or in_tendon
        parts += [one] * (ties and bool({one.name1, one.name2} & (tendons if in_tendon else joints)))
    parts += cut
    parts += [one for one in spec.joints if (one.name or one.parent.name) in names]
    for one in parts:
        spec.delete(one)


N_POSES: Final = 256
"""Number of random poses for the gravity torques; the extremes over six joints are good to some percent."""


def gravity_amplitudes(model: mujoco.MjModel) -> Array:
    """Return half the range of the gravity torque of each degree of freedom, (nv,) [N m], at random poses."""
    data = mujoco.MjData(model)
    # a fixed sample: the robot of a file is always the same
    kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    draws = [(model.jnt_type == kind, np.random.default_rng(k)) for k, kind in enumerate(kinds)]
    low = np.where(model.jnt_limited, model.jnt_range[:, 0], -np.pi)
    high = np.where(model.jnt_limited, model.jnt_range[:, 1], np.pi)
    torque_Nm = np.empty((N_POSES, model.nv))
    for k in range(N_POSES):
        for own, random in draws:
            data.qpos[model.jnt_qposadr[own]] = random.uniform(low[own], high[own])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, torque_Nm[k])
    return np.asarray(np.ptp(torque_Nm, axis=0) / 2)
