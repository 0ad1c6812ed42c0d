"""Requests of `marsarm diagnose`, `gap record` and `gap demo`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from marsarm.common.options import ArmOption, EffectsOption, MismatchOption, ParamsOption, SeedOption
from simgap.common.options import ClusterOption, Option, ReportOption, WorkersOption


@dataclass(frozen=True, slots=True)
class LogsRequest:
    """Logs of a diagnosis, and the arm that they are compared with."""

    logs: Annotated[
        tuple[Path, ...], Option("Logs, or folders: all .mcap files in them.", "LOG...", is_argument=True)
    ]
    held_out: Annotated[
        tuple[Path, ...],
        Option(
            "Logs that are not fitted; the reduction of their residuals validates the result; repeatable.",
            "LOG",
        ),
    ] = ()
    arm: Annotated[str, Option("Drawing of the arm: a name, or a folder with an arm.toml.", "MODEL")] = (
        "nominal"
    )
    params: ParamsOption = None
    mismatch: MismatchOption = False
    catalogue: Annotated[
        str | None,
        Option(
            "Effects of `marsarm dictionary --effects` that may be the cause; all of them if not given.",
            "NAME,NAME,...",
        ),
    ] = None
    campaign: Annotated[
        Path | None,
        Option(
            "Folder with logs of the campaign that these repeat; it caches the sensitivities. Without it "
            "the sensitivities of the logs themselves are computed, which takes minutes.",
            "DIR",
        ),
    ] = None
    effects: EffectsOption = ()
    seed: SeedOption = 0
    workers: WorkersOption = None
    cluster: ClusterOption = None


@dataclass(frozen=True, slots=True)
class DiagnoseRequest(LogsRequest):
    """Request for a diagnosis."""

    patch: Annotated[
        Path | None, Option("Write the identified effects, for --effect.", "FILE.toml", suffixes=(".toml",))
    ] = None
    new_params: Annotated[
        Path | None,
        Option("Write flight parameters with these effects, for --params.", "FILE.toml", suffixes=(".toml",)),
    ] = None
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class DemoRequest:
    """Request for a demonstration of the diagnosis."""

    seed: SeedOption = 0
    workers: WorkersOption = None
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class NextRequest(LogsRequest):
    """Request for the next motion."""

    out: Annotated[
        Path | None, Option("Write the motion, for `gap record --motion`.", "FILE.toml", suffixes=(".toml",))
    ] = None
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class RecordRequest:
    """Request to record a campaign."""

    out: Annotated[Path, Option("A new or empty folder for the logs.", "DIR")]
    arm: ArmOption = "nominal"
    effects: EffectsOption = ()
    params: ParamsOption = None
    mismatch: MismatchOption = False
    seed: SeedOption = 0
    sessions: Annotated[
        str, Option("Record only the sessions with such names, for example poses-level-*.", "PATTERN")
    ] = "*"
    motion: Annotated[
        Path | None,
        Option("Record the motion of this file, as `gap next` wrote it, instead.", "FILE.toml", is_read=True),
    ] = None
