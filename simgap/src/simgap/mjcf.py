"""MJCF models: their text with all that it includes, their drives, and joints that are taken out of them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import TreeBuilder, XMLParser

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.common.files import read_bytes
from simgap.common.toml import decode_text
from simgap.files.robot_file import JointTable, RobotFile, SettingTable

MAX_BYTES: Final = 1 << 30
"""Largest size of a model: it may hold its meshes."""
NOT_NEGATIVE: Final = ("mass", "diaginertia", "armature", "damping", "frictionloss")
"""Attributes that a condition does not set below 0."""
FILE_ATTRIBUTES: Final = {"mesh": "meshdir", "texture": "texturedir", "hfield": "meshdir", "skin": "meshdir"}
"""Elements of MJCF that name files, and the setting of the folder that they are relative to."""
FILE_NUMBERS: Final = {"kp": "kp_Nm_rad", "kv": "kd_Nms_rad", "forcerange": "torque_limit_Nm"}
"""Numbers of an actuator in a model, and those of its joint in the robot file that replace them."""


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


def set_conditions(xml: str, file: RobotFile, values: Mapping[str, float], path: Path) -> str:
    """Return the text of a model with numbers that conditions set; RobotError if it has no place for one."""
    root = ElementTree.fromstring(xml)
    taken: dict[tuple[Any, ...], str] = {(None, "timestep"): "time_step_s"}
    for name, joint in file.joints.items():
        own = {each: key for each, key in FILE_NUMBERS.items() if getattr(joint, key) is not None}
        taken |= {(joint.joint or name, each): f"joints.{name}.{key}" for each, key in own.items()}
    is_changed = False
    for name, table in file.conditions.items():
        for k, one in enumerate(table.sets, 1):
            key, attribute = f"conditions.{name}.sets[{k}]", one.attribute.split("/")[-1]
            element, numbers = _find_place(root, one, f"{path}: {key}")
            first = taken.setdefault((element, attribute, one.index or 0), key)
            first = taken.get((element.get("joint"), attribute), first)
            if first != key:
                raise RobotError(f"{path}: {key}: {first} sets this number too; keep one of the two")
            if name in values:
                number = one.offset + one.factor * values[name]
                if number < 0.0 and attribute in NOT_NEGATIVE:  # MuJoCo takes it, and leaves it out
                    where = f"{path}: {key}: with {name} = {values[name]:g}"
                    raise RobotError(f"{where}, {attribute} is {number:g}; give a value of 0 or above")
                numbers[one.index or 0] = repr(number)
                element.set(attribute, " ".join(numbers))
                is_changed = True
    return ElementTree.tostring(root, encoding="unicode") if is_changed else xml


def _find_place(
    root: ElementTree.Element, one: SettingTable, where: str
) -> tuple[ElementTree.Element, list[str]]:
    """Return the element with a number, and all numbers of its attribute."""
    *inner, attribute = one.attribute.split("/")
    every = [*root.iter(one.element)]
    named = [each for each in every if each.get("name", "") == one.name]
    if not named:
        names = [each.get("name", "") for each in every]
        raise RobotError(f"{where}: {describe_unknown(f'<{one.element}>', one.name, names)}")
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
    text = decode_text(read_bytes(path, MAX_BYTES, "an MJCF file"), str(path))
    try:
        return text, ElementTree.fromstring(text, XMLParser(target=TreeBuilder(insert_comments=True)))
    except ElementTree.ParseError as error:
        raise RobotError(f"{path}: is not XML: {error}") from error


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
    low = np.where(model.jnt_limited, model.jnt_range[:, 0], -np.pi)
    high = np.where(model.jnt_limited, model.jnt_range[:, 1], np.pi)
    torque_Nm, poses = np.empty((N_POSES, model.nv)), np.tile(data.qpos, (N_POSES, 1))
    # a fixed sample: the robot of a file is always the same
    for k, kind in enumerate((mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)):
        own = model.jnt_type == kind
        size = N_POSES, np.count_nonzero(own)
        poses[:, model.jnt_qposadr[own]] = np.random.default_rng(k).uniform(low[own], high[own], size)
    for pose, torque in zip(poses, torque_Nm, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, torque)
    return np.asarray(np.ptp(torque_Nm, axis=0) / 2)


@dataclass(frozen=True, slots=True)
class Drive:
    """Drive of a joint as a model has it, in the units of the joint."""

    actuator: int = -1
    """-1 if the model has none."""
    kp_Nm_rad: float = 0.0
    """Stiffness of the position loop; 0 if the model has none."""
    kd_Nms_rad: float = 0.0
    torque_constant_Nm_A: float | None = None
    """Torque for 1 A; None if the model has no DC motor."""
    torque_Nm_V: float | None = None
    """Torque for 1 V at rest; None if the model has no DC motor."""
    back_emf_Nms_rad: float = 0.0
    """Damping by the back-EMF, while the voltage is given."""


def read_drive(table: JointTable, model: mujoco.MjModel, joint: int, where: str) -> Drive:
    """Read the drive of a joint, by its index in the model; RobotError if it cannot be diagnosed."""
    k = _find_actuator(table, model, joint, where)
    if k < 0:
        return Drive()
    if words := next(_own_dynamics(model, k), ""):
        raise RobotError(f"{where}.actuator: {model.actuator(k).name!r} {words}")
    gear = float(model.actuator_gear[k, 0])
    # Length and force of an actuator are both scaled by its gear.
    if model.actuator_dyntype[k] != mujoco.mjtDyn.mjDYN_DCMOTOR:
        is_affine = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
        bias = model.actuator_biasprm[k]
        kp, kd = (-float(bias[1]) * gear**2, -float(bias[2]) * gear**2) if is_affine else (0.0, 0.0)
        return Drive(k, kp, kd)
    resistance_Ohm, constant_Nm_A = (float(one) for one in model.actuator_gainprm[k, :2])
    kp, kd = float(model.actuator_gainprm[k, 4]) * gear**2, float(model.actuator_gainprm[k, 6]) * gear**2
    back_emf = gear**2 * constant_Nm_A**2 / resistance_Ohm
    if model.actuator_ctrlspec[k] == mujoco.mjtCtrlInput.mjINPUT_VOLTAGE and table.mode != "velocity":
        kp, kd = 0.0, back_emf
    return Drive(k, kp, kd, abs(gear) * constant_Nm_A, gear * constant_Nm_A / resistance_Ohm, back_emf)


def _find_actuator(table: JointTable, model: mujoco.MjModel, joint: int, where: str) -> int:
    """Return the index of the actuator of a joint, -1 if the model has none."""
    driving = [
        k
        for k in range(model.nactuator)
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_trnid[k, 0] == joint
    ]
    names = {model.actuator(k).name: k for k in driving}
    if table.actuator:
        if table.actuator not in names:
            raise RobotError(f"{where}.actuator: {describe_unknown('actuator', table.actuator, list(names))}")
        return names[table.actuator]
    if len(driving) > 1:
        shown = ", ".join(filter(None, names)) or "without a name in the model,"
        raise RobotError(
            f"{where}.actuator: {len(driving)} actuators, {shown} drive this joint; name one of them"
        )
    return driving[0] if driving else -1


def _own_dynamics(model: mujoco.MjModel, k: int) -> Iterator[str]:
    """Say what an actuator has beside gains, damping and a limit, and what would be right."""
    own, gain = model.actuator_dynprm[k], model.actuator_gainprm[k]
    if model.actuator_ctrlnum[k] > 1:
        yield f"takes {model.actuator_ctrlnum[k]} commands; a diagnosis has one, so give it one input"
    if model.actuator_delay[k] > 0.0:
        yield "has a delay of its own; a diagnosis looks for delays, so take it out of the model"
    if model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE:
        return
    if model.actuator_dyntype[k] != mujoco.mjtDyn.mjDYN_DCMOTOR:
        yield "has dynamics of its own (timeconst ..); a diagnosis lacks them, so take them out of the model"
    parts = {
        "inductance": own[0] != 0.0,
        "thermal": own[2:4].any(),
        "lugre": own[5:7].any(),
        "cogging": model.actuator_biasprm[k, 0] != 0.0,
        "an integral gain or slewmax of its controller": gain[5] != 0.0 or own[7] != 0.0,
    }
    for name, is_there in parts.items():
        if is_there:
            yield f"has dynamics of its own ({name}); a diagnosis lacks them, so take them out of the model"
    if gain[7] != 0.0:
        yield (
            "has a largest voltage of its controller, so that its torque falls with the speed; a diagnosis "
            "looks for that as back-EMF: take it out of the model, and give the stall torque as saturation"
        )
    if model.actuator_ctrlspec[k] == mujoco.mjtCtrlInput.mjINPUT_VEL and gain[4] != 0.0:
        yield "has the input vel and a gain on the position; a diagnosis lacks this law, so set kp to 0"


def read_torque_limit(model: mujoco.MjModel, joint: int, actuator: int, where: str) -> float:
    """Return the smaller limit of an actuator and of its joint [N m], infinite if there is none."""
    ranges = {}
    if actuator >= 0 and model.actuator_forcelimited[actuator]:
        ranges["forcerange"] = model.actuator_forcerange[actuator] * abs(model.actuator_gear[actuator, 0])
    if model.jnt_actfrclimited[joint]:
        ranges["actuatorfrcrange"] = model.jnt_actfrcrange[joint]
    unit = "N" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else "N m"
    for name, (low, high) in ranges.items():
        if low != -high:
            raise RobotError(
                f"{where}.torque_limit_Nm: {name} of the model is {low:g} to {high:g} {unit} at the joint; "
                "give one limit for both directions"
            )
    return min((float(high) for _, high in ranges.values()), default=math.inf)


def describe_unknown(kind: str, name: str, names: list[str]) -> str:
    """Say that a model has no element of a name, and which it has."""
    near = get_close_matches(name, names, 1) or [", ".join(filter(None, names)) or "none"]
    hint = f"did you mean {near[0]}?" if near[0] in names else f"it has {near[0]}"
    return f"the model has no {kind} {name!r}; {hint}"
