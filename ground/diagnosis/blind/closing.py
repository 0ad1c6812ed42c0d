"""How far what is said of a case closes its gap on held-out motion: one sum for all who say anything."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.blind.evidence import Part
from ground.diagnosis.closure import Closure, HeldOut, apart_from, closure
from ground.diagnosis.curved import Curved
from ground.diagnosis.hypothesis import Hypothesis
from ground.diagnosis.prepared import Prepared, prepare
from ground.diagnosis.refine import refine
from ground.diagnosis.sensitivity import Sensitivities

Change = Callable[[Sensitivities], Array]
"""What is said to have changed in the features, (m,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A case with its nuisances alone, ready for what is said of it."""

    fitted: Part
    held: Part
    prepared: Prepared
    """Of the fitted part."""
    apart: HeldOut

    def left(self, change: Change) -> tuple[Array, Array]:
        """Residuals (m,) of the fitted part, whitened, and of the held-out part, raw; nuisances refitted."""
        prepared = self.prepared
        rest = prepared.whiten(self.fitted.value - change(self.fitted.found))
        N = prepared.A[:, : prepared.q]
        v = prepared.C[-1] @ (N.T @ rest)
        return rest - N @ v, self.held.value - change(self.held.found) - self.apart.nuisance @ v

    def closed(self, change: Change, seed: int) -> Closure:
        """On held-out motion, against nuisances alone."""
        return closure(self.apart, self.left(nothing)[1], self.left(change)[1], seed)


def nothing(found: Sensitivities) -> Array:
    """No change."""
    return np.zeros(found.layout.size)


def tried(fitted: Part, held: Part) -> Tried:
    """ValueError if a motion is in both."""
    prepared = prepare(fitted.found)
    return Tried(fitted, held, prepared, apart_from(prepared, held.found))


def truth_closes(case: Tried, true: dict[Hypothesis, Array], seed: int) -> Closure:
    """What the true effects achieve, their sizes fitted from the true ones on, by the parabolas."""
    curved = Curved(case.fitted.found)
    whitened = case.prepared.whiten(case.fitted.value)
    best = refine(curved, case.prepared, whitened, true)
    said = dict(zip(best.hypotheses, best.values, strict=True))
    return case.closed(lambda found: Curved(found).change(said), seed)
