"""Loading of logs: from files to signals in SI units at the joint, by motion, and which are fitted."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pyarrow as pa
from pydantic import Field, model_validator

from simgap.common.errors import RobotError
from simgap.common.toml import Record, parse_record, read_toml
from simgap.files.columns import hint_at
from simgap.files.log_file import LogFile, open_log
from simgap.files.message_log import MessageLog
from simgap.files.motion_rows import MotionRows, unwrap_counters
from simgap.files.robot_file import RobotFile
from simgap.logs import JointLog, Logs, Motion, Signal
from simgap.robot import Robot


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
    others: tuple[str, ...]
    """Its name in its file, its file, and its conditions, as `mass_kg=0.5`."""


def read_split(path: Path) -> SplitFile:
    """Read a split file; RobotError if it cannot be read, or a key or a value is wrong."""
    return parse_record(SplitFile, read_toml(path), path)


def choose_motions(
    file: SplitFile | None, members: Sequence[Member], split: str, held_out: Sequence[str]
) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of fitted and of judging motions; RobotError if one is in both, or none is fitted."""
    everything = frozenset(one.motion for one in members)
    if held_out:
        judged = find_members(held_out, members, "held out")
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
    return frozenset().union(*(find_members(file.parts[part], members, f"part {part}") for part in parts))


def find_members(names: Sequence[str], members: Sequence[Member], where: str) -> frozenset[str]:
    """Return the motions with these names, conditions or files; RobotError if a name is unknown."""
    found: set[str] = set()
    for name in names:
        chosen = _match(name, members) or _match(_rewrite_number(name), members)
        if not chosen:
            there = dict.fromkeys(text for one in members for text in (one.motion, *one.others))
            raise RobotError(
                f"{where}: {name!r} is no motion, condition or file of these logs{_near(name, there)}"
            )
        found |= chosen
    return frozenset(found)


def _match(name: str, members: Sequence[Member]) -> set[str]:
    return {one.motion for one in members if name and name in (one.motion, *one.others)}


def _rewrite_number(name: str) -> str:
    """Return a condition with its number as motions have it: `mass_kg=0.50` is `mass_kg=0.5`."""
    left, equals, number = name.rpartition("=")
    try:
        return f"{left.strip()}={float(number) + 0.0:.9g}" if equals else name
    except ValueError:
        return name


def _near(name: str, there: Collection[str]) -> str:
    if "," in name and all(part.strip() in there for part in name.split(",")):
        return "; name each by itself: --held-out A --held-out B, or ['A', 'B'] in Python and files"
    return f"; {hint_at(name, [one for one in there if one], 'there are')}"


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
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(one) for one in paths]
    loaded = [_load_file(robot, path) for path in files]
    pa.default_memory_pool().release_unused()  # the tables are gone, but their memory would stay
    converted = [[take_currents_as_torques(robot, one) for one in found] for found, _ in loaded]
    motions, members = _name_motions(files, converted)
    if not motions:
        raise RobotError("logs: none is given; name at least one log file")
    motions = _add_conditions(robot.file, motions, members)
    said = [[f"{name}={value:.9g}" for name, value in one.conditions.items()] for one in motions]
    members = [replace(one, others=(*one.others, *own)) for one, own in zip(members, said, strict=True)]
    for group in robot.file.motion.repeats:
        alike = find_members(group, members, "repeats")
        motions = [replace(one, repeat_of=group[0]) if one.name in alike else one for one in motions]
    splits = read_split(robot.path.parent / robot.file.split) if robot.file.split else None
    fitted, judged = choose_motions(splits, members, split, held_out)
    losses = [f"{path}: {one}" for path, (_, lost) in zip(files, loaded, strict=True) for one in lost]
    idle = [one.name for one in motions if one.name not in fitted | judged]
    if splits is not None and idle:
        losses.append(_idle_sentence(split or splits.default, idle))
    return Logs(tuple(one for one in motions if one.name in fitted | judged), judged, tuple(losses))


def _name_motions(
    paths: Sequence[Path], files: Sequence[Sequence[Motion]]
) -> tuple[list[Motion], list[Member]]:
    """Put the name of the file before names of motions that several files have, as in `monday:0`.

    Files of one name are told apart by their folders. A motion that has the name of its file is named by the
    file alone.
    """
    whole = [path.resolve() for path in paths]
    twice = next((paths[k] for k, path in enumerate(whole) if path in whole[:k]), None)
    if twice is not None:
        raise RobotError(f"{twice}: is given twice; give each log once")
    labels = _label_files(whole)
    count = Counter(motion.name for motions in files for motion in motions)
    named: list[Motion] = []
    members: list[Member] = []
    for path, label, motions in zip(whole, labels, files, strict=True):
        for one in motions:
            with_file = label if one.name == path.stem else f"{label}:{one.name}"
            name = one.name if count[one.name] == 1 else with_file
            named.append(replace(one, name=name))
            members.append(Member(name, (one.name, label, path.stem)))
    return named, members


def _add_conditions(file: RobotFile, motions: list[Motion], members: Sequence[Member]) -> list[Motion]:
    """Return motions with the conditions given by motion or file; RobotError for a wrong name or value.

    Motions and files that are not among these logs may have a value too.
    """
    for name, table in file.conditions.items():
        if not table.values:
            continue
        where = f"conditions.{name}.values"
        found: dict[str, float] = {}
        known = {name for one in members for name in (one.motion, *one.others)}
        for key, value in table.values.items():
            if key not in known:  # of a log that is not given, or misspelled
                continue
            for motion in find_members([key], members, where):
                if found.setdefault(motion, value) != value:
                    raise RobotError(
                        f"{where}: motion {motion!r} has {found[motion]:g} and {value:g}; give it one"
                    )
        without = next((one.name for one in motions if one.name not in found), None)
        if without is not None:
            find_members([key for key in table.values if key not in known], members, where)  # refuses one
            raise RobotError(f"{where}: motion {without!r} has no value; add it, or its log file")
        motions = [replace(one, conditions={**one.conditions, name: found[one.name]}) for one in motions]
    return motions


def _label_files(paths: Sequence[Path]) -> list[str]:
    """Return the shortest ends of paths, where possible without suffix, that tell the files apart."""
    without = [path.with_suffix("") for path in paths]
    ends = (
        ["/".join(path.parts[-n:]) for path in kind]
        for kind in (without, paths)
        for n in range(1, max((len(path.parts) for path in paths), default=0) + 1)
    )
    return next((one for one in ends if len(set(one)) == len(one)), [])


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


def _load_file(robot: Robot, path: Path) -> tuple[list[Motion], list[str]]:
    """Load the motions of one file, with sentences about what it lacks."""
    assert robot.file is not None
    file = robot.file
    signals = {
        (joint, key): one for joint, table in file.joints.items() for key, one in table.columns().items()
    }
    wanted = [name for one, _ in signals.values() for name in (one.column, one.time_column)]
    gains = {joint: table.gain_column for joint, table in file.joints.items() if table.gain_column}
    conditions = {name: table.column for name, table in file.conditions.items() if table.column}
    numbers = dict.fromkeys(filter(None, (file.time.column, *wanted, *gains.values(), *conditions.values())))
    texts = dict.fromkeys(filter(None, (*file.motion.columns, file.motion.repeat_column)))
    log = open_log(path, list(numbers), list(texts), file.csv)
    rows = MotionRows(log, file)
    absent: dict[str, dict[str, str]] = {}
    found: dict[str, dict[str, Sequence[Signal]]] = {joint: {} for joint in file.joints}
    for (joint, key), (one, quantity) in signals.items():
        named = one.model_copy(update={"column": _column_by_name(log, file, joint, key, one.column)})
        signal = rows.signals(key, named, quantity, file.joints[joint])
        if signal is None:
            absent.setdefault(key, {})[joint] = one.column
        else:
            found[joint][key] = signal
    rows.losses += [
        f"there is no {key} of {', '.join(columns)}: {', '.join(columns.values())} never has a number"
        for key, columns in absent.items()
    ]
    unwrapped = {
        joint: unwrap_counters(table, found[joint], robot.range_rad(joint))
        for joint, table in file.joints.items()
    }
    gain = {joint: rows.gains(column) for joint, column in gains.items()}
    repeats = rows.labels(file.motion.repeat_column)
    valued = {name: rows.values(column) for name, column in conditions.items()}
    motions = []
    for k, name in enumerate(rows.names):
        logs = {joint: {key: own[k] for key, own in one.items()} for joint, (one, _) in unwrapped.items()}
        wraps = {joint: n for joint, (_, count) in unwrapped.items() if (n := count[k]) is not None}
        gained = {joint: gain[joint][k] if joint in gain else 1.0 for joint in file.joints}
        start_s, joint_logs = _joint_logs(logs)
        since_s = start_s - rows.start_s
        settings = {condition: values[k] for condition, values in valued.items()}
        motions.append(Motion(name, joint_logs, gained, repeats[k], settings, wraps, since_s))
    return motions, rows.losses


def _column_by_name(log: LogFile, file: RobotFile, joint: str, key: str, column: str) -> str:
    """Return a column of messages by the name of its joint, where the robot file gives a place in a list.

    Messages may have their joints in any order. The place means the name that stood there first; if other
    publishers put names there that the robot file does not know, the joint's own.
    """
    stood = log.names_at(column) if isinstance(log, MessageLog) else ()
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


def _joint_logs(signals: Mapping[str, Mapping[str, Signal]]) -> tuple[float, dict[str, JointLog]]:
    """Count the times of a motion, by joint and signal, from its first sample; return it too [s]."""
    every = [one for own in signals.values() for one in own.values()]
    start_s = min(float(one.time_s[0]) for one in every)
    times = {id(one.time_s): one.time_s for one in every}
    moved = {key: time_s - start_s for key, time_s in times.items()}  # signals with one clock share one array
    return start_s, {
        joint: JointLog(**{key: Signal(moved[id(one.time_s)], one.value) for key, one in own.items()})
        for joint, own in signals.items()
    }
