"""Requests of the verbs of `simgap`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from simgap.common.options import Option, ReportOption

FIT_SHARE: Final = 0.5
"""Share of the poses of a tracker that are fitted, unless the user says so."""
ARM_FILE: Final = "arm.toml"
"""File of a serial arm with its links and what was named, in the folder of a patch."""
CALIBRATED_FILE: Final = "calibrated.toml"
"""File of a serial arm with every term that was fitted, named or not."""
RobotArgument = Annotated[
    Path,
    Option("The robot: its MJCF model, joints and columns.", "ROBOT.toml", is_argument=True, is_read=True),
]
LogsArgument = Annotated[
    tuple[Path, ...],
    Option(
        "Logs: .csv, .tsv, .txt, .jsonl (also with .gz), .parquet, .npz, .mcap, .bag, .db3; or folders of "
        "LeRobot data sets and ROS 2 bags.",
        "LOG...",
        is_argument=True,
        is_read=True,
    ),
]


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """Request for a check of a robot file and its logs."""

    robot: RobotArgument
    """A log, if there is no robot file."""
    logs: LogsArgument = ()
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class InitRequest:
    """Request for a first robot file."""

    model: Annotated[Path, Option("The model of the robot.", "MODEL.xml", is_argument=True, is_read=True)]
    logs: LogsArgument = ()
    out: Annotated[Path, Option("Robot file that is written.", "ROBOT.toml", suffixes=(".toml",))] = Path(
        "robot.toml"
    )
    unit: Annotated[
        Literal["", "rad", "deg", "percent", "count"],
        Option("Unit of the hinges where no name says it; guessed if not given.", "rad|deg|percent|count"),
    ] = ""


@dataclass(frozen=True, slots=True)
class DiagnoseRequest:
    """Request for a diagnosis, by logs or by poses that a tracker measured."""

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
    start: Annotated[
        Path | None,
        Option("Start from an earlier result: the folder of its patch. What it found acts.", "FOLDER"),
    ] = None
    seed: Annotated[int, Option("Seed of the parts into which motions are put.", within=(0, None))] = 1
    terms: Annotated[
        str,
        Option(
            "Of poses: the terms to fit, of geometry, compliance, periodic and hysteresis, joined by commas. "
            "none: only base and target of poses; only the base parameters of logs, without effects.",
            "TERMS|all|none",
        ),
    ] = "all"
    fit_share: Annotated[
        float,
        Option("Of poses: share to fit, the earliest ones; the others only judge.", within=(0.05, 0.95)),
    ] = FIT_SHARE
    nested: Annotated[bool, Option("Of poses: show what each term explains, and joint errors.")] = False
    patch: Annotated[
        Path | None,
        Option("Write the patched model, and the runtime file for what MuJoCo cannot express.", "FOLDER"),
    ] = None
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class NextRequest:
    """Request for the next motion."""

    robot: RobotArgument
    logs: LogsArgument
    start: Annotated[
        Path, Option("Folder of the patch of the diagnosis whose finding is to be settled.", "FOLDER")
    ]
    split: Annotated[
        str, Option("Split of that diagnosis; the default of the split file if not given.", "NAME")
    ] = ""
    held_out: Annotated[
        tuple[str, ...], Option("What that diagnosis held out in place of a split; repeatable.", "NAME")
    ] = ()
    out: Annotated[
        Path | None,
        Option("Write the commands, in the columns of the robot.", "FILE.csv", suffixes=(".csv",)),
    ] = None
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class CompareRequest:
    """Request for a comparison of two sets of logs of one robot."""

    robot: RobotArgument
    before: Annotated[Path, Option("Log before the change.", "BEFORE", is_argument=True, is_read=True)]
    after: Annotated[Path, Option("Log after the change.", "AFTER", is_argument=True, is_read=True)]
    seed: Annotated[int, Option("Seed of the parts into which motions are put.", within=(0, None))] = 1
