"""Sealed truth of the cases: its digest is published before a case is recorded.

The truth lies in a folder of its own. `solve` gets the folder of the cases and never opens that one.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from marsarm.diagnosis.blind_case import DIGEST, TRUTH, read_digest
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write
from simgap.common.toml import describe_first_problem
from validation.robot_cases.draw import Kind, Truth

SEALED_FOLDER: Final = "sealed"
KIND_SHARES: Final[dict[Kind, float]] = {"none": 0.3, "single": 0.3, "pair": 0.2, "outside": 0.2}
"""Shares of all cases: 36, 36, 24 and 24 of 120."""
TUNING_SEEDS: Final = 1000
"""Seeds of cases below this are for tuning."""


@dataclass(frozen=True, slots=True)
class PlannedCase:
    """Case before its effects are drawn."""

    name: str
    seed: int
    kind: Kind
    model: str


@dataclass(frozen=True, slots=True)
class SealedCase:
    """Case with its truth, and the hypotheses that no data separate from each of its effects."""

    name: str
    truth: Truth
    equivalents: tuple[tuple[tuple[str, str], ...], ...]
    """For each effect: names with places."""


@dataclass(frozen=True, slots=True)
class SealedTruth:
    """Truth of all cases; the salt prevents that a guessed truth is confirmed by the digest."""

    salt: str
    cases: tuple[SealedCase, ...]

    def text(self) -> str:
        """Return the text of the truth file."""
        return json.dumps(asdict(self), indent=1, sort_keys=True) + "\n"

    def digest(self) -> str:
        """Return the SHA-256 of that text."""
        return hashlib.sha256(self.text().encode()).hexdigest()


_ADAPTER: Final = TypeAdapter(SealedTruth)


def plan_cases(count: int, seed: int, models: tuple[str, ...]) -> tuple[PlannedCase, ...]:
    """Plan the kinds and the models of cases, in random order; each kind has each model equally often."""
    counts = {kind: round(share * count) for kind, share in KIND_SHARES.items()}
    counts["single"] += count - sum(counts.values())
    pairs = [(kind, models[k % len(models)]) for kind, many in counts.items() for k in range(many)]
    order = np.random.default_rng([seed, 4]).permutation(count)
    return tuple(
        PlannedCase(f"case-{number:03d}", TUNING_SEEDS * seed + number, *pairs[k])
        for number, k in enumerate(order)
    )


def salt(seed: int) -> str:
    """Return the salt of a seed; it does not reveal the seed."""
    return np.random.default_rng([seed, 9]).bytes(16).hex()


def seal(folder: Path, truth: SealedTruth) -> str:
    """Write the truth in its folder and the digest beside it; return the digest."""
    digest = truth.digest()
    (folder / SEALED_FOLDER).mkdir(parents=True, exist_ok=True)
    for path, text in ((folder / SEALED_FOLDER / TRUTH, truth.text()), (folder / DIGEST, digest + "\n")):
        with atomic_write(path, "out") as file:
            file.write(text.encode())
    return digest


def load_truth(folder: Path) -> SealedTruth:
    """Load the truth if it matches its digest.

    Raises:
        BadRequest: There is no truth, or it is not what was sealed.
    """
    path, digest = folder / SEALED_FOLDER / TRUTH, read_digest(folder)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BadRequest(
            f"{path}: cannot be read ({error.strerror}); without it nothing is scored"
        ) from error
    if hashlib.sha256(raw).hexdigest() != digest:
        raise BadRequest(f"{path}: is not what was sealed: its SHA-256 is not that in {DIGEST}")
    try:
        return _ADAPTER.validate_json(raw)
    except ValidationError as error:
        raise BadRequest(f"{path}: was sealed, but is no truth ({describe_first_problem(error)})") from error
