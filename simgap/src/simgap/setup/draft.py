"""Draft of a robot file from a model and logs: each guess with its reason, each doubt as a question."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from simgap.checks.audit import audit
from simgap.checks.records import REFUSED, RemarkKind
from simgap.checks.static import find_rest, fit_static_law
from simgap.checks.units import speed_ratio
from simgap.common.errors import RobotError
from simgap.common.progress import Progress
from simgap.common.toml import parse_record
from simgap.drives import read_drive
from simgap.files.columns import ColumnInfo, LogFile
from simgap.files.log_file import open_log, open_whole
from simgap.files.robot_file import CsvTable, RobotFile
from simgap.loading import load
from simgap.logs import Logs
from simgap.mjcf import joint_name, read_model_text, tied_joints
from simgap.robot import Robot, gravity_amplitudes
from simgap.setup.column_names import split_words
from simgap.setup.matching import Match, match_columns
from simgap.setup.times import Times, find_times
from simgap.setup.units import (
    UnitGuess,
    describe_values,
    fits_speed,
    guess_position_units,
    guess_speed_unit,
    si_unit,
)

BANDWIDTH_Hz: Final = 5.0
"""Natural frequency of a position loop of which nothing is known: arms have 2 to 10 Hz."""
SHOWS_SAG: Final = 0.5
"""Least correlation of the error at rest with the gravity torque for which it gives a gain."""
MOTOR_SIDE: Final = 10.0
"""Gravity torque of the model over a logged torque from which it may be that of a motor before its gear."""
JITTER: Final = 0.005
"""Share by which the rate of a log may be off that of its loop: a round number within it is taken."""
LONGEST_STEP_s: Final = 0.005
"""Longest time step that is taken from a model: servos are stiff."""
TOOL_WORDS: Final = frozenset(("gripper", "gripperframe", "tool", "tcp", "flange", "attachment", "ee", "pinch"))
SIGNALS: Final = ("command", "position", "secondary", "velocity", "torque", "current", "voltage")
KEYS: Final = (*SIGNALS, "temperature", "enabled")
"""Keys of a joint with a column, in the order of the file."""


@dataclass(slots=True)
class Draft:
    """Content of a robot file, and what is said of its keys."""

    content: dict[str, Any] = field(default_factory=dict)
    reasons: dict[tuple[str, ...], str] = field(default_factory=dict)
    questions: dict[tuple[str, ...], list[str]] = field(default_factory=dict)

    def ask(self, question: str, *key: str) -> None:
        """Ask a question at a key, once."""
        own = self.questions.setdefault(key, [])
        if question and question not in own:
            own.append(question)

    def joint(self, name: str) -> dict[str, Any]:
        """Return the table of a joint."""
        return self.content["joints"][name]  # type: ignore[no-any-return]


def draft_robot_file(model_path: Path, log_paths: Sequence[Path], path: Path, progress: Progress) -> Draft:
    """Draft the robot file that is to be written at a path.

    Raises:
        RobotError: model or logs cannot be read, no column fits a joint, or the draft does not read the logs.
    """
    progress(0, 4, "reading the model")
    model = _compile(model_path)
    names = [model.joint(k).name for k in _moving(model)]
    progress(1, 4, "reading the logs")
    opened = [open_whole(one) for one in log_paths]
    columns = _common_columns(opened)
    times = find_times(opened[0], columns)
    matches = match_columns(columns, names, _driven(model), (times.column, *times.motions))
    if not matches.by_joint:
        there = ", ".join(one.name for one in columns if one.kind == "number")
        raise RobotError(
            f"{log_paths[0]}: no column is a position of {', '.join(names)} by its name; it has {there}"
        )
    draft = Draft()
    _write_head(draft, model_path, path, model, times)
    for question in matches.questions:
        draft.ask(question, "joints")
    draft.content["joints"] = {
        joint: _mode_of(draft, joint, own) for joint, own in matches.by_joint.items()
    }
    _write_columns(draft, log_paths, model, matches.by_joint)
    _leave_out(draft, model)
    unknown = _set_unknown_gains(draft, model, path)
    progress(2, 4, "comparing signals")
    robot, logs = _read(draft, path, log_paths)
    _settle_speeds(draft, robot, logs, matches.by_joint)
    for joint in unknown:
        _estimate_gain(draft, robot, logs, joint)
    _ask_about_torques(draft, robot, logs)
    progress(3, 4, "checking the logs")
    robot, logs = _read(draft, path, log_paths)
    for one in audit(robot, logs).remarks:
        if one.kind in (*REFUSED, RemarkKind.PAUSE):
            draft.ask(f"the check says: {one.kind}: {one.text}", "joints", *filter(None, [one.joint]))
    return draft


def _compile(path: Path) -> mujoco.MjModel:
    try:
        model = mujoco.MjModel.from_xml_string(read_model_text(path))
    except ValueError as error:
        raise RobotError(f"{path}: MuJoCo cannot compile it: {' '.join(str(error).split())}") from error
    if not _moving(model):
        raise RobotError(f"{path}: has no hinge and no slide with a name; give each joint of the robot a name")
    return model


def _moving(model: mujoco.MjModel) -> list[int]:
    """Return the hinges and slides that have names."""
    kinds = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
    return [int(k) for k in np.flatnonzero(np.isin(model.jnt_type, kinds)) if model.joint(int(k)).name]


def _driven(model: mujoco.MjModel) -> list[str]:
    """Return the joints that an actuator drives, in the order of the actuators."""
    by_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return [model.joint(int(k)).name for k in dict.fromkeys(model.actuator_trnid[by_joint, 0].tolist())]


def _name_of(model: mujoco.MjModel) -> str:
    """Return the name of a model; empty if it has that which MuJoCo gives."""
    name = model.names[: model.names.index(b"\0")].decode()
    return "" if name == "MuJoCo Model" else name


def _common_columns(logs: Sequence[LogFile]) -> list[ColumnInfo]:
    """Return the columns of the first log that all others have too."""
    names = [{one.name for one in log.describe()} for log in logs]
    common = [one for one in logs[0].describe() if all(one.name in own for own in names)]
    if not common:
        raise RobotError(f"logs: {logs[1].path} has no column of {logs[0].path}; give logs of one kind")
    return common


def _write_head(draft: Draft, model_path: Path, path: Path, model: mujoco.MjModel, times: Times) -> None:
    """Write the keys before those of the joints."""
    rate_Hz = float(f"{times.rate_Hz:.2g}")
    if abs(rate_Hz - times.rate_Hz) > JITTER * times.rate_Hz:
        rate_Hz = float(f"{times.rate_Hz:.3g}")
    n_steps = math.ceil(1.0 / rate_Hz / min(float(model.opt.timestep), LONGEST_STEP_s) - 1e-6)
    name = _name_of(model) or model_path.stem
    draft.content = {
        "name": name,
        "model": os.path.relpath(model_path, path.parent),
        "time_step_s": float(f"{1.0 / rate_Hz / n_steps:.9g}"),
        "control_rate_Hz": rate_Hz,
    }
    draft.reasons["time_step_s",] = f"the control period in {n_steps} steps, by the time step of the model"
    draft.reasons["control_rate_Hz",] = "the rate of the log"
    draft.ask("does the loop that computes torques run faster than the log? Write its rate", "control_rate_Hz")
    sites = [model.site(k).name for k in range(model.nsite)]
    tools = [one for one in sites if set(split_words(one)) & TOOL_WORDS]
    if tools:
        draft.content["tool_site"] = tools[-1]
        draft.reasons["tool_site",] = "by its name; where it stops at one height, the tool touches a table"
    if times.column:
        draft.content["time"] = {"column": times.column, "unit": times.unit}
        draft.reasons["time",] = times.reasons["time"]
    if times.motions:
        draft.content["motion"] = {"columns": [*times.motions]}
        draft.reasons["motion",] = times.reasons["motion"]


def _mode_of(draft: Draft, joint: str, own: Mapping[str, Match]) -> dict[str, Any]:
    """Return the first key of a joint: what is commanded."""
    command = own.get("command")
    if command is None:
        draft.ask("no command was found; is the joint told a position?", "joints", joint, "mode")
        return {"mode": "position"}
    draft.reasons["joints", joint, "mode"] = f"the command {command.info.name} is a {command.name.signal}"
    return {"mode": command.name.signal}


def _write_columns(
    draft: Draft,
    paths: Sequence[Path],
    model: mujoco.MjModel,
    by_joint: Mapping[str, Mapping[str, Match]],
) -> None:
    """Write the columns of all joints with their units."""
    slides = {joint: model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE for joint in by_joint}
    values = {}
    names = [own["position"].info.name for own in by_joint.values()]
    logs = [open_log(path, names, (), CsvTable()) for path in paths]
    for (joint, own), name in zip(by_joint.items(), names, strict=True):
        value = np.concatenate([log.numbers(name).value for log in logs])
        known = model.joint(joint)
        limits = known.range if model.jnt_limited[known.id] else (-math.inf, math.inf)
        values[joint] = describe_values(value, (float(limits[0]), float(limits[1])), slides[joint])
    positions = guess_position_units(values)
    for joint, own in by_joint.items():
        table = draft.joint(joint)
        gain = own.get("gain")
        if gain is not None and gain.info.lowest != gain.info.highest and table["mode"] == "position":
            table |= {"gain_column": gain.info.name, "kp_Nm_rad": 1.0}
            draft.reasons["joints", joint, "gain_column"] = "by its name"
        for key in KEYS:
            is_constant = key in own and own[key].info.lowest == own[key].info.highest
            if key in own and not (key == "secondary" and is_constant):
                signal = table["mode"] if key == "command" else "position" if key == "secondary" else key
                guess = _unit_of(own[key], signal, positions[joint], own["position"], slides[joint])
                table[key] = {"column": own[key].info.name, "unit": guess.unit, **guess.keys}
                draft.reasons["joints", joint, key] = f"{own[key].reason}; {guess.unit}: {guess.reason}"
                if key == "position":
                    draft.ask(guess.question, "joints", joint, key)


def _unit_of(one: Match, signal: str, position: UnitGuess, measured: Match, is_slide: bool) -> UnitGuess:
    """Return the unit of a column: of its name, of the file, or a guess."""
    if one.name.unit and one.name.unit != "count":
        return UnitGuess(one.name.unit, "it stands in the name")
    if one.info.unit:
        return UnitGuess(one.info.unit, "the file says so")
    if signal == "position":
        of_position = measured.name.unit or measured.info.unit
        if of_position and of_position != "count":
            return UnitGuess(of_position, "as the position")
        return position
    return si_unit(signal, is_slide)


def _leave_out(draft: Draft, model: mujoco.MjModel) -> None:
    """Leave out joints that commands drive, or that are free, and that no column shows."""
    named = draft.content["joints"]
    free = [k for k in range(model.njnt) if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE]
    silent = [model.joint(name).id for name in _driven(model) if name not in named]
    names = dict.fromkeys(
        [joint_name(model, k) for k in free] + [name for k in silent for name in tied_joints(model, k)]
    )
    out = [name for name in names if name not in named]
    if out:
        draft.content = {"left_out": out, **draft.content}
        draft.content = {key: draft.content[key] for key in ("name", "model", "left_out")} | draft.content
        draft.reasons["left_out",] = "no column shows them: they stand where the model has them"


def _set_unknown_gains(draft: Draft, model: mujoco.MjModel, path: Path) -> list[str]:
    """Set a gain of 1 where positions are compared and the model has none; return these joints."""
    file = parse_record(RobotFile, draft.content, path)
    if all(table.command is None or table.torque is not None for table in file.joints.values()):
        return []
    unknown = []
    for joint, table in file.joints.items():
        drive = read_drive(table, model, model.joint(joint).id, f"{path}: joints.{joint}")
        own = draft.joint(joint)
        if table.mode == "position" and (drive.kp_Nm_rad == 0.0 or table.gain_column):
            own["kp_Nm_rad"] = 1.0
            unknown.append(joint)
        elif table.mode == "velocity" and drive.kd_Nms_rad == 0.0:
            own["kd_Nms_rad"] = _inertia(model, joint) * 2.0 * math.pi * BANDWIDTH_Hz
            draft.ask(
                "what is the gain of the velocity loop? This is a guess, for 5 Hz", "joints", joint, "kd_Nms_rad"
            )
        elif table.mode == "position":
            draft.ask(
                f"is {drive.kp_Nm_rad:.4g} N m/rad, the gain of the model, that of the robot? "
                "kp_Nm_rad says another",
                *("joints", joint, "mode"),
            )
    return unknown


def _inertia(model: mujoco.MjModel, joint: str) -> float:
    """Return the inertia of the model about a joint at its zero, with the rotor [kg m^2]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dof = int(model.joint(joint).dofadr[0])
    return float(full[dof, dof])


def _read(draft: Draft, path: Path, logs: Sequence[Path]) -> tuple[Robot, Logs]:
    robot = Robot.from_file(parse_record(RobotFile, draft.content, path), path)
    return robot, load(robot, logs)


def _settle_speeds(
    draft: Draft, robot: Robot, logs: Logs, by_joint: Mapping[str, Mapping[str, Match]]
) -> None:
    """Set the unit of velocities by the change of the positions, or leave them away where none fits."""
    ratios = {
        joint: speed_ratio(logs.motions, joint)
        for joint, own in by_joint.items()
        if "velocity" in own and not (own["velocity"].name.unit or own["velocity"].info.unit)
    }
    for is_slide in (False, True):
        own = {joint: one for joint, one in ratios.items() if robot.joint(joint).is_slide == is_slide}
        unit = guess_speed_unit(list(own.values()), is_slide)
        for joint, ratio in own.items():
            match, table = by_joint[joint]["velocity"], draft.joint(joint)
            if math.isnan(ratio) or fits_speed(ratio, unit):
                table["velocity"]["unit"] = unit
                draft.reasons["joints", joint, "velocity"] = f"{match.reason}; {unit} fits the change of positions"
                continue
            del table["velocity"]
            draft.ask(
                f"{match.info.name} is {ratio:.3g} times the change of the position, in {unit} as those of other "
                f"joints: is the position in another unit{_ask_fraction(robot, logs, joint)}? Until then the velocity "
                "is left away",
                *("joints", joint, "position"),
            )


def _ask_fraction(robot: Robot, logs: Logs, joint: str) -> str:
    """Return the keys of a position that is a share of the range; empty if it cannot be one."""
    values = np.concatenate([motion.joints[joint].position.value for motion in logs.motions])
    low, high = robot.range_rad(joint)
    if values.min() < 0.0 or values.max() > 1.0 or not math.isfinite(high):
        return ""
    return f', such as unit = "fraction", at_0_rad = {low:.6g}, at_1_rad = {high:.6g}'


def _estimate_gain(draft: Draft, robot: Robot, logs: Logs, joint: str) -> None:
    """Estimate the gain of a position loop by its sag under gravity; else guess it by the inertia."""
    rest = find_rest(robot, logs.motions)
    place = rest.joints.index(joint) if joint in rest.joints else -1
    none_held = np.zeros(rest.time_s.size, np.bool_)
    law = fit_static_law(robot, logs.motions, rest, place, none_held) if place >= 0 else None
    table, key = draft.joint(joint), ("joints", joint, "kp_Nm_rad")
    unit = "N/m" if robot.joint(joint).is_slide else "N m/rad"
    of_column = " for a gain of 1" if "gain_column" in table else ""
    shows = law is not None and law.weight[0] > 0.0 and _correlation(law.error, law.load_Nm) > SHOWS_SAG
    if law is not None and shows:
        table["kp_Nm_rad"] = float(f"{1.0 / law.weight[0]:.3g}")
        draft.reasons[key] = f"by how far the joint sags under gravity{of_column}"
        draft.ask(f"is this the gain of the servo in {unit}{of_column}, and what is its damping?", *key)
        return
    gains = [motion.gain.get(joint, 1.0) for motion in logs.motions]
    inertia, rate = _inertia(robot.model, joint), 2.0 * math.pi * BANDWIDTH_Hz
    table["kp_Nm_rad"] = float(f"{inertia * rate**2 / float(np.median(gains)):.3g}")
    draft.reasons[key] = f"a guess{of_column}: {BANDWIDTH_Hz:g} Hz with the inertia of the model"
    draft.ask(f"what is the gain of the servo in {unit}{of_column}, and what is its damping?", *key)
    if not of_column:
        table["kd_Nms_rad"] = float(f"{2.0 * inertia * rate:.3g}")
        draft.reasons["joints", joint, "kd_Nms_rad"] = "a guess: critical damping"


def _correlation(first: Any, second: Any) -> float:
    return float(np.corrcoef(first, second)[0, 1]) if min(np.ptp(first), np.ptp(second)) > 0.0 else 0.0


def _ask_about_torques(draft: Draft, robot: Robot, logs: Logs) -> None:
    """Ask for torque limits, torque constants, and whether a small torque is that of the motor."""
    gravity_Nm, shares = gravity_amplitudes(robot.model), {}
    for joint in robot.joints:
        table, unit = draft.joint(joint.name), joint.effort_unit
        by_torque = "torque" in table
        if not by_torque and joint.mode.value == "position" and math.isinf(joint.torque_limit_Nm):
            draft.ask(f"what is the largest torque of the motor? torque_limit_Nm = .. [{unit}]", "joints", joint.name)
        if "current" in table and not by_torque and math.isnan(joint.torque_constant_Nm_A):
            draft.ask(
                f"what {unit} at the joint is 1 A? torque_constant_Nm_A = .. lets torques be compared; "
                "torque_constant_is_known = false fits it",
                *("joints", joint.name, "current"),
            )
        if by_torque and joint.is_loaded_by_gravity:
            own = [motion.joints[joint.name].torque for motion in logs.motions]
            largest = max((float(np.abs(one.value).max()) for one in own if one is not None), default=0.0)
            if largest > 0.0 and gravity_Nm[joint.dof_index] > MOTOR_SIDE * largest:
                shares[joint.name] = float(gravity_Nm[joint.dof_index]) / largest
    if shares:
        draft.ask(
            f"gravity takes {min(shares.values()):.3g} to {max(shares.values()):.3g} times as much as the torques of "
            f"{', '.join(shares)}: are torques those of the motors, before their gears? Write gear_ratio = .. at each "
            'joint, and side = "motor" at its torque',
            "joints",
        )
