"""Requests of `marsarm ik` and `reach`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from marsarm.common.options import ARM_HELP, MismatchOption, ParamsOption, PitchOption, RollOption
from simgap.common.options import ClusterOption, Option, Vector

MOST_SAMPLES: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class ModelRequest:
    """Request for an arm model; angles in degrees, temperatures in kelvin."""

    tool: Annotated[str | None, Option("A tool of the arm; its instrument if not given.", "TOOL")] = None
    compensate: Annotated[
        Literal["absolute", "off"],
        Option(
            "absolute: the tool of the arm deflected by gravity meets the target; off: that of the rigid "
            "arm, and gravity and tilt do not matter.",
            "absolute|off",
        ),
    ] = "absolute"
    tilt_roll_deg: RollOption = 0.0
    tilt_pitch_deg: PitchOption = 0.0
    gravity: Annotated[str, Option("mars or earth.", "mars|earth")] = "mars"
    warming_K: Annotated[
        float, Option("Temperature of the arm above that at calibration, in kelvin.", "K", "--warming")
    ] = 0.0
    arm: Annotated[
        str,
        Option(
            f"{ARM_HELP} Its flight parameters are the arm that flight software assumes; those of as-built "
            "are nominal.",
            "ARM",
        ),
    ] = "nominal"
    params: ParamsOption = None
    mismatch: MismatchOption = False


@dataclass(frozen=True, slots=True)
class IkRequest:
    """Request for one target."""

    model: ModelRequest = ModelRequest()
    position_m: Annotated[
        Vector | None, Option("Position of the tool's origin, RNAV, in metres.", "X Y Z", "--position")
    ] = None
    approach: Annotated[Vector | None, Option("Direction of the tool, of any length.", "AX AY AZ")] = None


@dataclass(frozen=True, slots=True)
class ReachRequest:
    """Request for a reach map."""

    model: ModelRequest = ModelRequest()
    samples: Annotated[int, Option("Number of random targets.", within=(1, MOST_SAMPLES))] = 20_000
    seed: Annotated[int, Option("Seed of the random targets.", within=(0, None))] = 0
    workers: Annotated[
        int, Option("Number of processes; they pay from 100,000 targets on.", within=(1, 1000))
    ] = 1
    cluster: ClusterOption = None
    picture: Annotated[
        Path | None, Option("Draw the map.", "FILE.png", suffixes=(".png",), help_without="Draw no picture.")
    ] = Path("reach.png")
