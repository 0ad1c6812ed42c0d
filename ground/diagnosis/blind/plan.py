"""Which effects blind cases have, and how large: drawn from a seed before anything is recorded."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ground.diagnosis.blind.truth import Kind
from ground.diagnosis.drawn import Drawn, Seen, drawable, one_of, sized

SHARES: Final[dict[Kind, float]] = {"none": 0.3, "outside": 0.2, "pair": 0.2}
"""Of all cases; the others have one effect."""


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A case."""

    kind: Kind
    effects: tuple[Drawn, ...]


def planned(
    cases: int, catalogue: Sequence[Seen], outside: Sequence[Seen], rng: np.random.Generator
) -> tuple[Planned, ...]:
    """So many cases, in a random order.

    Effects are drawn first, then the place of each; of a pair both are of different classes.
    """
    known, unknown = ([one for one in some if drawable(one)] for some in (catalogue, outside))
    counts = {kind: round(share * cases) for kind, share in SHARES.items()}
    kinds: list[Kind] = [kind for kind, count in counts.items() for _ in range(count)]
    kinds += ["single"] * (cases - len(kinds))
    return tuple(Planned(kinds[k], _effects(kinds[k], known, unknown, rng)) for k in rng.permutation(cases))


def _effects(
    kind: Kind, known: list[Seen], unknown: list[Seen], rng: np.random.Generator
) -> tuple[Drawn, ...]:
    if kind == "none":
        return ()
    first = sized(one_of(unknown if kind == "outside" else known, rng), rng)
    if kind != "pair":
        return (first,)
    others = [one for one in known if one.label != first.seen.label]
    return first, sized(one_of(others, rng), rng)
