"""Requests of `marsarm arm build` and `arm show`: their options."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from simgap.common.options import Option


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


@dataclass(frozen=True, slots=True)
class ArmShowRequest:
    """Options of `marsarm arm show`."""

    arm: Annotated[
        str | None,
        Option(
            "Name of an arm, or a folder with an arm.toml; the default arm if not given.",
            "ARM",
            is_argument=True,
        ),
    ] = None
    picture: Annotated[
        Path | None,
        Option("Draw arm, rover and frames, from the side and from above.", "FILE.png", suffixes=(".png",)),
    ] = None
