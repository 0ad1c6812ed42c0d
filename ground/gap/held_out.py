"""A diagnosis tried on motions that took no part in it."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.closure import Closure, check_apart, closure, unsure
from ground.gap.diagnose import Diagnosis
from ground.gap.hypothesis import Hypothesis
from ground.gap.layout import Evidence
from ground.gap.sensitivity import Sensitivities
from ground.gap.whiten import whitener


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """What is left on held-out motion without the findings and with them, in the channels' units."""

    found: Sensitivities
    before: Array
    after: Array
    unsure: Array
    """Variance, in that of the floor, that nuisances leave here, (m,)."""

    @property
    def sigma(self) -> Array:
        """The floor and what nuisances leave, (m,)."""
        return np.asarray(self.found.layout.sigma * np.sqrt(1.0 + self.unsure))

    def closure(self, seed: int) -> Closure:
        """How far the gap shrinks."""
        whiten, raw = whitener(self.found), (self.before, self.after)
        return closure(self.found.layout, (whiten(self.before), whiten(self.after)), raw, seed, self.unsure)


def left_on(diagnosis: Diagnosis, evidence: Evidence, found: Sensitivities, change: Array) -> Left:
    """Nuisances as fitted elsewhere, taken off `evidence`, and with the findings what they change.

    `found` are the sensitivities of the held-out motions, `change` what the findings change there (m,), by
    the simulator. Raises ValueError if a block took part in the diagnosis, or nuisances are others.
    """
    check_apart(diagnosis.prepared.layout, evidence.layout)
    q = diagnosis.prepared.q
    if len(found.lasting) != q:
        raise ValueError("held-out motion must have the nuisances of the campaign")
    before, after = (
        evidence.value - found.nuisance[:, found.lasting] @ (fit.theta[:q] * diagnosis.prepared.nuisance_unit)
        for fit in (diagnosis.without, diagnosis.best)
    )
    return Left(found, before, after - change, unsure(diagnosis.prepared, found))


def closed(
    diagnosis: Diagnosis, evidence: Evidence, found: Sensitivities, change: Array, seed: int
) -> Closure:
    """How far the findings close the gap in `evidence`; arguments and errors as of `left_on`."""
    return left_on(diagnosis, evidence, found, change).closure(seed)


def settings_of(diagnosis: Diagnosis) -> dict[Hypothesis, Array]:
    """The findings as a simulator takes them."""
    hypotheses = diagnosis.prepared.hypotheses
    return {hypotheses[finding.hypothesis]: finding.values for finding in diagnosis.findings}
