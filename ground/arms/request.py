"""Request of `marsarm arm build`: its options."""

from dataclasses import dataclass
from typing import Annotated

from ground.common.options import Option


@dataclass(frozen=True, slots=True)
class ArmBuildRequest:
    """Options of `marsarm arm build`."""

    arm: Annotated[
        str | None,
        Option(
            "Name of an arm, or a folder with an arm.toml; all arms of the project if not given.",
            "ARM",
            is_argument=True,
        ),
    ] = None
    check: Annotated[bool, Option("Write nothing; say whether the files are those of arm.toml.")] = False
