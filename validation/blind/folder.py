"""Folder of blind cases: its layout, its result files, and checks of `python -m validation.blind`."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, FiniteFloat, TypeAdapter, ValidationError

from marsarm.diagnosis.blind_case import DIGEST, read_digest
from marsarm.diagnosis.diagnose import Level, Verdict
from simgap.common.errors import BadOutput, BadRequest
from simgap.common.files import atomic_write, check_new_path
from simgap.common.toml import describe_first_problem

CAMPAIGN_FOLDER: Final = "campaign"
CASES_FOLDER: Final = "cases"
SOLVED_FOLDER: Final = "solved"
PARTIAL_SUFFIX: Final = ".part"


@dataclass(frozen=True, slots=True)
class _PlacedEffect:
    name: str
    place: str


@dataclass(frozen=True, slots=True)
class _Size:
    name: str
    is_amplitude: Literal[True]
    least: FiniteFloat
    most: FiniteFloat


@dataclass(frozen=True, slots=True)
class _Shape:
    is_amplitude: Literal[False]


@dataclass(frozen=True, slots=True)
class _Finding(_PlacedEffect):
    parameters: list[Annotated[_Size | _Shape, Field(discriminator="is_amplitude")]]
    level: Level
    places: list[str]
    families: list[str]
    effects: list[_PlacedEffect]


@dataclass(frozen=True, slots=True)
class _Closure:
    share: FiniteFloat | None


@dataclass(frozen=True, slots=True)
class _ResultFile:
    verdict: Verdict
    effects: list[_Finding]
    closure: _Closure | None
    seconds: FiniteFloat


_RESULT_ADAPTER: Final = TypeAdapter(_ResultFile)


def parse_result(raw: bytes) -> dict[str, Any]:
    """Parse a result file; ValueError in one line if the score cannot use it."""
    try:
        _RESULT_ADAPTER.validate_json(raw, strict=True)
    except ValidationError as error:
        raise ValueError(describe_first_problem(error)) from error
    document: dict[str, Any] = json.loads(raw)
    return document


def case_name(number: int) -> str:
    """Return the name of a case by its number from 0."""
    return f"case-{number:03d}"


def list_cases(folder: Path) -> tuple[Path, ...]:
    """List the recorded cases in order.

    Raises:
        BadRequest: This is no folder of blind cases, or none is recorded.
    """
    read_digest(folder)
    found = tuple(sorted(path for path in (folder / CASES_FOLDER).glob("case-*") if path.is_dir()))
    if not found:
        raise BadRequest(f"{folder}: no case is recorded yet; `python -m validation.blind make` continues")
    return found


def result_path(case: Path) -> Path:
    """Return the path of a case's result."""
    return case.parent.parent / SOLVED_FOLDER / f"{case.name}.json"


def load_results(folder: Path) -> dict[str, dict[str, Any]]:
    """Load the results of all solved cases by name; BadRequest if one cannot be read."""
    found = {}
    if (folder / SOLVED_FOLDER).is_file():
        raise BadRequest(f"{folder / SOLVED_FOLDER}: is a file; a folder of solved cases would be right")
    for path in sorted((folder / SOLVED_FOLDER).glob("case-*[0-9].json")):
        try:
            found[path.stem] = parse_result(path.read_bytes())
        except (OSError, ValueError) as error:
            raise BadRequest(f"{path}: is no solved case ({error}); remove it and solve again") from error
    return found


def write_json(path: Path, document: Mapping[str, Any] | list[Any]) -> None:
    """Write a document atomically; BadOutput if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadOutput(f"out {path}: cannot be written ({error.strerror or error})") from error
    with atomic_write(path, "out") as file:
        file.write((json.dumps(document, indent=1, allow_nan=False) + "\n").encode())


MAX_CASES = 1000


def check_make(cases: int, seed: int, out: Path, jobs: int | None) -> None:
    """Refuse arguments of `make` that are wrong, before anything is written.

    Raises:
        BadRequest: A number is out of range, or the folder holds something else.
        BadOutput: The folder cannot be made.
    """
    if not 1 <= cases <= MAX_CASES:
        raise BadRequest(f"cases: {cases} is not within 1 .. {MAX_CASES}")
    if seed < 0:
        raise BadRequest(f"seed: {seed} is below 0")
    check_jobs(jobs)
    check_new_path(out, "out")
    if not os.path.exists(out):
        return
    if not os.path.isdir(out):
        raise BadRequest(f"out {out}: this is a file; name a new folder, or one of blind cases")
    there = set(os.listdir(out))
    if there and not there & {DIGEST, CAMPAIGN_FOLDER, CAMPAIGN_FOLDER + PARTIAL_SUFFIX}:
        raise BadRequest(f"out {out}: holds something else; name a new folder, or one of blind cases")


def check_jobs(jobs: int | None) -> None:
    """Refuse a number of processes below 1 with BadRequest."""
    if jobs is not None and jobs < 1:
        raise BadRequest(f"jobs: {jobs} is not 1 or more")
