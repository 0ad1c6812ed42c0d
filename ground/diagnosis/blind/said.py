"""What was said of a case, as far as its score is made of it: read strictly, for people edit files."""

import json
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from pydantic import Field, FiniteFloat, TypeAdapter, ValidationError

from ground.diagnosis.diagnose import Kind


@dataclass(frozen=True, slots=True)
class _Named:
    name: str
    place: str


@dataclass(frozen=True, slots=True)
class _Size:
    name: str
    is_size: Literal[True]
    least: FiniteFloat
    most: FiniteFloat


@dataclass(frozen=True, slots=True)
class _Shape:
    is_size: Literal[False]


@dataclass(frozen=True, slots=True)
class _Finding(_Named):
    parameters: list[Annotated[_Size | _Shape, Field(discriminator="is_size")]]
    alternatives: list[_Named]


@dataclass(frozen=True, slots=True)
class _Closure:
    share: FiniteFloat | None


@dataclass(frozen=True, slots=True)
class _Other:
    """What a baseline says: an effect, a place alone, or neither."""

    name: str = ""
    place: str = ""
    closure: FiniteFloat | None = None

    def __post_init__(self) -> None:
        if self.name and not self.place:
            raise ValueError("an effect has a place")


@dataclass(frozen=True, slots=True)
class _Said:
    verdict: Kind
    effects: list[_Finding]
    ranking: list[_Named]
    closure: _Closure | None
    seconds: FiniteFloat
    baselines: dict[str, _Other]


_SAID: Final = TypeAdapter(_Said)


def read_said(raw: bytes) -> dict[str, Any]:
    """The whole document; ValueError, in a line, if it has not the form that a score is made of."""
    try:
        _SAID.validate_json(raw, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"])
        raise ValueError(f"{where}: {first['msg']}" if where else first["msg"]) from error
    said: dict[str, Any] = json.loads(raw)
    return said
