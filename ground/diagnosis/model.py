"""The best model of a case: chosen effects and nuisances together, and what it leaves."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.case import Case
from ground.diagnosis.layout import Ints
from ground.diagnosis.prepared import Prepared


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Nuisances and chosen columns, fitted together to all blocks."""

    active: Ints
    """Columns of `Prepared.A` that are in it: all nuisances, then the chosen, (n,)."""
    theta: Array
    """Their sizes, (n,)."""
    covariance: Array
    """(n, n)."""


def fitted(prepared: Prepared, case: Case, columns: Ints) -> Fitted:
    """The most probable nuisances and sizes; singular combinations stay at 0."""
    active = np.concatenate([np.arange(prepared.q), prepared.q + columns])
    information = prepared.G[:, active[:, None], active].sum(axis=0)
    information[: prepared.q, : prepared.q] += np.diag(prepared.prior)
    covariance = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
    return Fitted(active, covariance @ case.c[:, active].sum(axis=0), covariance)


def left(prepared: Prepared, model: Fitted, y: Array) -> Array:
    """Whitened residual after the model, (m,)."""
    return np.asarray(y - prepared.A[:, model.active] @ model.theta)
