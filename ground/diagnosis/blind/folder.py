"""Where things are in a folder of blind cases."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from ground.common.files import BadOutput, atomic_write
from ground.common.requests import BadRequest
from ground.diagnosis.blind.said import read_said
from ground.diagnosis.blind.truth import sealed_digest

CAMPAIGN: Final = "campaign"
CASES: Final = "cases"
SOLVED: Final = "solved"
PART: Final = ".part"


def case_name(number: int) -> str:
    """Of one among cases from 0 on."""
    return f"case-{number:03d}"


def cases_in(folder: Path) -> tuple[Path, ...]:
    """The cases that are recorded, in order.

    Raises:
        BadRequest: this is no folder of blind cases, or none is recorded.
    """
    sealed_digest(folder)
    found = tuple(sorted(path for path in (folder / CASES).glob("case-*") if path.is_dir()))
    if not found:
        raise BadRequest(f"{folder}: no case is recorded yet; `marsarm gap blind make` goes on where it was")
    return found


def solved_path(case: Path) -> Path:
    """Where what was said of a case is kept."""
    return case.parent.parent / SOLVED / f"{case.name}.json"


def documents(folder: Path) -> dict[str, dict[str, Any]]:
    """What was said of every case that is solved, by its name; BadRequest if one cannot be read."""
    found = {}
    for path in sorted((folder / SOLVED).glob("case-*[0-9].json")):
        try:
            found[path.stem] = read_said(path.read_bytes())
        except (OSError, ValueError) as error:
            raise BadRequest(f"{path}: is no solved case ({error}); remove it and solve again") from error
    return found


def write_json(path: Path, document: Mapping[str, Any] | list[Any]) -> None:
    """A document, whole or not at all; BadOutput if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadOutput(f"out {path}: cannot be written ({error.strerror or error})") from error
    with atomic_write(path, "out") as file:
        file.write((json.dumps(document, indent=1, allow_nan=False) + "\n").encode())
