"""A diagnosis tried on motions that took no part in it."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.closure import Closure, HeldOut, closure
from ground.diagnosis.diagnose import Diagnosis
from ground.diagnosis.hypothesis import Hypothesis


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """What is left on held-out motion without the findings and with them, (m,) in the channels' units."""

    apart: HeldOut
    before: Array
    after: Array

    def closure(self, seed: int) -> Closure:
        """How far the gap shrinks."""
        return closure(self.apart, self.before, self.after, seed)


def left_on(diagnosis: Diagnosis, apart: HeldOut, gap: Array, change: Array) -> Left:
    """Nuisances as fitted elsewhere are taken off, and what the findings change.

    `gap` (m,) is measured less simulated with nuisances at 0; `change` (m,) is by the simulator.
    """
    q = diagnosis.prepared.q
    before, after = (gap - apart.nuisance @ fit.theta[:q] for fit in (diagnosis.without, diagnosis.best))
    return Left(apart, np.asarray(before), np.asarray(after - change))


def settings_of(diagnosis: Diagnosis) -> dict[Hypothesis, Array]:
    """The findings as a simulator takes them."""
    hypotheses = diagnosis.prepared.hypotheses
    return {hypotheses[finding.hypothesis]: finding.values for finding in diagnosis.findings}
