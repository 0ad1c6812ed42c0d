"""What data can tell apart, whatever was believed before: rank, conditioning, and the names behind them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags, Integers
from ground.calibration.fit import FitParameter, Linearisation

MIN_SIGMAS: Final = 10.0
"""A combination is seen if, moved by its scale, it shows so many sigma in all poses together."""
MIN_SHARE: Final = 0.02
"""A parameter is part of the unseen if that share of it, squared, is."""
MIN_CORRELATION: Final = 0.05
"""Two parameters are told apart if they are correlated by less than this within the unseen."""


@dataclass(frozen=True, slots=True)
class UnidentifiableGroup:
    """Parameters of which only some combinations are seen."""

    names: tuple[str, ...]
    identified: int
    """How many combinations of them are."""


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability:
    """What data tell of the parameters, without any prior."""

    parameters: tuple[FitParameter, ...]
    singular_values: Array
    """Of the whitened Jacobian with parameters in units of their scale, largest first, (p,)."""
    combinations: Array
    """A column for each: what is moved together, in units of the scales, (p, p)."""

    @property
    def rank(self) -> int:
        """How many combinations are seen."""
        return int(np.count_nonzero(self.singular_values > MIN_SIGMAS))

    @property
    def condition(self) -> float:
        """The best seen over the worst seen."""
        return float(self.singular_values[0] / self.singular_values[self.rank - 1]) if self.rank else np.inf

    def projected(self, values: Array) -> Array:
        """The seen combinations (rank, ...) of values (p, ...), in units of the scales."""
        scale = np.array([parameter.scale for parameter in self.parameters])
        within: Array = self.combinations[:, : self.rank].T @ (values.T / scale).T
        return within

    def unidentifiable_groups(self) -> tuple[UnidentifiableGroup, ...]:
        """Groups of parameters that are not told apart, or not seen at all; each parameter in one at most."""
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
    """What the poses used (n,), all if not given, tell."""
    jacobian = at.jacobian if used is None else at.jacobian[used]
    scale = np.array([parameter.scale for parameter in parameters])
    J = jacobian.reshape(-1, scale.size) * scale
    _, s, Vt = np.linalg.svd(J, full_matrices=True) if J.shape[0] < scale.size else _svd_of_tall(J)
    values = np.zeros(scale.size)
    values[: s.size] = s
    return Identifiability(tuple(parameters), values, Vt.T)


def _svd_of_tall(J: Array) -> tuple[Array, Array, Array]:
    # a triangle has the same singular values and directions, and there may be many thousands of rows
    U, s, Vt = np.linalg.svd(np.linalg.qr(J, mode="r"))
    return U, s, Vt


def _connected(members: Integers, linked: Flags) -> list[Integers]:
    """Members (k,) in groups that are linked, directly or through others; in order."""
    left, groups = list(members), []
    while left:
        group = [left.pop(0)]
        for one in group:
            near = [other for other in left if linked[one, other]]
            group += near
            left = [other for other in left if other not in near]
        groups.append(np.array(sorted(group)))
    return groups
