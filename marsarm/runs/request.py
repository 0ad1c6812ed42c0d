"""Requests of `marsarm place`, `run` and `hardstop`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from marsarm.common.options import (
    ARM_HELP,
    ArmOption,
    EffectsOption,
    MismatchOption,
    ParamsOption,
    PitchOption,
    RollOption,
    SeedOption,
)
from simgap.common.options import Option, Vector


@dataclass(frozen=True, slots=True)
class RunFiles:
    """Files that a run writes, None for each that it does not."""

    log: Annotated[Path | None, Option("Write a telemetry log (MCAP).", "FILE.mcap", suffixes=(".mcap",))] = (
        None
    )
    picture: Annotated[
        Path | None,
        Option(
            "Draw the arm in contact, or at the last check.",
            "FILE.png",
            suffixes=(".png",),
            help_without="Draw no picture.",
        ),
    ] = None
    page: Annotated[
        Path | None, Option("Write a page that plays the run.", "FILE.html", suffixes=(".html",))
    ] = None


NO_FILES: Final = RunFiles()


@dataclass(frozen=True, slots=True)
class PlaceRequest:
    """Options of `marsarm place`."""

    tool: Annotated[
        str | None, Option("A tool with contact switches; the instrument of the arm if not given.", "TOOL")
    ] = None
    target_m: Annotated[Vector, Option("Point on the surface, RNAV, in metres.", "X Y Z", "--target")] = (
        2.05,
        0.1,
        -0.25,
    )
    normal: Annotated[Vector, Option("Direction out of the surface, RNAV.", "NX NY NZ")] = (-0.5, 0.1, -0.85)
    tilt_roll_deg: RollOption = 0.0
    tilt_pitch_deg: PitchOption = 0.0
    arm: ArmOption = "nominal"
    seed: SeedOption = 0
    params: ParamsOption = None
    mismatch: MismatchOption = False
    effects: EffectsOption = ()
    has_surface: Annotated[
        bool, Option("Place a rock with this surface in the world, or none.", name="--surface/--no-surface")
    ] = True
    files: RunFiles = RunFiles(picture=Path("place.png"))


@dataclass(frozen=True, slots=True)
class ShowRequest(PlaceRequest):
    """Options of `marsarm show`."""

    files: RunFiles = RunFiles(page=Path("place.html"))


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Options of `marsarm run`; None takes the value of the scenario."""

    scenario: Annotated[
        str,
        Option(
            "A name from `marsarm run --list`, or a .toml file.", "SCENARIO", is_argument=True, is_read=True
        ),
    ] = ""
    arm: Annotated[str | None, Option(f"{ARM_HELP} That of the scenario if not given.", "ARM")] = None
    tilt_deg: Annotated[
        tuple[float, float] | None,
        Option(
            "Tilt of the rover, degrees: roll, right side down, and pitch, nose up; if not given, that of "
            "the scenario.",
            "ROLL PITCH",
            "--tilt",
        ),
    ] = None
    seed: SeedOption = 0
    params: ParamsOption = None
    mismatch: MismatchOption = False
    files: RunFiles = NO_FILES
    effects: EffectsOption = ()


@dataclass(frozen=True, slots=True)
class HardstopRequest:
    """Options of `marsarm hardstop`."""

    joint: Annotated[
        str | None, Option("azimuth, elevation, elbow, wrist or turret; all if not given.", "NAME")
    ] = None
    arm: ArmOption = "nominal"
    scene: Annotated[Literal["mars", "earth"], Option("mars or earth.", "mars|earth")] = "mars"
    tilt_roll_deg: RollOption = 0.0
    tilt_pitch_deg: PitchOption = 0.0
    turret: Annotated[
        bool,
        Option(
            "Without its turret the arm is calibrated on Earth, in poses with the joint torques of Mars.",
            name="--turret/--no-turret",
        ),
    ] = True
    temperature_C: Annotated[
        float | None,
        Option(
            "Temperature of the actuators, degC; 20 if not given. Friction rises in the cold.",
            "DEGC",
            "--temperature",
        ),
    ] = None
    seed: SeedOption = 0
    params: ParamsOption = None
    mismatch: MismatchOption = False
    effects: EffectsOption = ()
    picture: Annotated[
        Path | None, Option("Draw current, speed and angle.", "FILE.png", suffixes=(".png",))
    ] = None
