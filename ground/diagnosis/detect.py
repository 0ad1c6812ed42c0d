"""How large an effect must be to be seen in a campaign: known before data."""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from fsw.kinematics.transforms import Array
from ground.diagnosis.prepared import ABSORBED, Prepared

FALSE_ALARM: Final = 0.05
POWER: Final = 0.9


@dataclass(frozen=True, slots=True)
class Detectability:
    """What a campaign can see of one hypothesis."""

    limit: float
    """In typical sizes, all size parameters growing together; infinite if it is not seen."""
    blocks: float
    """In how many blocks, effectively, it is seen: below 2 it cannot be cross-validated."""


@cache
def noncentrality(k: int, power: float = POWER, false_alarm: float = FALSE_ALARM) -> float:
    """Of a chi-square of k degrees, so that a test of this false alarm has this power."""
    beyond = chi2.isf(false_alarm, k)
    return float(brentq(lambda n: ncx2.sf(beyond, k, n) - power, 1e-6, 1e3))


def detectability(prepared: Prepared) -> tuple[Detectability, ...]:
    """Of every hypothesis: the size that a likelihood-ratio test against no effect finds with 90 % power.

    At 5 % false alarm, nuisances free. Its statistic is a noncentral chi-square of k degrees with
    noncentrality d'R d for sizes d; typical sizes make d = limit * scale. Blocks seen is the inverse of the
    sum of squared shares of the information that is lost when a block is left out.
    """
    result = []
    lost = prepared.R[-1] - prepared.R[:-1]
    for index, seen in enumerate(prepared.seen):
        at = np.flatnonzero(prepared.owner == index)
        typical = prepared.scale[at]
        information = float(typical @ prepared.R[-1][np.ix_(at, at)] @ typical)
        if not seen or information <= 0.0:
            result.append(Detectability(np.inf, 0.0))
            continue
        share = np.maximum(np.einsum("i,bij,j->b", typical, lost[:, at[:, None], at], typical), 0.0)
        blocks = float(share.sum() ** 2 / np.sum(share**2))
        result.append(Detectability(float(np.sqrt(noncentrality(at.size) / information)), blocks))
    return tuple(result)


def limit_beside(prepared: Prepared, columns: Array) -> float:
    """The same limit of what is no hypothesis: its change of the features (m, k) per typical size."""
    S, N = prepared.whiten(columns), prepared.A[:, : prepared.q]
    whole = S.sum(axis=1)
    along = N.T @ whole
    before = float(whole @ whole)
    information = before - float(along @ prepared.C[-1] @ along)
    if information <= ABSORBED * before:
        return np.inf
    return float(np.sqrt(noncentrality(columns.shape[1]) / information))
