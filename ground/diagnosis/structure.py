"""Whether anything remains that no model explains: where, and on what it depends.

With y = N v + S t + e and the model fitted, what it leaves is M y with M = I - A (A'A + P)^-1 A', of
covariance M: then Q'M y of any directions Q is tested by a chi-square with covariance Q'M Q. The directions
are, in every channel and in every regime of it, a constant and the conditions. Beside them stands the energy
of the channel in that regime; and last, all directions of all channels together.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.fits import surprise
from ground.diagnosis.layout import Ints, Layout
from ground.diagnosis.model import Fitted, left
from ground.diagnosis.prepared import Prepared

FLAT: Final = 1e-6
"""Directions of less than this share of the largest are not among those tested."""
FEW: Final = 4
"""Features a group must have."""


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Features in which structure is looked for."""

    channel: int
    regime: int | None
    """None for all regimes together."""
    rows: Ints
    Q: Array
    """Directions, orthonormal, (n, d)."""
    AQ: Array
    """A'Q, (q + K, d)."""


@dataclass(frozen=True, slots=True)
class Remains:
    """Structure in one group."""

    surprise: float
    """-log10 of its probability if the model is right."""
    channel: str
    place: str
    regime: str
    """"all" if in all regimes together."""
    depends_on: str
    """The condition that it follows most; "nothing" for an offset, "noise" for energy without direction, and
    "several" of all groups together."""


def groups(prepared: Prepared) -> tuple[Group, ...]:
    """Of a campaign, before data."""
    layout = prepared.layout
    result = []
    for channel in np.unique(layout.channel):
        mine = layout.channel == channel
        regimes = np.unique(layout.regime[mine])
        for regime in [None, *(int(one) for one in regimes)] if regimes.size > 1 else [None]:
            rows = np.flatnonzero(mine if regime is None else mine & (layout.regime == regime))
            if rows.size >= FEW:
                U, s, _ = np.linalg.svd(_directions(layout, rows), full_matrices=False)
                Q = U[:, s > FLAT * s[0]]
                result.append(Group(int(channel), regime, rows, Q, prepared.A[rows].T @ Q))
    return tuple(result)


def remains(prepared: Prepared, looked: tuple[Group, ...], model: Fitted, y: Array) -> tuple[Remains, ...]:
    """What is left in every group, and in all of them together, most surprising first."""
    rest = left(prepared, model, y)
    total, freedom, found = 0.0, 0, []
    for group in looked:
        statistic, d = _chi_square(group, model, rest)
        whole = group.regime is None
        total, freedom = total + statistic * whole, freedom + d * whole
        energy, n = _energy(prepared, group, model, rest)
        of_direction, of_energy = (
            float(surprise(np.array(statistic), d)),
            float(surprise(np.array(energy), n)),
        )
        found.append((max(of_direction, of_energy), of_direction >= of_energy, group))
    together = float(surprise(np.array(total), max(freedom, 1)))
    result = [_told(prepared.layout, group, rest, high, led) for high, led, group in found]
    everywhere = Remains(together, "all", "all", "all", "several")
    return tuple(sorted([*result, everywhere], key=lambda one: -one.surprise))


def _directions(layout: Layout, rows: Ints) -> Array:
    """A constant and the conditions, each of norm 1 or 0, (n, 1 + c)."""
    centred = layout.condition[rows] - layout.condition[rows].mean(axis=0)
    all_of = np.column_stack([np.ones(rows.size), centred])
    norm = np.linalg.norm(all_of, axis=0)
    small = norm <= FLAT * np.maximum(np.linalg.norm(layout.condition, axis=0), 1.0).max()
    return np.asarray(all_of * np.where(small, 0.0, 1.0 / np.where(small, 1.0, norm)))


def _chi_square(group: Group, model: Fitted, rest: Array) -> tuple[float, int]:
    """Statistic and degrees of freedom of the directions of one group."""
    AQ = group.AQ[model.active]
    s, V = np.linalg.eigh(np.eye(group.Q.shape[1]) - AQ.T @ model.covariance @ AQ)
    told = s > FLAT
    along = V[:, told].T @ (group.Q.T @ rest[group.rows])
    return float(np.sum(along**2 / s[told])), int(told.sum())


def _energy(prepared: Prepared, group: Group, model: Fitted, rest: Array) -> tuple[float, float]:
    """Sum of squares in one group, and what it is expected to be."""
    A = prepared.A[np.ix_(group.rows, model.active)]
    expected = group.rows.size - float(np.sum((A @ model.covariance) * A))
    return float(np.sum(rest[group.rows] ** 2)), max(expected, 1.0)


def _told(layout: Layout, group: Group, rest: Array, high: float, led: bool) -> Remains:
    """In words."""
    along = np.abs(_directions(layout, group.rows).T @ rest[group.rows])
    names = ("nothing", *layout.conditions)
    places = np.bincount(layout.place[group.rows])
    return Remains(
        high, layout.channels[group.channel], layout.places[int(np.argmax(places))],
        "all" if group.regime is None else layout.regimes[group.regime],
        names[int(np.argmax(along))] if led else "noise",
    )  # fmt: skip
