"""Blind cases: planned from a seed, sealed by a digest, and loaded for scoring.

`plan_cases` draws the effects of all cases before anything is recorded. `seal` writes the truth and its
SHA-256. `load_truth` refuses a truth that does not match that digest.
"""

import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError

from marsarm.diagnosis.sampling import (
    DetectableEffect,
    SampledEffect,
    can_sample,
    sample_amplitude,
    sample_effect,
)
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write
from simgap.common.toml import describe_first_problem

CaseKind = Literal["none", "single", "pair", "out-of-catalogue"]
TRUTH: Final = "truth.json"
DIGEST: Final = "digest.txt"
KIND_SHARES: Final[dict[CaseKind, float]] = {"none": 0.25, "out-of-catalogue": 0.35, "pair": 0.15}
"""Shares of all cases; the others have one effect of the catalogue."""
EFFECTS_OF_KIND: Final[dict[CaseKind, int]] = {"none": 0, "single": 1, "pair": 2, "out-of-catalogue": 1}
CASE_NAME: Final = re.compile(r"case-\d{3,}")


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """Effect that is switched on in a blind case."""

    name: str
    place: str
    values: dict[str, float]
    """Values of all its parameters by name, in the units of the diagnosis."""
    times_limit: float
    """Amplitude as a multiple of the detection limit; of the typical size outside the catalogue."""
    spec: str
    """Text that switches the effect on in the plant."""


@dataclass(frozen=True, slots=True)
class TrueCase:
    """Blind case: its effects, the `background` of every arm, and the seed of the sensor noise."""

    name: str
    kind: CaseKind
    effects: tuple[TrueEffect, ...]
    background: tuple[str, ...]
    seed: int


@dataclass(frozen=True, slots=True)
class SealedTruth:
    """Truth of all cases; without the seed, the salt prevents that the digest confirms a guess."""

    salt: str
    cases: tuple[TrueCase, ...]

    def text(self) -> str:
        """Return the text of the truth file."""
        return json.dumps(asdict(self), indent=1, sort_keys=True) + "\n"

    def digest(self) -> str:
        """Return the SHA-256 of that text."""
        return hashlib.sha256(self.text().encode()).hexdigest()


_TRUTH_ADAPTER: Final = TypeAdapter(SealedTruth)


def seal(folder: Path, truth: SealedTruth) -> str:
    """Write truth and digest; return the digest.

    Raises:
        BadOutput: A file cannot be written.
    """
    digest = truth.digest()
    for name, text in ((TRUTH, truth.text()), (DIGEST, digest + "\n")):
        with atomic_write(folder / name, "out") as file:
            file.write(text.encode())
    return digest


def load_existing_truth(folder: Path, salt: str, cases: int) -> SealedTruth | None:
    """Load the truth of a folder; None if the folder has none.

    Raises:
        BadRequest: The truth has another salt or number of cases, or does not match its digest.
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
    """Read the published digest; BadRequest if there is none."""
    try:
        return (folder / DIGEST).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadRequest(
            f"{folder}: has no {DIGEST}: this is no folder of blind cases; "
            "`python -m validation.blind make` makes one"
        ) from error


def load_truth(folder: Path) -> SealedTruth:
    """Load the truth if it matches its digest.

    Raises:
        BadRequest: There is no truth, or it does not match.
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
        truth = _TRUTH_ADAPTER.validate_json(raw)
    except ValidationError as error:
        raise BadRequest(
            f"{folder / TRUTH}: was sealed, but is no truth ({describe_first_problem(error)})"
        ) from error
    if contradiction := next(_find_contradictions(truth.cases), None):
        raise BadRequest(f"{folder / TRUTH}: was sealed, but is no truth ({contradiction})")
    return truth


def _find_contradictions(cases: Sequence[TrueCase]) -> Iterator[str]:
    """Yield how cases contradict their kind or themselves, and which come twice."""
    if not cases:
        yield "it has no case"
    if len({case.name for case in cases}) < len(cases):
        yield "two cases have one name"
    for case in cases:
        if CASE_NAME.fullmatch(case.name) is None:
            yield f"{case.name!r} is no name of a case; case-000 is one"
        if len(case.effects) != EFFECTS_OF_KIND[case.kind]:
            yield f"{case.name}: {len(case.effects)} effects do not make it {case.kind!r}"
        if len({(effect.name, effect.place) for effect in case.effects}) < len(case.effects):
            yield f"{case.name}: the same effect comes twice"
        for effect in case.effects:
            numbers = [*effect.values.values(), effect.times_limit]
            if not np.all(np.isfinite(numbers)) or effect.times_limit <= 0.0:
                yield f"{case.name}: {effect.name} has a size that no effect can have"


@dataclass(frozen=True, slots=True, eq=False)
class PlannedCase:
    """Kind and sampled effects of a case."""

    kind: CaseKind
    effects: tuple[SampledEffect, ...]


def plan_cases(
    cases: int,
    catalogue: Sequence[DetectableEffect],
    outside: Sequence[DetectableEffect],
    rng: np.random.Generator,
) -> tuple[PlannedCase, ...]:
    """Plan blind cases in random order.

    Effects are sampled first, then the place of each. The two effects of a pair have different classes.
    Effects outside the catalogue are dealt: none comes again before all have come. Where there are none of
    them, their cases have no effect.

    Args:
        cases: Number of cases.
        outside: Effects outside the catalogue.
    """
    known, unknown = ([one for one in some if can_sample(one)] for some in (catalogue, outside))
    counts = {kind: round(share * cases) for kind, share in KIND_SHARES.items()}
    if not unknown:
        counts["none"] += counts.pop("out-of-catalogue")
    kinds: list[CaseKind] = [kind for kind, count in counts.items() for _ in range(count)]
    kinds += ["single"] * (cases - len(kinds))
    deck = _deal_effects(unknown, kinds.count("out-of-catalogue"), rng)
    return tuple(
        PlannedCase(kinds[k], _sample_effects(kinds[k], known, deck, rng)) for k in rng.permutation(cases)
    )


def _deal_effects(
    some: Sequence[DetectableEffect], count: int, rng: np.random.Generator
) -> Iterator[DetectableEffect]:
    """Yield so many effects, each at a random place; two effects differ by one case at most."""
    names = sorted({one.hypothesis.effect for one in some})
    rounds = -(-count // max(len(names), 1))
    dealt = [names[k] for _ in range(rounds) for k in rng.permutation(len(names))]
    for name in dealt[:count]:
        yield sample_effect([one for one in some if one.hypothesis.effect == name], rng)


def _sample_effects(
    kind: CaseKind,
    known: Sequence[DetectableEffect],
    unknown: Iterator[DetectableEffect],
    rng: np.random.Generator,
) -> tuple[SampledEffect, ...]:
    if kind == "none":
        return ()
    first = sample_amplitude(next(unknown) if kind == "out-of-catalogue" else sample_effect(known, rng), rng)
    if kind != "pair":
        return (first,)
    others = [one for one in known if one.label != first.source.label]
    return first, sample_amplitude(sample_effect(others, rng), rng)
