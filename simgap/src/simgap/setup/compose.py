"""Composition of a robot file from a model and logs: each guess with its reason, each doubt as a question."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from simgap.checks.audit import audit
from simgap.checks.rates import pause_windows_s
from simgap.checks.records import REFUSED, Remark, RemarkKind
from simgap.common.errors import RobotError
from simgap.common.progress import GUESS, Progress
from simgap.common.toml import parse_record
from simgap.files.columns import ColumnInfo, LongGap
from simgap.files.log_file import LogFile, open_whole
from simgap.files.motion_rows import SLOWEST
from simgap.files.robot_file import RobotFile
from simgap.loading import load
from simgap.logs import Logs
from simgap.mjcf import joint_name, joints_of_tendon, read_model_text, tied_joints
from simgap.robot import Robot, build_robot
from simgap.setup import gains
from simgap.setup.column_names import Match, match_columns, split_words
from simgap.setup.draft import Draft
from simgap.setup.times import Times, find_times
from simgap.setup.units import settle_speeds, write_columns

JITTER: Final = 0.005
"""Share by which the rate of a log may be off that of its loop: a round number within it is taken."""
LONGEST_STEP_s: Final = 0.005
"""Longest time step that is taken from a model: servos are stiff."""
NEAR: Final = 0.5
"""Scatter of the distance to a command over that of the command, below which a position follows it."""
LEROBOT: Final = ("action", "observation.state")
"""Columns of a LeRobot data set with the commands and the positions."""
GRIPPERS: Final = frozenset(("gripper", "jaw", "finger", "hand"))
TOOL_WORDS: Final = frozenset(
    ("gripper", "gripperframe", "tool", "tcp", "flange", "attachment", "ee", "pinch")
)


def draft_robot_file(
    model_path: Path, log_paths: Sequence[Path], path: Path, unit: str, progress: Progress
) -> Draft:
    """Draft the robot file that is to be written at a path.

    Args:
        unit: Unit of hinges whose columns do not say it; empty: it is guessed.

    Raises:
        RobotError: model or logs cannot be read, no column fits a joint, or the draft does not read the logs.
    """
    progress(0.0, GUESS, "reading the model")
    model = _compile(model_path)
    names = [model.joint(k).name for k in _moving(model)]
    progress(0.25, GUESS, "reading the logs")
    opened = [open_whole(one) for one in log_paths]
    columns = _common_columns(opened)
    times = find_times(opened[0], columns)
    others = (times.column, *times.motions, times.repeat)
    matches = match_columns(columns, names, _driven(model), others, _named_records(opened, columns, names))
    if not matches.by_joint:
        there = ", ".join(one.name for one in columns)
        raise RobotError(
            f"{log_paths[0]}: no column is a position of {', '.join(names)} by its name; it has {there}"
            + "".join(f"; {question}" for question in matches.questions)
        )
    by_joint = _name_commands(matches.by_joint, opened, model)
    draft = Draft()
    _write_head(draft, model_path, path, model, times)
    for question in matches.questions:
        draft.ask(question, "joints")
    if matches.still:
        draft.reasons["joints",] = f"left away, as they never change: {', '.join(matches.still)}"
    by_joint = _without_followers(draft, model, by_joint)
    tables = {joint: _head_of_joint(draft, model, joint, own) for joint, own in by_joint.items()}
    draft.content["joints"] = tables
    of_lerobot = all(any(one.name.startswith(f"{name}[") for one in columns) for name in LEROBOT)
    grippers = [one for one in by_joint if of_lerobot and set(split_words(one)) & GRIPPERS]
    write_columns(draft, opened, model, by_joint, unit, grippers)
    _leave_out(draft, model)
    unknown = gains.set_unknown_gains(draft, model, path)
    progress(0.5, GUESS, "comparing signals")
    robot, logs = _cut_at_pauses(draft, path, log_paths)
    settle_speeds(draft, robot, logs, by_joint)
    if unknown is not None:
        sags = gains.sag_gains(robot, logs)
        gains.ask_about_gains(draft, robot, gains.loop_gains(robot, logs.motions) | sags)
        for joint in unknown:
            gains.estimate_gain(draft, robot, logs, joint, sags.get(joint))
    gains.ask_about_torques(draft, robot, logs)
    progress(0.75, GUESS, "checking the logs")
    robot, logs = _read(draft, path, log_paths)
    for one in audit(robot, logs).remarks:
        if "runs against" in one.text:
            _turn(draft, robot, one)
        elif one.kind in (*REFUSED, RemarkKind.PAUSE):
            draft.ask(f"the check says: {one.kind}: {one.text}", "joints", *filter(None, [one.joint]))
    parse_record(RobotFile, draft.content, path)
    return draft


def _turn(draft: Draft, robot: Robot, remark: Remark) -> None:
    """Turn a position round that runs against its command, with its velocity, or a velocity alone."""
    table, joint = draft.joint(remark.joint), remark.joint
    key = "velocity" if remark.text.startswith("the velocity") else "position"
    turned = ("velocity",) if key == "velocity" else ("position", "velocity", "secondary")
    for one in (table[name] for name in turned if name in table):
        if "at_1_rad" in one:
            low, high = robot.range_rad(joint)
            start, end = one["at_0_rad"], one["at_1_rad"]
            is_middle = abs(start - (low + high) / 2.0) < 1e-3  # of -100..100, where 0 stays
            one["at_0_rad"], one["at_1_rad"] = (start, 2.0 * start - end) if is_middle else (end, start)
        else:
            one["factor"] = -one.get("factor", 1.0)
    said = remark.text.partition(":")[0]
    draft.ask(f"{said}, so it is turned here; or is the other one to be turned?", "joints", joint, key)


def _named_records(
    logs: Sequence[LogFile], columns: Sequence[ColumnInfo], joints: Sequence[str]
) -> dict[str, str]:
    """Return the joints that texts such as `joints[0].name` name, by the beginning `joints[0].`."""
    found = {}
    for one in columns:
        start, dot, field = one.name.rpartition(".")
        if one.kind == "text" and dot and field == "name":
            there = {str(text) for log in logs for text in np.unique(log.texts(one.name))}
            if len(there) == 1 and there <= set(joints):
                found[start + dot] = there.pop()
    return found


def _compile(path: Path) -> mujoco.MjModel:
    try:
        model = mujoco.MjModel.from_xml_string(read_model_text(path))
    except ValueError as error:
        said = f"{path}: MuJoCo cannot compile it: {' '.join(str(error).split())}"
        if "opening file" in said:
            said += (
                ". Put the files that it names beside it; or, if each body has an inertial, remove its "
                "assets and its geoms of meshes"
            )
        raise RobotError(said) from error
    if not _moving(model):
        raise RobotError(
            f"{path}: has no hinge and no slide with a name; give each joint of the robot a name"
        )
    return model


def _moving(model: mujoco.MjModel) -> list[int]:
    """Return the hinges and slides that have names."""
    kinds = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
    return [int(k) for k in np.flatnonzero(np.isin(model.jnt_type, kinds)) if model.joint(int(k)).name]


def _driven(model: mujoco.MjModel) -> list[str]:
    """Return the joints that an actuator drives, in the order of the actuators."""
    by_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return [model.joint(int(k)).name for k in dict.fromkeys(model.actuator_trnid[by_joint, 0].tolist())]


def _common_columns(logs: Sequence[LogFile]) -> list[ColumnInfo]:
    """Return the columns of the first log that all others have too."""
    columns = logs[0].describe()
    common = [*columns]
    for log in logs[1:]:
        there = [one.name for one in log.describe()]
        common = [one for one in common if one.name in there]
        if 2 * len(common) < len(columns):
            raise RobotError(
                f"logs: {logs[0].path} has {', '.join(one.name for one in columns)}, and {log.path} has "
                f"{', '.join(there)}; give logs with the same columns"
            )
    return common


def _write_head(draft: Draft, model_path: Path, path: Path, model: mujoco.MjModel, times: Times) -> None:
    """Write the keys before those of the joints."""
    rate_Hz = float(f"{times.rate_Hz:.2g}")
    if abs(rate_Hz - times.rate_Hz) > JITTER * times.rate_Hz:
        rate_Hz = float(f"{times.rate_Hz:.3g}")
    n_steps = math.ceil(1.0 / rate_Hz / min(float(model.opt.timestep), LONGEST_STEP_s) - 1e-6)
    own = model.names[: model.names.index(b"\0")].decode()
    name = model_path.stem if own in ("", "MuJoCo Model") else own  # which MuJoCo gives
    draft.content = {
        "name": name,
        "model": Path(os.path.relpath(model_path, path.parent)).as_posix(),
        "time_step_s": float(f"{1.0 / rate_Hz / n_steps:.9g}"),
        "control_rate_Hz": rate_Hz,
    }
    draft.reasons["time_step_s",] = f"the control period in {n_steps} steps, by the time step of the model"
    draft.reasons["control_rate_Hz",] = "the rate of the log"
    most_Hz = f"{rate_Hz / SLOWEST:g}"
    draft.ask(
        "are torques computed more often than logged, as by a motor's own controller or by MuJoCo's "
        f"actuators (at each time step)? Write that rate, below {most_Hz}",
        "control_rate_Hz",
    )
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
        if times.repeat:
            draft.content["motion"]["repeat_column"] = times.repeat
        else:
            question = "which motions repeat one another? Write repeats or repeat_column; they show the noise"
            draft.ask(question, "motion")
        draft.reasons["motion",] = times.reasons["motion"]


def _without_followers(
    draft: Draft, model: mujoco.MjModel, by_joint: Mapping[str, Mapping[str, Match]]
) -> dict[str, Mapping[str, Match]]:
    """Take away joints that have no command and follow a driven one in the model, as fingers do."""
    leaders = [joint for joint, own in by_joint.items() if "command" in own]
    leaders += [joint for joint in _driven(model) if joint not in by_joint]
    kept = dict(by_joint)
    for joint in by_joint.keys() - set(leaders):
        tied = [one for one in leaders if one in tied_joints(model, model.joint(joint).id)]
        if tied:
            del kept[joint]
            draft.reasons["joints", tied[0]] = f"{joint} has no command and follows it: it needs no table"
    return kept


def _head_of_joint(
    draft: Draft, model: mujoco.MjModel, joint: str, own: Mapping[str, Match]
) -> dict[str, Any]:
    """Return the first keys of a joint: what is commanded, and what its mode needs."""
    command, key = own.get("command"), ("joints", joint)
    mode = "position" if command is None else command.name.signal
    table: dict[str, Any] = {"mode": mode}
    voltage = own.get("voltage")
    if command is None and voltage is not None and (voltage.info.lowest or 0.0) < 0.0:
        draft.ask(f"{voltage.info.name} goes below 0, which no supply does: is it the command?", *key, "mode")
    if command is None:
        draft.ask("no command was found; is the joint told a position?", *key, "mode")
    else:
        draft.reasons[*key, "mode"] = f"the command {command.info.name} is a {mode}"
    at_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (
        model.actuator_trnid[:, 0] == model.joint(joint).id
    )
    drives = sorted(np.flatnonzero(at_joint), key=lambda k: model.actuator_biasprm[k, 1])  # stiffest first
    names = [model.actuator(int(k)).name for k in drives]
    if len(names) > 1 and all(names):
        table["actuator"] = names[0]
        draft.ask(f"which actuator has the command: {', '.join(names)}?", *key, "actuator")
    if mode == "current" and not np.any(model.actuator_dyntype[drives] == mujoco.mjtDyn.mjDYN_DCMOTOR):
        table["torque_constant_Nm_A"] = 1.0
        draft.ask("what torque at the joint is 1 A? 1 stands for it", *key, "torque_constant_Nm_A")
    return table


def _name_commands(
    by_joint: Mapping[str, Mapping[str, Match]], logs: Sequence[LogFile], model: mujoco.MjModel
) -> dict[str, Mapping[str, Match]]:
    """Return the columns with the signal of commands that are only called so, such as `ctrl`.

    It is a position, unless the model has a motor at the joint and the position does not follow.
    """
    found = {joint: dict(own) for joint, own in by_joint.items()}
    motors = {
        model.joint(int(model.actuator_trnid[k, 0])).name
        for k in range(model.nactuator)
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT
        and model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE
    }
    for joint, own in found.items():
        command = own.get("command")
        if command is None or command.name.signal:
            continue
        names = command.info.name, own["position"].info.name
        is_torque = joint in motors and not any(_follows(one, *names) for one in logs)
        name = replace(command.name, signal="torque" if is_torque else "position")
        own["command"] = replace(command, name=name)
    return {**found}


def _follows(log: LogFile, command: str, position: str) -> bool:
    """Return whether a position stays near a command: within half of its scatter."""
    sent, found = log.numbers(command).value, log.numbers(position).value
    if sent.size != found.size:
        return False
    use = np.isfinite(sent) & np.isfinite(found)
    return bool(use.any() and np.std(sent[use] - found[use]) < NEAR * np.std(sent[use]))


def _leave_out(draft: Draft, model: mujoco.MjModel) -> None:
    """Leave out joints that commands drive, or that are free or balls, and that no column shows."""
    named = draft.content["joints"].keys()
    free = np.flatnonzero(np.isin(model.jnt_type, [mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL]))
    driven = [model.joint(name).id for name in _driven(model)]
    for k in np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON):
        pulled = joints_of_tendon(model, int(model.actuator_trnid[k, 0]))
        driven += pulled
        for one in named & {model.joint(one).name for one in pulled}:
            draft.ask(
                f"the model drives it by {model.actuator(int(k)).name} through a tendon, which is not "
                "simulated: what drives it alone?",
                *("joints", one),
            )
    groups = [[joint_name(model, int(k))] for k in free] + [tied_joints(model, k) for k in driven]
    out = dict.fromkeys(name for group in groups if not named & set(group) for name in group)
    if out:
        head = {key: draft.content.pop(key) for key in ("name", "model")}
        draft.content = {**head, "left_out": [*out], **draft.content}
        draft.reasons["left_out",] = "no column shows them: they stand where the model has them"


def _cut_at_pauses(draft: Draft, path: Path, logs: Sequence[Path]) -> tuple[Robot, Logs]:
    """Read the logs; a log of one motion is cut where nothing is logged for a while."""
    try:
        robot, read = _read(draft, path, logs)
        is_whole = len(read.motions) == 1 and "motion" not in draft.content
        windows_s = pause_windows_s(read.motions[0]) if is_whole else {}
    except LongGap as error:
        if not error.windows_s or len(logs) > 1:
            raise
        windows_s = error.windows_s
    if not windows_s:
        return robot, read
    draft.content["motion"] = {"windows_s": windows_s}
    draft.reasons["motion",] = "no signal is logged between these times"
    return _read(draft, path, logs)


def _read(draft: Draft, path: Path, logs: Sequence[Path]) -> tuple[Robot, Logs]:
    robot = build_robot(parse_record(RobotFile, draft.content, path), path)
    return robot, load(robot, logs)
