"""Options that several verbs share: the arm, its flight parameters and effects, and how the rover stands."""

from pathlib import Path
from typing import Annotated, Final

from simgap.common.options import Option

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
