"""Requests of the verbs of `marsarm robot`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ground.common.options import Option, ReportOption


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """Request for a check of a robot file and its logs."""

    robot: Annotated[
        Path,
        Option(
            "The robot: its MJCF model, joints and columns.", "ROBOT.toml", is_argument=True, is_read=True
        ),
    ]
    logs: Annotated[
        tuple[Path, ...],
        Option("Logs: .parquet, .csv, .mcap or .npz.", "LOG...", is_argument=True, is_read=True),
    ]
    report: ReportOption = None
