"""What data say, reduced to what fits need: one case, or many at once."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.layout import Evidence
from ground.diagnosis.prepared import Prepared


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """Data in the campaign's terms (see `prepared`)."""

    c: Array
    """[N S]'y of each block, (B, q + K)."""
    r: Array
    """What every fold says of the columns with nuisances free, (F, K)."""

    @property
    def all(self) -> Array:
        """What all blocks say, (K,)."""
        return np.asarray(self.r[-1])


def reduced(prepared: Prepared, y: Array) -> Case:
    """Of whitened features (m,)."""
    return of_sums(prepared, np.array([y[rows] @ prepared.A[rows] for rows in prepared.rows]))


def of_sums(prepared: Prepared, c: Array) -> Case:
    """Of sums over blocks (B, q + K)."""
    q, total = prepared.q, c.sum(axis=0)
    folds = np.concatenate([total - c, total[None]])
    r = folds[:, q:] - np.einsum("fkq,fq->fk", prepared.W, folds[:, :q])
    return Case(c, r)


def case_of(prepared: Prepared, evidence: Evidence) -> tuple[Case, Array]:
    """The case, and the whitened features (m,)."""
    y = prepared.whiten(evidence.value)
    return reduced(prepared, y), y
