"""Request of `marsarm calibrate`: its options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from marsarm.common.options import ARM_HELP, MismatchOption, ParamsOption, SeedOption
from simgap.common.options import Option, ReportOption

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
        Path | None, Option("Write the measured poses.", "FILE.parquet|.csv", suffixes=(".parquet", ".csv"))
    ] = None
    out: Annotated[Path | None, Option("Write flight parameters.", "FILE.toml", suffixes=(".toml",))] = None
    report: ReportOption = None
    picture: Annotated[
        Path | None, Option("Draw the errors of each pose before and after.", "FILE.png", suffixes=(".png",))
    ] = None
