"""Requests of `marsarm calibrate` and `calibrate-serial`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from simgap.common.options import ARM_HELP, MismatchOption, Option, ParamsOption, ReportOption, SeedOption

LEAST_POSES: Final = 24
"""Smallest number of poses: three times what the worst-conditioned combination needs. The paper took 160."""
MOST_POSES: Final = 1000


@dataclass(frozen=True, slots=True)
class CalibrateRequest:
    """Request for a calibration: of `arm` in simulation, or of the real arm of `data`."""

    arm: Annotated[str | None, Option(f"Measure this arm in simulation: {ARM_HELP}", "ARM")] = None
    data: Annotated[
        Path | None,
        Option(
            "Measured poses of an arm, .parquet or .csv; columns in docs/calibration.md.",
            "TABLE",
            is_read=True,
        ),
    ] = None
    poses: Annotated[int, Option("Number of poses, in four groups.", within=(LEAST_POSES, MOST_POSES))] = 160
    seed: SeedOption = 0
    tracker_um: Annotated[
        tuple[float, float],
        Option(
            "Noise of the tracker, one sigma: micrometres, and micrometres per metre.", "UM UM/M", "--tracker"
        ),
    ] = (15.0, 6.0)
    params: ParamsOption = None
    mismatch: MismatchOption = False
    verify: Annotated[
        int,
        Option(
            "Number of new targets on each of Earth, Mars and cold Mars to verify with.",
            within=(0, MOST_POSES),
        ),
    ] = 0
    save_data: Annotated[
        Path | None,
        Option("Write the measured poses.", "FILE.parquet|.csv", suffixes=(".parquet", ".csv")),
    ] = None
    out: Annotated[Path | None, Option("Write flight parameters.", "FILE.toml", suffixes=(".toml",))] = None
    report: ReportOption = None
    picture: Annotated[
        Path | None,
        Option("Draw the errors of each pose before and after.", "FILE.png", suffixes=(".png",)),
    ] = None


@dataclass(frozen=True, slots=True)
class SerialRequest:
    """Request for a calibration of a serial arm."""

    arm: Annotated[
        Path,
        Option("The arm: six numbers for each link.", "ARM.toml", is_argument=True, is_read=True),
    ]
    table: Annotated[
        Path,
        Option("Joint angles and measured poses, .csv or .parquet.", "TABLE", is_argument=True, is_read=True),
    ]
    mapping: Annotated[
        Path, Option("Meaning and unit of each column.", "MAPPING.toml", is_argument=True, is_read=True)
    ]
    terms: Annotated[
        str,
        Option(
            "Terms to fit: geometry, compliance, periodic and hysteresis, joined by commas; none fits only "
            "base and target.",
            "TERMS|all|none",
        ),
    ] = "all"
    fit_share: Annotated[
        float,
        Option("Share of the poses to fit, the earliest ones; the others are held out.", within=(0.05, 1.0)),
    ] = 0.5
    nested: Annotated[bool, Option("Fit term by term, and show what each explains.")] = False
    out: Annotated[Path | None, Option("Write the fitted arm.", "FILE.toml", suffixes=(".toml",))] = None
    picture: Annotated[
        Path | None,
        Option("Draw the residuals and the joint errors.", "FILE.png", suffixes=(".png",)),
    ] = None
