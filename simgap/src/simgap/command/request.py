"""Requests of the verbs of `marsarm robot`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from simgap.common.options import Option, ReportOption

RobotArgument = Annotated[
    Path,
    Option("The robot: its MJCF model, joints and columns.", "ROBOT.toml", is_argument=True, is_read=True),
]
LogsArgument = Annotated[
    tuple[Path, ...],
    Option("Logs: .parquet, .csv, .mcap or .npz.", "LOG...", is_argument=True, is_read=True),
]


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """Request for a check of a robot file and its logs."""

    robot: RobotArgument
    logs: LogsArgument
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class RobotDiagnoseRequest:
    """Request for a diagnosis of any robot."""

    robot: RobotArgument
    logs: LogsArgument
    split: Annotated[
        str, Option("Split of the split file that the robot file names; its default if not given.", "NAME")
    ] = ""
    held_out: Annotated[
        tuple[str, ...],
        Option("Motion, condition or log file that only judges, in place of a split; repeatable.", "NAME"),
    ] = ()
    effects: Annotated[
        tuple[Path, ...],
        Option("Python file with effects of your own, which join the catalogue; repeatable.", "FILE.py"),
    ] = ()
    seed: Annotated[int, Option("Seed of the parts into which motions are put.", within=(0, None))] = 1
    patch: Annotated[
        Path | None,
        Option("Write the patched model, and the runtime file for what MuJoCo cannot express.", "FOLDER"),
    ] = None
    report: ReportOption = None
