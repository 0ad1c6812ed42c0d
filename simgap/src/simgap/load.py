"""Loading of logs: from files to signals in SI units at the joint, by motion."""

from collections.abc import Sequence
from pathlib import Path

from simgap.common.errors import RobotError
from simgap.files.log_file import open_log
from simgap.files.motion_rows import MotionRows
from simgap.files.robot_file import RobotFile
from simgap.files.split_file import Member, choose_motions, read_split
from simgap.logs import JointLog, Logs, Motion, Signal
from simgap.robot import Robot


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
        Motions in the order of the files; each signal has its own times, from the start of its motion.

    Raises:
        RobotError: a file, a column, a value, a time or a name of the split is wrong.
    """
    robot = robot if isinstance(robot, Robot) else Robot.from_toml(robot)
    if robot.file is None:
        raise RobotError(f"robot {robot.name}: was not read from a robot file, which names the columns")
    motions: list[Motion] = []
    members: list[Member] = []
    for path in [Path(paths)] if isinstance(paths, str | Path) else map(Path, paths):
        for motion in _load_file(robot.file, path):
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
    return Logs(tuple(motion for motion in motions if motion.name in fitted | judged), judged)


def _load_file(file: RobotFile, path: Path) -> list[Motion]:
    """Load the motions of one file."""
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
    rows = MotionRows(open_log(path, list(numbers), list(texts), file.csv), file)
    found = {place: rows.signals(*one) for place, one in signals.items()}
    gain = {joint: rows.gains(column) for joint, column in gains.items()}
    repeats, conditions = (rows.labels(column) for column in labels)
    return [
        Motion(
            name,
            _joint_logs({place: one[k] for place, one in found.items()}),
            {joint: gain[joint][k] if joint in gain else 1.0 for joint in file.joints},
            repeats[k],
            conditions[k],
        )
        for k, name in enumerate(rows.names)
    ]


def _joint_logs(signals: dict[tuple[str, str], Signal]) -> dict[str, JointLog]:
    """Group the signals of a motion by joint, and count times from its first sample."""
    start_s = min(float(one.time_s[0]) for one in signals.values())
    times = {id(one.time_s): one.time_s for one in signals.values()}
    moved = {key: time_s - start_s for key, time_s in times.items()}  # signals with one clock share one array
    found: dict[str, dict[str, Signal]] = {}
    for (joint, key), one in signals.items():
        found.setdefault(joint, {})[key] = Signal(moved[id(one.time_s)], one.value)
    return {joint: JointLog(**one) for joint, one in found.items()}
