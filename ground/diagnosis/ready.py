"""A campaign ready for cases: everything that is fixed, and can be published, before data."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.classes import alike, classes
from ground.diagnosis.detect import Detectability, detectability
from ground.diagnosis.layout import Ints
from ground.diagnosis.prepared import Prepared, prepare
from ground.diagnosis.race import Field
from ground.diagnosis.sensitivity import Sensitivities
from ground.diagnosis.structure import Group, groups
from ground.diagnosis.thresholds import CASES, Thresholds, calibrate


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """What does not depend on data."""

    found: Sensitivities
    prepared: Prepared
    cosine: Array
    """|cos| between hypotheses, (H, H)."""
    label: Ints
    """Equivalence class of every hypothesis, (H,)."""
    limits: tuple[Detectability, ...]
    looked: tuple[Group, ...]
    thresholds: Thresholds

    @property
    def field(self) -> Field:
        """All hypotheses that are seen."""
        return Field(self.prepared, self.label, self.thresholds.effect, self.prepared.seen)

    def confusable(self, hypothesis: int) -> tuple[int, ...]:
        """Its class, itself included."""
        return tuple(int(one) for one in np.flatnonzero(self.label == self.label[hypothesis]))


def ready(
    found: Sensitivities,
    seed: int,
    cases: int = CASES,
    thresholds: Thresholds | None = None,
    step: Callable[[int, int], None] = lambda *_: None,
) -> Ready:
    """Of a campaign's sensitivities; without thresholds they are calibrated with `cases` simulated cases."""
    prepared = prepare(found)
    cosine, label, limits, looked = (
        alike(prepared),
        classes(prepared),
        detectability(prepared),
        groups(prepared),
    )
    kept = thresholds or calibrate(prepared, label, cosine, limits, looked, seed, cases, step)
    return Ready(found, prepared, cosine, label, limits, looked, kept)
