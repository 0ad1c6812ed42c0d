"""Options that several verbs share: the arm, its flight parameters and effects, and how the rover stands.

The requests of `arm`, `calibrate` and `view`, too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from simgap.common.options import Option, ReportOption

ARM_HELP: Final = (
    "nominal, as-built:SEED or calibrated:SEED; MODEL/ before it for another drawing, or a folder with an "
    "arm.toml."
)
ArmOption = Annotated[str, Option(ARM_HELP, "ARM")]
RollOption = Annotated[float, Option("Rover roll, right side down, in degrees.", "DEG", "--tilt-roll")]
PitchOption = Annotated[float, Option("Rover pitch, nose up, in degrees.", "DEG", "--tilt-pitch")]
SeedOption = Annotated[int, Option("Seed of everything random except the arm.", within=(0, None))]
ParamsOption = Annotated[
    Path | None,
    Option("TOML file of flight parameters that replace nominal ones.", "FILE.toml", is_read=True),
]
MismatchOption = Annotated[
    bool, Option("Take parameters that do not fit the drawing of the arm.", name="--mismatch")
]
EffectsOption = Annotated[
    tuple[str, ...],
    Option(
        "Switch on an effect of `marsarm dictionary --effects`, or FILE.py:CLASS as its name, or every "
        "effect of a FILE.toml; repeatable.",
        "NAME:PLACE:PARAMETER=VALUE,...",
        "--effect",
        is_read=True,
    ),
]


@dataclass(frozen=True, slots=True)
class ArmRequest:
    """Options of `marsarm arm`."""

    arm: Annotated[
        str | None,
        Option(
            "Name of an arm, or a folder with an arm.toml; all arms if not given.", "ARM", is_argument=True
        ),
    ] = None
    picture: Annotated[
        Path | None,
        Option("Draw arm, rover and frames, from the side and from above.", "FILE.png", suffixes=(".png",)),
    ] = None
    build: Annotated[bool, Option("Write arm.xml and flight.toml where they are not those of arm.toml.")] = (
        False
    )


@dataclass(frozen=True, slots=True)
class ViewRequest:
    """Options of `marsarm view`."""

    log: Annotated[Path, Option("A telemetry log (MCAP).", "LOG", is_argument=True, is_read=True)]
    html: Annotated[
        Path | None,
        Option(
            "Write the page here, and do not open it; if not given, LOG.html in this folder is opened.",
            "FILE.html",
            suffixes=(".html",),
        ),
    ] = None


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
