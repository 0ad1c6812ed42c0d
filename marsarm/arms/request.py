"""Request of `marsarm arm`: its options."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from simgap.common.options import Option


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
    check: Annotated[bool, Option("Write nothing; say whether these files are those of arm.toml.")] = False
