"""What blind cases were made with: written down, and sealed by its digest before any of them is recorded."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

from ground.common.files import atomic_write
from ground.common.requests import BadRequest

Kind = Literal["none", "single", "pair", "outside"]
TRUTH: Final = "truth.json"
DIGEST: Final = "digest.txt"


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """An effect that a case has."""

    name: str
    place: str
    values: dict[str, float]
    """Of all its parameters, by name, in the units of the diagnosis."""
    times_limit: float
    """Its size over the detection limit."""
    spec: str
    """What switches it on in the plant."""


@dataclass(frozen=True, slots=True)
class TrueCase:
    """One case; `background` is what every arm has of its own, `seed` that of its sensors' noise."""

    name: str
    kind: Kind
    effects: tuple[TrueEffect, ...]
    background: tuple[str, ...]
    seed: int


@dataclass(frozen=True, slots=True)
class Truth:
    """All cases; without the salt nobody can try whether a truth that he thinks of has this digest."""

    salt: str
    cases: tuple[TrueCase, ...]

    def text(self) -> str:
        """As it is written."""
        return json.dumps(asdict(self), indent=1, sort_keys=True) + "\n"

    def digest(self) -> str:
        """SHA-256 of that."""
        return hashlib.sha256(self.text().encode()).hexdigest()


def seal(folder: Path, truth: Truth) -> str:
    """Write truth and digest; the digest. BadOutput if a file cannot be written."""
    digest = truth.digest()
    for name, text in ((TRUTH, truth.text()), (DIGEST, digest + "\n")):
        with atomic_write(folder / name, "out") as file:
            file.write(text.encode())
    return digest


def sealed_before(folder: Path, salt: str, cases: int) -> Truth | None:
    """The truth that a folder holds already; None if there is none.

    Raises:
        BadRequest: it is of another salt or number of cases, or is not what was sealed.
    """
    if not (folder / DIGEST).exists():
        return None
    truth = unsealed(folder)
    if (truth.salt, len(truth.cases)) != (salt, cases):
        raise BadRequest(
            f"out {folder}: holds {len(truth.cases)} cases"
            f"{'' if truth.salt == salt else ' of another seed'}; give their seed and number, or a new folder"
        )
    return truth


def sealed_digest(folder: Path) -> str:
    """The digest that was published; BadRequest if there is none."""
    try:
        return (folder / DIGEST).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadRequest(
            f"{folder}: has no {DIGEST}: this is no folder of blind cases; `marsarm gap blind make` makes one"
        ) from error


def unsealed(folder: Path) -> Truth:
    """The truth, if it is what was sealed.

    Raises:
        BadRequest: there is none, or it is another.
    """
    digest = sealed_digest(folder)
    try:
        raw = (folder / TRUTH).read_bytes()
    except OSError as error:
        raise BadRequest(
            f"{folder / TRUTH}: cannot be read ({error.strerror}); without it nothing can be scored"
        ) from error
    if hashlib.sha256(raw).hexdigest() != digest:
        raise BadRequest(
            f"{folder / TRUTH}: is not what was sealed: its SHA-256 is not that in {DIGEST}; "
            f"nothing is scored against a truth that was changed"
        )
    try:
        return _read(json.loads(raw))
    except (ValueError, KeyError, TypeError) as error:
        raise BadRequest(f"{folder / TRUTH}: was sealed, but is no truth ({error})") from error


def _read(said: dict[str, Any]) -> Truth:
    return Truth(
        said["salt"],
        tuple(
            TrueCase(
                case["name"],
                case["kind"],
                tuple(TrueEffect(**effect) for effect in case["effects"]),
                tuple(case["background"]),
                case["seed"],
            )
            for case in said["cases"]
        ),
    )
