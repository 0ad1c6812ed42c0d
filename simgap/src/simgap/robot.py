"""A robot: its compiled model, how its joints are driven and logged, and how it is made from its file."""

import math
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from pathlib import Path
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import TreeBuilder, XMLParser

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files.robot_file import JointTable, RobotFile, read_model_file

# MuJoCo would write its warnings to a file in the current directory; simulations look for bad states
mujoco.set_mju_user_warning(lambda _: None)


class ControlMode(StrEnum):
    """Law by which a command becomes a torque."""

    POSITION = "position"
    """Torque = kp (command - position) - kd velocity."""
    VELOCITY = "velocity"
    """Torque = kd (command - velocity)."""
    TORQUE = "torque"
    """Torque = command."""
    CURRENT = "current"
    """Torque = torque constant times command."""


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """A joint with one degree of freedom, and its motor."""

    name: str
    qpos_index: int
    dof_index: int
    actuator_index: int
    """-1 if the model has no actuator for it."""
    mode: ControlMode
    kp_Nm_rad: float
    """Nominal stiffness of the position loop; per unit of the gain column, where the log has one."""
    kd_Nms_rad: float
    """Nominal damping of the position or velocity loop."""
    torque_limit_Nm: float
    """Largest torque at the joint; infinite if unlimited."""
    gear_ratio: float
    """Motor turns per turn of the joint; logged motor torques are multiplied by it."""
    torque_constant_Nm_A: float
    """Torque at the joint per ampere; NaN if unknown."""
    is_known: bool
    """True if friction, damping, armature and gain are measured numbers, so that none is a nuisance."""
    is_loaded_by_gravity: bool
    """False if gravity moves the joint by less than its friction: only ratios to the gain can be known."""


@dataclass(frozen=True, slots=True)
class Robot:
    """A robot file with its model compiled."""

    name: str
    model: mujoco.MjModel
    """Its time step is the step of the simulation."""
    model_xml: str
    """MJCF text of the model, from which variants with added joints are compiled."""
    joints: tuple[RobotJoint, ...]
    control_period_s: float
    """Period of the inner control loop, a whole number of time steps: effects act once in it."""
    tool_site: str
    """Site that may touch a plane; empty if none."""
    file: RobotFile | None = None
    """Content of the robot file, by which logs are read; None for a robot that was made in memory."""
    folder: Path = Path()
    """Folder of the robot file."""

    @classmethod
    def from_toml(cls, path: str | Path) -> "Robot":
        """Read a robot file and compile its model.

        Raises:
            RobotError: the file, the model, or what the one says of the other is wrong.
        """
        return _build_robot(Path(path))

    def joint(self, name: str) -> RobotJoint:
        """Return the joint with this name."""
        return next(joint for joint in self.joints if joint.name == name)


N_POSES: Final = 256
"""Number of random poses for the gravity torques; the extremes over six joints are good to some percent."""
ROUNDING: Final = 1e-3
"""Share of the largest gravity torque of the robot below which one is rounding of frames and of masses."""
FILE_ATTRIBUTES: Final = {"mesh": "meshdir", "texture": "texturedir", "hfield": "meshdir", "skin": "meshdir"}
"""Elements of MJCF that name files, and the setting of the folder that they are relative to."""


def _build_robot(path: Path) -> Robot:
    file = read_model_file(path)
    model_path = path.parent / file.model
    xml = read_model_text(model_path)
    try:
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise RobotError(f"{model_path}: MuJoCo cannot compile it: {' '.join(str(error).split())}") from error
    model.opt.timestep = file.time_step_s
    gravity_Nm = gravity_amplitudes(model)
    joints = tuple(_joint(name, table, model, path, gravity_Nm) for name, table in file.joints.items())
    _check_joints(file, joints, model, path)
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, file.tool_site)
    if file.tool_site and site < 0:
        names = [model.site(k).name for k in range(model.nsite)]
        raise RobotError(f"{path}: tool_site: {_unknown('site', file.tool_site, names)}")
    period_s = round(1.0 / (file.control_rate_Hz * file.time_step_s)) * file.time_step_s
    return Robot(file.name, model, xml, joints, period_s, file.tool_site, file, path.parent)


def read_model_text(path: Path) -> str:
    """Read an MJCF file such that its text compiles from any folder.

    Raises:
        RobotError: it cannot be read or is no XML.
    """
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


def gravity_amplitudes(model: mujoco.MjModel) -> Array:
    """Return half the range of the gravity torque of each degree of freedom, (nv,) [N m], at random poses."""
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)  # a fixed sample: the robot of a file is always the same
    low = np.where(model.jnt_limited, model.jnt_range[:, 0], -np.pi)
    high = np.where(model.jnt_limited, model.jnt_range[:, 1], np.pi)
    hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    torque_Nm = np.empty((N_POSES, model.nv))
    for k in range(N_POSES):
        data.qpos[model.jnt_qposadr[hinges]] = random.uniform(low[hinges], high[hinges])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, torque_Nm[k])
    return np.asarray(np.ptp(torque_Nm, axis=0) / 2)


def _joint(name: str, table: JointTable, model: mujoco.MjModel, path: Path, gravity_Nm: Array) -> RobotJoint:
    """Find a joint in the model, and take from the model what the file does not say."""
    where = f"{path}: joints.{name}"
    in_model = table.joint or name
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, in_model)
    if number < 0:
        names = [model.joint(k).name for k in range(model.njnt)]
        raise RobotError(f"{where}.joint: {_unknown('joint', in_model, names)}")
    if model.jnt_type[number] != mujoco.mjtJoint.mjJNT_HINGE:
        raise RobotError(f"{where}.joint: {in_model!r} is no hinge; only hinges can be diagnosed")
    dof = int(model.jnt_dofadr[number])
    actuator = _actuator(table, model, number, where)
    if actuator >= 0 and model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_NONE:
        raise RobotError(
            f"{where}.actuator: {model.actuator(actuator).name!r} has dynamics of its own (timeconst ..); "
            "a diagnosis lacks them, so take them out of the model"
        )
    kp, kd = _gains(model, actuator)
    kp = kp if table.kp_Nm_rad is None else table.kp_Nm_rad
    kd = kd if table.kd_Nms_rad is None else table.kd_Nms_rad
    if table.mode == "position" and kp == 0.0:
        raise RobotError(f"{where}.kp_Nm_rad: is 0 or missing, and the model has no gain; give one above 0")
    if table.mode == "velocity" and kd == 0.0:
        raise RobotError(f"{where}.kd_Nms_rad: is 0 or missing, and the model has no gain; give one above 0")
    limit_Nm = table.torque_limit_Nm
    if limit_Nm is None:
        limit_Nm = _torque_limit(model, number, actuator, where)
    threshold_Nm = max(float(model.dof_frictionloss[dof]), ROUNDING * float(np.max(gravity_Nm)))
    return RobotJoint(
        name=name,
        qpos_index=int(model.jnt_qposadr[number]),
        dof_index=dof,
        actuator_index=actuator,
        mode=ControlMode(table.mode),
        kp_Nm_rad=kp,
        kd_Nms_rad=kd,
        torque_limit_Nm=limit_Nm,
        gear_ratio=table.gear_ratio,
        torque_constant_Nm_A=math.nan if table.torque_constant_Nm_A is None else table.torque_constant_Nm_A,
        is_known=table.is_known,
        is_loaded_by_gravity=bool(gravity_Nm[dof] > threshold_Nm),
    )


def _actuator(table: JointTable, model: mujoco.MjModel, joint: int, where: str) -> int:
    """Return the index of the actuator of a joint, -1 if the model has none."""
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    driving = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint)).tolist()
    names = {model.actuator(k).name: k for k in driving}
    if table.actuator:
        if table.actuator not in names:
            raise RobotError(f"{where}.actuator: {_unknown('actuator', table.actuator, list(names))}")
        return names[table.actuator]
    if len(driving) > 1:
        shown = ", ".join(filter(None, names)) or "without a name in the model,"
        raise RobotError(
            f"{where}.actuator: {len(driving)} actuators, {shown} drive this joint; name one of them"
        )
    return int(driving[0]) if driving else -1


def _gains(model: mujoco.MjModel, actuator: int) -> tuple[float, float]:
    """Return stiffness [N m/rad] and damping [N m s/rad] of an actuator at its joint."""
    if actuator < 0 or model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_AFFINE:
        return 0.0, 0.0
    gear, bias = float(model.actuator_gear[actuator, 0]), model.actuator_biasprm[actuator]
    # Length and force of an actuator are both scaled by its gear.
    return -float(bias[1]) * gear**2, -float(bias[2]) * gear**2


def _torque_limit(model: mujoco.MjModel, joint: int, actuator: int, where: str) -> float:
    """Return the smaller limit of an actuator and of its joint [N m], infinite if there is none."""
    ranges = {}
    if actuator >= 0 and model.actuator_forcelimited[actuator]:
        ranges["forcerange"] = model.actuator_forcerange[actuator] * abs(model.actuator_gear[actuator, 0])
    if model.jnt_actfrclimited[joint]:
        ranges["actuatorfrcrange"] = model.jnt_actfrcrange[joint]
    for name, (low, high) in ranges.items():
        if low != -high:
            raise RobotError(
                f"{where}.torque_limit_Nm: {name} of the model is {low:g} to {high:g} N m at the joint; "
                "give one limit for both directions"
            )
    return min((float(high) for _, high in ranges.values()), default=math.inf)


def _check_joints(file: RobotFile, joints: tuple[RobotJoint, ...], model: mujoco.MjModel, path: Path) -> None:
    """Refuse a joint that is named twice, and a driven joint of the model that is not named."""
    used = [one.dof_index for one in joints]
    for k, one in enumerate(joints):
        if one.dof_index in used[:k]:
            raise RobotError(f"{path}: joints.{one.name}.joint: is the joint of another table; name its own")
    for k in range(model.nu):
        joint = int(model.actuator_trnid[k, 0])
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and model.jnt_dofadr[joint] not in used:
            raise RobotError(
                f"{path}: joints: the model drives {model.joint(joint).name!r}, which has no table; add one"
            )


def _unknown(kind: str, name: str, names: list[str]) -> str:
    near = get_close_matches(name, names, 1) or [", ".join(filter(None, names)) or "none"]
    hint = f"did you mean {near[0]}?" if near[0] in names else f"it has {near[0]}"
    return f"the model has no {kind} {name!r}; {hint}"
