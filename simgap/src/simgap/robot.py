"""A robot: its compiled model, how its joints are driven and logged, and how it is made from its file."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Final

import mujoco
import numpy as np

import simgap.mjcf as mjcf
from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files.robot_file import JointTable, RobotFile, read_model_file
from simgap.units import find_unit

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
    VOLTAGE = "voltage"
    """Torque = kp command - kd velocity, with kp for 1 V, and the damping of the back-EMF."""


SLIDE_m_rad: Final = 0.1
"""Distance of a slide that is worth as much as 1 rad of a hinge: the hinge moves a point 10 cm away as far.
Typical sizes of effects, which are known for hinges, are converted with it."""
SLIDE_UNITS: Final = (
    *(("Nms_rad", "Ns_m"), ("Nm_rad", "N_m"), ("rad_Nm", "m_N"), ("Nm_K", "N_K"), ("Nm_A", "N_A")),
    *(("kgm2", "kg"), ("rad_s", "m_s"), ("s_rad", "s_m"), ("s2_rad", "s2_m"), ("rad", "m"), ("Nm", "N")),
)
"""Units in the names of numbers of a hinge, and those of a slide."""


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """A joint with one degree of freedom, and its motor.

    Here and in all that follows, a name with the suffix rad, Nm or kgm2 means the unit of the joint: of a
    slide m, N and kg. `unit` and `name_of` give what people read.
    """

    name: str
    qpos_index: int
    dof_index: int
    mode: ControlMode
    kp_Nm_rad: float
    """Nominal stiffness of the position loop; per unit of the gain column, where the log has one. Torque for
    1 V in the mode voltage. NaN if it is unknown, as it may be where torques are compared."""
    kd_Nms_rad: float
    """Nominal damping of the position or velocity loop; NaN if that of the latter is unknown."""
    torque_limit_Nm: float
    """Largest torque at the joint; infinite if unlimited."""
    actuator_index: int = -1
    """-1 if the model has no actuator for it."""
    gear_ratio: float = 1.0
    """Motor turns per turn of the joint; logged motor torques are multiplied by it."""
    torque_constant_Nm_A: float = math.nan
    """Torque at the joint per ampere; NaN if unknown."""
    is_known: bool = False
    """True if friction, damping, armature and gain are measured numbers, so that none is a nuisance."""
    is_loaded_by_gravity: bool = True
    """False if gravity changes by less than friction, as at a vertical slide: only ratios to the gain can be
    known."""
    is_slide: bool = False
    torque_constant_is_known: bool = True
    """False if it is a base parameter."""

    @property
    def unit(self) -> str:
        """Unit of the position."""
        return "m" if self.is_slide else "rad"

    @property
    def effort_unit(self) -> str:
        """Unit of the torque, of a slide the force."""
        return "N" if self.is_slide else "N m"

    @property
    def per_rad(self) -> float:
        """Distance that is worth as much as 1 rad."""
        return SLIDE_m_rad if self.is_slide else 1.0

    def show(self, position_rad: float, digits: str = ".4g") -> str:
        """Return a position as text: rad, of a slide mm."""
        return f"{1e3 * position_rad:{digits}} mm" if self.is_slide else f"{position_rad:{digits}} rad"

    def show_small(self, difference_rad: float, digits: str = ".3g") -> str:
        """Return a small difference of positions as text: mrad, of a slide mm."""
        return f"{1e3 * difference_rad:{digits}} m{self.unit}"

    @property
    def knows_gains(self) -> bool:
        """False if the loop has no gain: its torques can be compared, but not its positions."""
        gain = {ControlMode.POSITION: self.kp_Nm_rad, ControlMode.VELOCITY: self.kd_Nms_rad}
        return math.isfinite(gain.get(self.mode, 0.0))

    def name_of(self, name: str) -> str:
        """Return the name of a number with the unit of this joint: coulomb_Nm of a slide is coulomb_N."""
        for unit, of_slide in SLIDE_UNITS if self.is_slide else ():
            if name.endswith(f"_{unit}"):
                return name.removesuffix(unit) + of_slide
        return name


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
    path: Path = Path()
    """Robot file."""
    left_out: tuple[str, ...] = ()
    """Joints of the text that are not in the model, as `mjcf.joint_name` has them."""

    @classmethod
    def from_toml(cls, path: str | Path) -> "Robot":
        """Read a robot file and compile its model; RobotError if one or the other is wrong."""
        return build_robot(read_model_file(Path(path)), Path(path))

    def show(self, joint: str, position_rad: float) -> str:
        """Return a position of a joint as text: degrees if its log has them, else rad; of a slide mm."""
        table = None if self.file is None else self.file.joints.get(joint)
        if table is not None and table.position.unit == "deg":
            return f"{math.degrees(position_rad):.3g} deg"
        return self.joint(joint).show(position_rad, ".3g")

    def under(self, conditions: Mapping[str, float]) -> "Robot":
        """Return the robot with numbers of its model that conditions set; RobotError if it has no such."""
        if self.file is None or not any(one.sets for one in self.file.conditions.values()):
            return self
        return build_robot(self.file, self.path, conditions)

    def joint(self, name: str) -> RobotJoint:
        """Return the joint with this name."""
        return next(joint for joint in self.joints if joint.name == name)

    def mjcf_joint(self, name: str) -> str:
        """Return the name that the model has for a joint; models with added bodies keep it."""
        return str(self.model.joint(int(self.model.dof_jntid[self.joint(name).dof_index])).name)

    def range_rad(self, name: str) -> tuple[float, float]:
        """Return the limits of a joint in the model, infinite without any."""
        number = int(self.model.dof_jntid[self.joint(name).dof_index])
        low, high = self.model.jnt_range[number] if self.model.jnt_limited[number] else (-math.inf, math.inf)
        return float(low), float(high)


ROUNDING: Final = 1e-3
"""Share of the largest gravity torque of the robot below which one is rounding of frames and of masses."""


def build_robot(file: RobotFile, path: Path, conditions: Mapping[str, float] = MappingProxyType({})) -> Robot:
    """Compile the model of a robot file that is, or will be, at this path; RobotError if it is wrong."""
    model_path = path.parent / file.model
    text = mjcf.read_model_text(model_path)
    for name, table in file.conditions.items() if not conditions else ():
        for value in table.possible:
            mjcf.set_conditions(text, file, {name: value}, path)  # refuses what no model has
    xml = mjcf.set_conditions(text, file, conditions, path)
    left_out = tuple(file.left_out)
    try:
        model = mujoco.MjModel.from_xml_string(xml)
        if left_out:
            _check_left_out(file, model, path)
            spec = mujoco.MjSpec.from_string(xml)
            mjcf.take_out_joints(spec, left_out)
            model = spec.compile()
    except ValueError as error:
        under = "".join(f" with {name} = {value:g}" for name, value in conditions.items())
        why = " ".join(str(error).split())
        where = f"{path}: sets of conditions: {model_path}" if conditions else model_path
        why = re.sub(r",? line \d+", "", why) if conditions else why  # of a text that nobody sees
        raise RobotError(f"{where}: MuJoCo cannot compile it{under}: {why}") from error
    model.opt.timestep = file.time_step_s
    _check_base(model, path)
    numbers = {name: _find_joint(name, table, model, path) for name, table in file.joints.items()}
    _check_joints(numbers, model, path)
    drives = {
        name: mjcf.read_drive(table, model, numbers[name], f"{path}: joints.{name}")
        for name, table in file.joints.items()
    }
    gravity_Nm = mjcf.gravity_amplitudes(model)
    needs_gains = not all(has_torque(table, drives[name]) for name, table in file.joints.items())
    joints = tuple(
        _joint(name, table, model, path, numbers[name], drives[name], gravity_Nm, needs_gains)
        for name, table in file.joints.items()
    )
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, file.tool_site)
    if file.tool_site and site < 0:
        names = [model.site(k).name for k in range(model.nsite)]
        raise RobotError(f"{path}: tool_site: {mjcf.describe_unknown('site', file.tool_site, names)}")
    period_s = round(1.0 / (file.control_rate_Hz * file.time_step_s)) * file.time_step_s
    return Robot(file.name, model, xml, joints, period_s, file.tool_site, file, path, left_out)


def has_torque(table: JointTable, drive: mjcf.Drive) -> bool:
    """Return whether the torque of a joint is logged, or needs not be, because it has no command."""
    has_constant = table.torque_constant_Nm_A is not None or drive.torque_constant_Nm_A is not None
    return table.command is None or table.torque is not None or (table.current is not None and has_constant)


def _find_joint(name: str, table: JointTable, model: mujoco.MjModel, path: Path) -> int:
    """Return the index of a joint in the model, and refuse one of another kind than its columns."""
    where = f"{path}: joints.{name}"
    in_model = table.joint or name
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, in_model)
    if number < 0:
        names = [model.joint(k).name for k in range(model.njnt)]
        raise RobotError(f"{where}.joint: {mjcf.describe_unknown('joint', in_model, names)}")
    kind = model.jnt_type[number]
    is_slide = kind == mujoco.mjtJoint.mjJNT_SLIDE
    if not is_slide and kind != mujoco.mjtJoint.mjJNT_HINGE:
        raise RobotError(f"{where}.joint: {in_model!r} is no hinge and no slide; only these can be diagnosed")
    low, high = model.jnt_range[number] if model.jnt_limited[number] else (-np.inf, np.inf)
    if table.possible_rad and not low <= table.possible_rad[0] < table.possible_rad[1] <= high:
        raise RobotError(
            f"{where}.possible_rad: leaves the range {low:.4g} to {high:.4g} of the model; stay within it"
        )
    for key, quantities in table.quantities().items():
        column = getattr(table, key)
        if column is None or len(quantities) == 1 or column.at_0_rad is not None or table.is_of_topic(column):
            continue
        own = quantities[is_slide and column.side == "joint"]
        try:
            find_unit(column.unit, own)
        except ValueError as error:
            side = "; its motor turns" if is_slide and own is quantities[0] else ""
            raise RobotError(
                f"{where}.{key}.unit: {error}, as {in_model!r} is a {'slide' if is_slide else 'hinge'}{side}"
            ) from error
    return int(number)


def _joint(
    name: str,
    table: JointTable,
    model: mujoco.MjModel,
    path: Path,
    number: int,
    drive: mjcf.Drive,
    gravity_Nm: Array,
    needs_gains: bool,
) -> RobotJoint:
    """Take from the model what the file does not say."""
    where, dof = f"{path}: joints.{name}", int(model.jnt_dofadr[number])
    kp, kd = _gains(table, drive, where, needs_gains)
    own = table.torque_constant_Nm_A
    constant = drive.torque_constant_Nm_A if own is None else own
    if constant is None and table.mode == "current":
        raise RobotError(f"{where}.torque_constant_Nm_A: is missing; the mode current needs it")
    if constant is None and not table.torque_constant_is_known:
        raise RobotError(
            f"{where}.torque_constant_Nm_A: is missing; "
            "with torque_constant_is_known = false it is the start of the fit"
        )
    limit_Nm = table.torque_limit_Nm
    if limit_Nm is None:
        limit_Nm = mjcf.read_torque_limit(model, number, drive.actuator, where)
    # forces and torques do not compare
    alike_Nm = gravity_Nm[model.jnt_type[model.dof_jntid] == model.jnt_type[number]]
    threshold_Nm = max(float(model.dof_frictionloss[dof]), ROUNDING * float(np.max(alike_Nm)))
    return RobotJoint(
        name=name,
        qpos_index=int(model.jnt_qposadr[number]),
        dof_index=dof,
        actuator_index=drive.actuator,
        mode=ControlMode(table.mode),
        kp_Nm_rad=kp,
        kd_Nms_rad=kd,
        torque_limit_Nm=limit_Nm,
        gear_ratio=table.gear_ratio,
        torque_constant_Nm_A=math.nan if constant is None else constant,
        is_known=table.is_known,
        is_loaded_by_gravity=bool(gravity_Nm[dof] > threshold_Nm),
        is_slide=bool(model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE),
        torque_constant_is_known=table.torque_constant_is_known,
    )


def _gains(table: JointTable, drive: mjcf.Drive, where: str, needs_gains: bool) -> tuple[float, float]:
    """Return kp and kd of a joint; NaN for one that is unknown and not needed."""
    kd = drive.kd_Nms_rad if table.kd_Nms_rad is None else table.kd_Nms_rad
    if table.mode == "voltage":
        if drive.torque_Nm_V is None:
            raise RobotError(
                f"{where}.mode: is voltage, and the model has no <dcmotor> at this joint; add one"
            )
        return drive.torque_Nm_V, drive.back_emf_Nms_rad if table.kd_Nms_rad is None else kd
    kp = drive.kp_Nm_rad if table.kp_Nm_rad is None else table.kp_Nm_rad
    gains = {"position": ("kp_Nm_rad", kp), "velocity": ("kd_Nms_rad", kd)}
    key, gain = gains.get(table.mode, ("", math.inf))
    if gain != 0.0:
        return kp, kd
    if needs_gains:
        raise RobotError(f"{where}.{key}: is 0 or missing, and the model has no gain; give one above 0")
    return (math.nan, kd) if table.mode == "position" else (kp, math.nan)


def _check_left_out(file: RobotFile, model: mujoco.MjModel, path: Path) -> None:
    """Refuse to leave out a joint that is not there, that has a table, or that is tied to one that stays."""
    names = [mjcf.joint_name(model, k) for k in range(model.njnt)]
    for name in file.left_out:
        if name not in names:
            raise RobotError(f"{path}: left_out: {mjcf.describe_unknown('joint', name, names)}")
        table = next((key for key, one in file.joints.items() if name == (one.joint or key)), None)
        if table is not None:
            raise RobotError(f"{path}: left_out: {name!r} has the table joints.{table}; remove one of them")
        tied = mjcf.tied_joints(model, names.index(name))
        if not set(tied) <= set(file.left_out):
            raise RobotError(
                f"{path}: left_out: an equality or a tendon ties {name!r} to others; "
                f"leave out {_listed(tied)}"
            )


def _check_base(model: mujoco.MjModel, path: Path) -> None:
    """Refuse a free joint: commands do not hold it."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if free.size:
        name = mjcf.joint_name(model, int(free[0]))
        holds = f'left_out = ["{name}"] holds it where the model has it' if name else "give it a name"
        raise RobotError(
            f"{path}: model: the joint of {name or 'a body'!r} is free, so that it falls; {holds}"
        )


def _check_joints(numbers: dict[str, int], model: mujoco.MjModel, path: Path) -> None:
    """Refuse a joint that is named twice, and a driven joint of the model that is not named."""
    used = [*numbers.values()]
    for k, name in enumerate(numbers):
        if numbers[name] in used[:k]:
            raise RobotError(f"{path}: joints.{name}.joint: is the joint of another table; name its own")
    for k in range(model.nactuator):
        joint = int(model.actuator_trnid[k, 0])
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and joint not in used:
            tied = _listed(mjcf.tied_joints(model, joint))
            raise RobotError(
                f"{path}: joints: the model drives {model.joint(joint).name!r}, which has no table; "
                f"add one, or write left_out = {tied}"
            )


def _listed(names: list[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"
