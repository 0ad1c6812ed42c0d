"""Identifiability of parameters from data alone: rank, condition number and confounded parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.serial_arm.fit import FitParameter, Linearisation

MIN_SIGMAS: Final = 10.0
"""A combination is identified if a change by its scale shows this many sigmas in all poses together."""
MIN_SHARE: Final = 0.02
"""A parameter belongs to an unidentified combination if this squared share of it does."""
MIN_CORRELATION: Final = 0.05
"""Parameters belong to one group if they correlate by more than this within the unidentified subspace."""


@dataclass(frozen=True, slots=True)
class UnidentifiableGroup:
    """Parameters of which only some combinations are identified."""

    names: tuple[str, ...]
    identified: int
    """Number of identified combinations."""


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability:
    """Identified and unidentified combinations of parameters."""

    parameters: tuple[FitParameter, ...]
    singular_values: Array
    """Singular values of the whitened Jacobian in units of the scales, in descending order, shape (p,)."""
    combinations: Array
    """Right singular vectors in units of the scales, one in each column, shape (p, p)."""

    @property
    def rank(self) -> int:
        """Return the number of identified combinations."""
        return int(np.count_nonzero(self.singular_values > MIN_SIGMAS))

    @property
    def condition(self) -> float:
        """Return the condition number of the identified combinations."""
        return float(self.singular_values[0] / self.singular_values[self.rank - 1]) if self.rank else np.inf

    def unidentifiable_groups(self) -> tuple[UnidentifiableGroup, ...]:
        """Group the parameters that are confounded or have no effect; none is in two groups."""
        unseen = self.combinations[:, self.rank :]
        projector = unseen @ unseen.T
        share = np.diag(projector)
        part = np.flatnonzero(share > MIN_SHARE)
        together = np.abs(projector) > MIN_CORRELATION * np.sqrt(np.outer(share, share))
        groups = _connected(part, together)
        return tuple(self._group(group, projector) for group in groups)

    def _group(self, group: Integers, projector: Array) -> UnidentifiableGroup:
        unseen = round(float(np.trace(projector[np.ix_(group, group)])))
        return UnidentifiableGroup(tuple(self.parameters[k].name for k in group), group.size - unseen)


def assess_identifiability(
    parameters: Sequence[FitParameter], at: Linearisation, used: Flags | None = None
) -> Identifiability:
    """Assess which combinations of parameters some poses identify.

    Args:
        parameters: Parameters with their scales.
        at: Linearisation of all poses.
        used: Boolean flags of the poses to use, shape (n,); all by default.

    Returns:
        Singular values and combinations.
    """
    jacobian = at.jacobian if used is None else at.jacobian[used]
    scale = np.array([parameter.scale for parameter in parameters])
    J = jacobian.reshape(-1, scale.size) * scale
    _, s, Vt = np.linalg.svd(J, full_matrices=True) if J.shape[0] < scale.size else _svd_of_tall(J)
    values = np.zeros(scale.size)
    values[: s.size] = s
    return Identifiability(tuple(parameters), values, Vt.T)


def _svd_of_tall(J: Array) -> tuple[Array, Array, Array]:
    # R of the QR decomposition has the same singular values and directions, and far fewer rows
    U, s, Vt = np.linalg.svd(np.linalg.qr(J, mode="r"))
    return U, s, Vt


def _connected(members: Integers, linked: Flags) -> list[Integers]:
    """Return the connected components of the links among members (k,), in order."""
    remaining, groups = list(members), []
    while remaining:
        group = [remaining.pop(0)]
        for one in group:
            neighbours = [other for other in remaining if linked[one, other]]
            group += neighbours
            remaining = [other for other in remaining if other not in neighbours]
        groups.append(np.array(sorted(group)))
    return groups
