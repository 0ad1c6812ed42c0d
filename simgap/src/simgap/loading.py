"""Loading of logs: from files to signals in SI units at the joint, by motion, and their splits."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from simgap.common.errors import RobotError
from simgap.common.toml import Record, parse_record, read_toml
from simgap.files.columns import LogFile
from simgap.files.log_file import open_log
from simgap.files.motion_rows import MotionRows
from simgap.files.robot_file import RobotFile
from simgap.logs import JointLog, Logs, Motion, Signal
from simgap.robot import Robot
from simgap.units import Quantity


class SplitTable(Record):
    """One split: parts that are fitted, and parts that judge."""

    fit: list[str] = Field(default_factory=list)
    """Parts that are fitted; none: all that is not held out."""
    held_out: Annotated[list[str], Field(min_length=1)]
    """Parts that take no part in a fit."""


class SplitFile(Record):
    """Content of a split file."""

    default: str
    """Split that is taken if none is named."""
    parts: dict[str, Annotated[list[str], Field(min_length=1)]]
    """Part -> its motions, or the conditions or files whose motions it has."""
    splits: dict[str, SplitTable]
    """Name of a split -> what it fits and what it holds out."""

    @model_validator(mode="after")
    def _check(self) -> "SplitFile":
        if self.default not in self.splits:
            raise ValueError(f"default: there is no split {self.default!r}{_near(self.default, self.splits)}")
        for name, split in self.splits.items():
            for part in (*split.fit, *split.held_out):
                if part not in self.parts:
                    raise ValueError(f"splits.{name}: there is no part {part!r}{_near(part, self.parts)}")
        return self


@dataclass(frozen=True, slots=True)
class Member:
    """Names by which a split may refer to a motion."""

    motion: str
    condition: str
    file: str


def read_split(path: Path) -> SplitFile:
    """Read a split file.

    Raises:
        RobotError: it cannot be read, or a key or a value is wrong.
    """
    return parse_record(SplitFile, read_toml(path), path)


def choose_motions(
    file: SplitFile | None, members: Sequence[Member], split: str, held_out: Sequence[str]
) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of the motions that are fitted, and of those that judge.

    Args:
        file: Split file; None: there is none.
        split: Name of a split; empty: the default of the file.
        held_out: Motions, conditions or files in place of a split; empty: the split counts.

    Raises:
        RobotError: a name is unknown, a motion is both fitted and held out, or nothing is left to fit.
    """
    everything = frozenset(one.motion for one in members)
    if held_out:
        judged = _members(held_out, members, "held out")
        fitted = everything - judged
    elif file is None:
        if split:
            raise RobotError(f"split {split!r}: the robot file names no split file; add the key split to it")
        return everything, frozenset()
    else:
        name = split or file.default
        if name not in file.splits:
            raise RobotError(
                f"split {name!r}: the split file has none of this name{_near(name, file.splits)}"
            )
        table = file.splits[name]
        judged = _part_members(file, table.held_out, members)
        fitted = _part_members(file, table.fit, members) if table.fit else everything - judged
        both = sorted(fitted & judged)
        if both:
            raise RobotError(
                f"split {name!r}: motion {both[0]!r} is both fitted and held out; leave it in one part"
            )
    if not fitted:
        raise RobotError("split: all motions are held out, so that nothing is fitted; hold out fewer")
    return fitted, judged


def _part_members(file: SplitFile, parts: Sequence[str], members: Sequence[Member]) -> frozenset[str]:
    return frozenset().union(*(_members(file.parts[part], members, f"part {part}") for part in parts))


def _members(names: Sequence[str], members: Sequence[Member], where: str) -> frozenset[str]:
    """Return the motions with these names, of these conditions or in these files."""
    found: set[str] = set()
    for name in names:
        chosen = {one.motion for one in members if name and name in _names(one)}
        if not chosen:
            there = dict.fromkeys(text for one in members for text in _names(one))
            raise RobotError(
                f"{where}: {name!r} is no motion, condition or file of these logs{_near(name, there)}"
            )
        found |= chosen
    return frozenset(found)


def _names(one: Member) -> tuple[str, str, str]:
    return one.motion, one.condition, one.file


def _near(name: str, there: Iterable[str]) -> str:
    listed = [one for one in there if one]
    near = get_close_matches(name, listed, 1)
    shown = ", ".join([*listed[:6], *([".."] if len(listed) > 6 else [])])
    return f"; did you mean {near[0]!r}?" if near else f"; there are {shown or 'none'}"


def load(
    robot: Robot | str | Path,
    paths: str | Path | Sequence[str | Path],
    *,
    split: str = "",
    held_out: Sequence[str] = (),
) -> Logs:
    """Load logs by the columns that a robot file names.

    Args:
        robot: Robot that was read from a file, or the path of its file.
        paths: Log files.
        split: Name of a split of the split file; empty: its default.
        held_out: Motions, conditions or files to hold out, in place of a split.

    Returns:
        Motions in the order of the files; each signal has its own times, from the start of its motion. A
        current with a torque constant is a torque too, where none is logged.

    Raises:
        RobotError: a file, a column, a value, a time or a name of the split is wrong.
    """
    robot = robot if isinstance(robot, Robot) else Robot.from_toml(robot)
    if robot.file is None:
        raise RobotError(f"robot {robot.name}: was not read from a robot file, which names the columns")
    motions: list[Motion] = []
    members: list[Member] = []
    losses: list[str] = []
    for path in [Path(paths)] if isinstance(paths, str | Path) else map(Path, paths):
        loaded, lost = _load_file(robot.file, path)
        losses += lost
        for motion in (take_currents_as_torques(robot, one) for one in loaded):
            other = next((one for one in members if one.motion == motion.name), None)
            if other is not None:
                raise RobotError(
                    f"{path}: motion {motion.name!r} is in {other.file} too; give each motion its own name"
                )
            motions.append(motion)
            members.append(Member(motion.name, motion.condition, path.stem))
    if not motions:
        raise RobotError("logs: none is given; name at least one log file")
    file = read_split(robot.folder / robot.file.split) if robot.file.split else None
    fitted, judged = choose_motions(file, members, split, held_out)
    idle = [one.name for one in motions if one.name not in fitted | judged]
    if file is not None and idle:
        losses.append(_idle_sentence(split or file.default, idle))
    return Logs(tuple(one for one in motions if one.name in fitted | judged), judged, tuple(losses))


def _idle_sentence(split: str, names: Sequence[str]) -> str:
    """Return a sentence about motions that a split does not name."""
    shown = ", ".join([*names[:3], *([f"and {len(names) - 3} more"] if len(names) > 3 else [])])
    counted, them = ("1 motion is", "it") if len(names) == 1 else (f"{len(names)} motions are", "them")
    return f"{counted} left out, because no part of the split {split!r} has {them}: {shown}"


def take_currents_as_torques(robot: Robot, motion: Motion) -> Motion:
    """Return a motion in which a current stands for a torque that is not logged, by the torque constant."""
    joints = dict(motion.joints)
    for joint in robot.joints:
        log = joints.get(joint.name)
        if log is None or log.torque is not None or log.current is None:
            continue
        if math.isfinite(joint.torque_constant_Nm_A):
            torque = Signal(log.current.time_s, joint.torque_constant_Nm_A * log.current.value)
            joints[joint.name] = replace(log, torque=torque)
    return replace(motion, joints=joints)


def _load_file(file: RobotFile, path: Path) -> tuple[list[Motion], list[str]]:
    """Load the motions of one file, with sentences about what it lacks."""
    signals = {
        (joint, key): (one, quantity, table)
        for joint, table in file.joints.items()
        for key, (one, quantity) in table.columns().items()
    }
    wanted = [name for one, _, _ in signals.values() for name in (one.column, one.time_column)]
    gains = {joint: table.gain_column for joint, table in file.joints.items() if table.gain_column}
    numbers = dict.fromkeys(filter(None, (file.time.column, *wanted, *gains.values())))
    labels = file.motion.repeat_column, file.motion.condition_column
    texts = dict.fromkeys(filter(None, (*file.motion.columns, *labels)))
    log = open_log(path, list(numbers), list(texts), file.csv)
    rows = MotionRows(log, file)
    losses = [f"{path}: {one}" for one in log.losses]
    found = {}
    for (joint, key), (one, quantity, table) in signals.items():
        named = one.model_copy(update={"column": _column_by_name(log, file, joint, key, one.column)})
        signal = rows.signals(key, named, quantity, table)
        if signal is None:
            losses.append(
                f"{path}: column {one.column!r} never is a number; {joint} has no {key} in this log"
            )
        else:
            found[joint, key] = signal
    parts = ({place: one[k] for place, one in found.items()} for k in range(len(rows.names)))
    unwrapped = [_unwrap_counters(file, part) for part in parts]
    gain = {joint: rows.gains(column) for joint, column in gains.items()}
    repeats, conditions = (rows.labels(column) for column in labels)
    motions = [
        Motion(
            name,
            _joint_logs(unwrapped[k][0]),
            {joint: gain[joint][k] if joint in gain else 1.0 for joint in file.joints},
            repeats[k],
            conditions[k],
            unwrapped[k][1],
        )
        for k, name in enumerate(rows.names)
    ]
    return motions, losses


def _column_by_name(log: LogFile, file: RobotFile, joint: str, key: str, column: str) -> str:
    """Return a column of messages by the name of its joint, where the robot file gives a place in a list.

    Messages may have their joints in any order. The place means the name that stood there first; if other
    publishers put names there that the robot file does not know, the joint's own.

    Raises:
        RobotError: the name is another joint of the robot file.
    """
    stood = log.names_at(column)
    if not stood:
        return column
    names = {name: {name, table.joint or name} for name, table in file.joints.items()}
    whole = column.rpartition("[")[0]
    other = next((name for name, own in names.items() if name != joint and stood[0] in own), None)
    own = next((one for one in stood if one in names[joint]), None)
    if other is not None and stood[0] not in names[joint]:
        right = own or joint
        raise RobotError(
            f"{log.path}: joints.{joint}.{key}: {column!r} is that of {stood[0]!r} in the messages; write "
            f"'{whole}[{right}]'"
        )
    return f"{whole}[{own or stood[0]}]"


def _unwrap_counters(
    file: RobotFile, signals: dict[tuple[str, str], Signal]
) -> tuple[dict[tuple[str, str], Signal], dict[str, int]]:
    """Add turns where a counter of one turn begins anew: a change of more than half a turn between two rows.

    Returns:
        The signals, and how often counters of each joint began anew.
    """
    found, count = dict(signals), dict[str, int]()
    for (joint, key), signal in signals.items():
        column, quantity = file.joints[joint].columns()[key]
        turn_rad = 2.0 * math.pi * abs(column.factor)
        turn_rad /= file.joints[joint].gear_ratio if column.side == "motor" else 1.0
        is_angle = column.unit == "count" and quantity is Quantity.ANGLE
        if is_angle and np.ptp(signal.value) < turn_rad:  # a counter of many turns exceeds one
            value = np.unwrap(signal.value, period=turn_rad)
            wraps = int(np.sum(np.abs(np.diff(value - signal.value)) > turn_rad / 2.0))
            if wraps:
                found[joint, key] = Signal(signal.time_s, value)
                count[joint] = count.get(joint, 0) + wraps
    return found, count


def _joint_logs(signals: dict[tuple[str, str], Signal]) -> dict[str, JointLog]:
    """Group the signals of a motion by joint, and count times from its first sample."""
    start_s = min(float(one.time_s[0]) for one in signals.values())
    times = {id(one.time_s): one.time_s for one in signals.values()}
    moved = {key: time_s - start_s for key, time_s in times.items()}  # signals with one clock share one array
    found: dict[str, dict[str, Signal]] = {}
    for (joint, key), one in signals.items():
        found.setdefault(joint, {})[key] = Signal(moved[id(one.time_s)], one.value)
    return {joint: JointLog(**one) for joint, one in found.items()}
