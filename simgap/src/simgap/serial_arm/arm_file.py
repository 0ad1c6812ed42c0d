"""TOML files of serial arms: strict reading, of degrees and millimetres too, and writing."""

import math
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import ConfigDict, Field, field_validator

from simgap.files.toml_record import Record, parse_record, read_toml
from simgap.serial_arm.arm import Link, Repeatability, SerialArm, Uncertainty, UPRIGHT_B_m_s2, Vector

MOST_LINKS: Final = 20
"""Most links of an arm: the fit of more would take minutes."""
OTHER_UNITS: Final = {"_deg": ("_rad", math.pi / 180), "_mm": ("_m", 1e-3)}
"""Suffixes that a file may have in place of those of SI units, with their value in them."""


class ArmFile(Record):
    """Content of a file."""

    model_config = ConfigDict(strict=False)  # tables become dataclasses, lists tuples; numbers stay strict

    name: Annotated[str, Field(min_length=1)]
    gravity_B_m_s2: Vector = UPRIGHT_B_m_s2
    link: Annotated[list[Link], Field(min_length=1, max_length=MOST_LINKS)]
    uncertainty: Uncertainty = Uncertainty()
    repeatability: Repeatability = Repeatability()

    @field_validator("link")
    @classmethod
    def _check_names(cls, links: list[Link]) -> list[Link]:
        names = ["base", "target", *(one.name for one in links)]
        taken = next((name for k, name in enumerate(names) if name in names[:k]), None)
        if taken is not None:
            raise ValueError(f"name {taken!r} is taken already; give each link its own")
        return links


def read_arm(path: Path) -> SerialArm:
    """Read an arm from its file.

    Raises:
        RobotError: The file cannot be read or is wrong; the text gives the path of the key.
    """
    content = parse_record(ArmFile, _in_si_units(read_toml(path)), path)
    return SerialArm(
        content.name, tuple(content.link), content.gravity_B_m_s2, content.uncertainty, content.repeatability
    )


def _in_si_units(value: Any) -> Any:
    """Convert the keys that end in `_deg` or `_mm`, with their values, in all tables."""
    if isinstance(value, list):
        return [_in_si_units(one) for one in value]
    if not isinstance(value, dict):
        return value
    found: dict[str, Any] = {}
    for key, one in value.items():
        suffix = next((suffix for suffix in OTHER_UNITS if key.endswith(suffix)), "")
        si, factor = OTHER_UNITS.get(suffix, ("", 1.0))
        name = key.removesuffix(suffix) + si
        # A key that stands twice keeps its second name, which is then refused as unknown.
        found[key if name in value and suffix else name] = (
            _scaled(one, factor) if suffix else _in_si_units(one)
        )
    return found


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, list):
        return [_scaled(one, factor) for one in value]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) * factor if is_number else value


def arm_to_toml(arm: SerialArm, about: Iterable[str]) -> str:
    """Format an arm as TOML, from which every bit can be read again.

    Args:
        arm: Arm to write.
        about: Comments at the top of the file.

    Returns:
        The content of the file.
    """
    lines = [f"# {line}".rstrip() for line in about]
    lines += [
        "",
        f"name = {_toml_value(arm.name)}",
        f"gravity_B_m_s2 = {_toml_value(arm.gravity_B_m_s2)}",
        "",
    ]
    for one in arm.links:
        lines += ["[[link]]", *_fields(one), ""]
    for name, record in (("uncertainty", arm.uncertainty), ("repeatability", arm.repeatability)):
        lines += [f"[{name}]", *_fields(record), ""]
    return "\n".join(lines)


def _fields(record: Any) -> list[str]:
    values = ((f.name, getattr(record, f.name)) for f in fields(record))
    return [f"{name} = {_toml_value(value)}" for name, value in values if value is not None]


def _toml_value(value: Any) -> str:
    if isinstance(value, str):
        return '"' + "".join(_escape(letter) for letter in value) + '"'
    if isinstance(value, tuple):
        return f"[{', '.join(_toml_value(item) for item in value)}]"
    return repr(value if isinstance(value, int) else float(value))


def _escape(letter: str) -> str:
    if letter in '"\\':
        return f"\\{letter}"
    return letter if letter.isprintable() else f"\\U{ord(letter):08x}"
