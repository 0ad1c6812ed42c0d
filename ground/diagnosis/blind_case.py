"""Which effects blind cases have, and how large: drawn from a seed before anything is recorded."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from ground.common.files import atomic_write
from ground.common.requests import BadRequest
from ground.diagnosis.sampling import (
    DetectableEffect,
    SampledEffect,
    can_sample,
    sample_amplitude,
    sample_effect,
)

CaseKind = Literal["none", "single", "pair", "outside"]
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
    kind: CaseKind
    effects: tuple[TrueEffect, ...]
    background: tuple[str, ...]
    seed: int


@dataclass(frozen=True, slots=True)
class SealedTruth:
    """All cases; without the salt nobody can try whether a truth that he thinks of has this digest."""

    salt: str
    cases: tuple[TrueCase, ...]

    def text(self) -> str:
        """As it is written."""
        return json.dumps(asdict(self), indent=1, sort_keys=True) + "\n"

    def digest(self) -> str:
        """SHA-256 of that."""
        return hashlib.sha256(self.text().encode()).hexdigest()


def seal(folder: Path, truth: SealedTruth) -> str:
    """Write truth and digest; the digest. BadOutput if a file cannot be written."""
    digest = truth.digest()
    for name, text in ((TRUTH, truth.text()), (DIGEST, digest + "\n")):
        with atomic_write(folder / name, "out") as file:
            file.write(text.encode())
    return digest


def load_existing_truth(folder: Path, salt: str, cases: int) -> SealedTruth | None:
    """The truth that a folder holds already; None if there is none.

    Raises:
        BadRequest: it is of another salt or number of cases, or is not what was sealed.
    """
    if not (folder / DIGEST).exists():
        return None
    truth = load_truth(folder)
    if (truth.salt, len(truth.cases)) != (salt, cases):
        raise BadRequest(
            f"out {folder}: holds {len(truth.cases)} cases"
            f"{'' if truth.salt == salt else ' of another seed'}; give their seed and number, or a new folder"
        )
    return truth


def read_digest(folder: Path) -> str:
    """The digest that was published; BadRequest if there is none."""
    try:
        return (folder / DIGEST).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadRequest(
            f"{folder}: has no {DIGEST}: this is no folder of blind cases; "
            "`python -m validation.blind make` makes one"
        ) from error


def load_truth(folder: Path) -> SealedTruth:
    """The truth, if it is what was sealed.

    Raises:
        BadRequest: there is none, or it is another.
    """
    digest = read_digest(folder)
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
        return _parse_truth(json.loads(raw))
    except (ValueError, KeyError, TypeError) as error:
        raise BadRequest(f"{folder / TRUTH}: was sealed, but is no truth ({error})") from error


def _parse_truth(said: dict[str, Any]) -> SealedTruth:
    return SealedTruth(
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


KIND_SHARES: Final[dict[CaseKind, float]] = {"none": 0.3, "outside": 0.2, "pair": 0.2}
"""Of all cases; the others have one effect."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedCase:
    """A case."""

    kind: CaseKind
    effects: tuple[SampledEffect, ...]


def plan_cases(
    cases: int,
    catalogue: Sequence[DetectableEffect],
    outside: Sequence[DetectableEffect],
    rng: np.random.Generator,
) -> tuple[PlannedCase, ...]:
    """So many cases, in a random order.

    Effects are drawn first, then the place of each; of a pair both are of different classes.
    """
    known, unknown = ([one for one in some if can_sample(one)] for some in (catalogue, outside))
    counts = {kind: round(share * cases) for kind, share in KIND_SHARES.items()}
    kinds: list[CaseKind] = [kind for kind, count in counts.items() for _ in range(count)]
    kinds += ["single"] * (cases - len(kinds))
    return tuple(
        PlannedCase(kinds[k], _sample_effects(kinds[k], known, unknown, rng)) for k in rng.permutation(cases)
    )


def _sample_effects(
    kind: CaseKind, known: list[DetectableEffect], unknown: list[DetectableEffect], rng: np.random.Generator
) -> tuple[SampledEffect, ...]:
    if kind == "none":
        return ()
    first = sample_amplitude(sample_effect(unknown if kind == "outside" else known, rng), rng)
    if kind != "pair":
        return (first,)
    others = [one for one in known if one.label != first.source.label]
    return first, sample_amplitude(sample_effect(others, rng), rng)
