"""Sensitivities of the features to every hypothesis and nuisance: computed once for a campaign, and cached.

Near its nominal state the simulator f is approximated for amplitudes a in typical sizes and nuisances v by

    f(a, v) = f(0, 0) + S a + Q a^2 + N v

with the square taken of each amplitude.
"""

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, cast
from zipfile import BadZipFile

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.problem import EffectValues, FeatureLayout, Hypothesis, Ints, Nuisance
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write
from simgap.selection.checkpoint import pack, unpack

_READ_ERRORS: Final = (OSError, EOFError, BadZipFile, zlib.error, RuntimeError, ValueError, KeyError)
"""Errors of a damaged archive; zipfile raises RuntimeError for unknown compression."""
ROUNDING: Final = 1e-9
"""Greatest relative difference of two columns that come from the same simulated change."""


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """First and second derivatives of the simulator at its nominal state."""

    layout: FeatureLayout
    hypotheses: tuple[Hypothesis, ...]
    nuisances: tuple[Nuisance, ...]
    effect: Array
    """Change per typical size of each amplitude parameter, in the order of `owner`, shape (m, k)."""
    curve: Array
    """Change per squared typical size: parabola through nominal and the simulated steps, shape (m, k)."""
    reach: Array
    """Largest simulated departure in typical sizes, shape (k,)."""
    owner: Ints
    """Index of the hypothesis that each column belongs to, ascending, shape (k,)."""
    nuisance: Array
    """Change per unit of each nuisance, shape (m, q)."""

    def __post_init__(self) -> None:
        if not all(np.all(np.isfinite(one)) for one in (self.effect, self.curve, self.reach, self.nuisance)):
            raise ValueError("sensitivities must be finite")

    @property
    def shared_nuisances(self) -> list[int]:
        """Indices of the nuisances with one value in all blocks."""
        return [index for index, nuisance in enumerate(self.nuisances) if not nuisance.random_per_block]

    def index(self, key: str) -> int:
        """Return the index of the hypothesis with this key."""
        return next(k for k, one in enumerate(self.hypotheses) if one.key == key)

    def change(self, settings: EffectValues) -> Array:
        """Compute the change (m,) by effects: parabolas, linear beyond the simulated departures.

        Args:
            settings: Values of all parameters of each effect in their units, shape (p,). Shape parameters
                have no influence.
        """
        total = np.zeros(self.layout.size)
        for hypothesis, values in settings.items():
            columns = np.flatnonzero(self.owner == self.hypotheses.index(hypothesis))
            total += self._change(columns, hypothesis.departures(values))
        return total

    def _change(self, columns: Ints, a: Array) -> Array:
        return continue_parabola(self.effect[:, columns], self.curve[:, columns], self.reach[columns], a)

    def with_simulated(self, hypothesis: int, a: Array, change: Array) -> "Sensitivities":
        """Return the sensitivities with the parabola of one hypothesis through a simulated change.

        The slopes stay. The curvature of its largest amplitude takes what they miss. A nuisance of the same
        parameter, whose column is parallel, gets the slope of the parabola there.

        Args:
            hypothesis: Index of the hypothesis, with n amplitudes.
            a: Departures in typical sizes, without a unit, shape (n,), not all 0.
            change: Simulated change there in the units of the channels, shape (m,).
        """
        columns = np.flatnonzero(self.owner == hypothesis)
        curve, reach = self.curve.copy(), self.reach.copy()
        reach[columns] = np.maximum(reach[columns], np.abs(a))
        largest = int(np.argmax(np.abs(a)))
        curve[:, columns[largest]] = 0.0
        missed = change - self.effect[:, columns] @ a - curve[:, columns] @ a**2
        curve[:, columns[largest]] = missed / a[largest] ** 2
        slope = self.effect[:, columns[largest]]
        turn = 2.0 * curve[:, columns[largest]] * a[largest]
        shares = slope @ self.nuisance / max(float(slope @ slope), float(np.finfo(float).tiny))
        beside = np.abs(self.nuisance - np.outer(slope, shares)).max(axis=0)
        is_parallel = beside <= ROUNDING * np.abs(self.nuisance).max(axis=0)
        nuisance = self.nuisance + np.outer(turn, np.where(is_parallel, shares, 0.0))
        return replace(self, curve=curve, reach=reach, nuisance=nuisance)

    def linearised(self, hypothesis: int, a: Array) -> "Sensitivities":
        """Return the sensitivities with those of one hypothesis linearised at an estimate.

        The column of its largest amplitude makes the whole change there, beside the slopes of the others.

        Args:
            hypothesis: Index of the hypothesis, with n amplitudes.
            a: Departures of the estimate in typical sizes, without a unit, shape (n,), not all 0.
        """
        columns = np.flatnonzero(self.owner == hypothesis)
        inside = np.clip(a, -self.reach[columns], self.reach[columns])
        effect, curve = self.effect.copy(), self.curve.copy()
        change = self._change(columns, a)
        effect[:, columns] += 2.0 * curve[:, columns] * inside
        largest = int(np.argmax(np.abs(a)))
        others = np.delete(np.arange(columns.size), largest)
        effect[:, columns[largest]] = (change - effect[:, columns[others]] @ a[others]) / a[largest]
        curve[:, columns] = 0.0
        return replace(self, effect=effect, curve=curve)

    def select(self, rows: Ints) -> "Sensitivities":
        """Return the sensitivities of some features, in that order."""
        arrays = ("effect", "curve", "nuisance")
        return replace(
            self, layout=self.layout.select(rows), **{name: getattr(self, name)[rows] for name in arrays}
        )


def save_sensitivities(path: Path, found: Sensitivities) -> None:
    """Save sensitivities to an .npz file without pickled objects; BadOutput if it cannot be written."""
    arrays: list[Array] = []
    document = json.dumps(pack(found, arrays))
    with atomic_write(path, "sensitivities") as file:
        np.savez(file, *arrays, document=np.array(document))


def load_sensitivities(path: Path) -> Sensitivities:
    """Load sensitivities; BadRequest if the file is incomplete, damaged, or holds something else."""
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = [file[f"arr_{k}"] for k in range(len(file.files) - 1)]
            return cast("Sensitivities", unpack(json.loads(str(file["document"])), arrays, {}, "marsarm"))
    except _READ_ERRORS as error:
        raise BadRequest(
            f"{path}: no sensitivities ({error}); remove it, and they are computed anew"
        ) from error


def continue_parabola(effect: Array, curve: Array, reach: Array, a: Array) -> Array:
    """Compute changes (m,) or (n, m): parabolas up to their reach, and straight on beyond.

    Args:
        effect: First derivatives of the features, shape (m, k).
        curve: Second-order coefficients, shape (m, k).
        reach: Largest simulated departures, without a unit (typical sizes), shape (k,).
        a: Departures, without a unit (typical sizes), shape (k,), or of n candidates, shape (n, k).
    """
    inside = np.clip(a, -reach, reach)
    return np.asarray(a @ effect.T + (inside * (2.0 * a - inside)) @ curve.T)


def fit_parabola(ends: Sequence[tuple[Array, float]]) -> tuple[Array, Array]:
    """Fit slope and curvature (m,) at 0 through 0 and two points; through one point, a line.

    Args:
        ends: One or two simulated changes of the features in the units of their channels, shape (m,),
            each with its step.
    """
    (high, up), (low, down) = ends[0], ends[-1]
    curvature = np.zeros_like(high) if up == down else (high / up - low / down) / (up - down)
    return high / up - curvature * up, curvature
