"""Sensitivities of the features to every hypothesis and nuisance: computed once for a campaign, and cached.

Near its nominal state the simulator f is approximated for amplitudes a in typical sizes and nuisances v by

    f(a, v) = f(0, 0) + S a + Q a^2 + N v

with the square taken of each amplitude.
"""

import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
from pydantic import TypeAdapter

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.problem import EffectValues, FeatureLayout, Hypothesis, Ints, Nuisance
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write

_READ_ERRORS: Final = (OSError, EOFError, BadZipFile, zlib.error, RuntimeError, ValueError, KeyError)
"""Errors of a damaged archive; zipfile raises RuntimeError for unknown compression."""
_LAYOUT_ARRAYS: Final = ("sigma", "block", "channel", "place", "regime", "condition")
_LAYOUT_NAMES: Final = ("blocks", "channels", "units", "places", "regimes", "conditions", "keys")
_OWN_ARRAYS: Final = ("effect", "curve", "reach", "owner", "nuisance")
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
        m, wanted = self.layout.size, [len(hypothesis.parameters) for hypothesis in self.hypotheses]
        if not np.array_equal(self.owner, np.repeat(np.arange(len(wanted)), wanted)):
            raise ValueError("owner must list every size parameter of every hypothesis in order")
        shapes = (
            (self.effect, (m, sum(wanted))),
            (self.curve, (m, sum(wanted))),
            (self.reach, (sum(wanted),)),
            (self.nuisance, (m, len(self.nuisances))),
        )
        for array, shape in shapes:
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise ValueError(f"sensitivities must be finite and {shape}; one is {array.shape}")

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

    def only(self, effects: Collection[str]) -> "Sensitivities":
        """Return the sensitivities for the hypotheses of some effects; the nuisances stay."""
        chosen = [k for k, hypothesis in enumerate(self.hypotheses) if hypothesis.effect in effects]
        columns = np.flatnonzero(np.isin(self.owner, chosen))
        hypotheses = tuple(self.hypotheses[k] for k in chosen)
        owner = np.repeat(np.arange(len(chosen)), [len(hypothesis.parameters) for hypothesis in hypotheses])
        parts = {name: getattr(self, name)[:, columns] for name in ("effect", "curve")}
        return replace(self, hypotheses=hypotheses, owner=owner, reach=self.reach[columns], **parts)

    def select(self, rows: Ints) -> "Sensitivities":
        """Return the sensitivities of some features, in that order."""
        arrays = ("effect", "curve", "nuisance")
        return replace(
            self, layout=self.layout.select(rows), **{name: getattr(self, name)[rows] for name in arrays}
        )


@dataclass(frozen=True, slots=True)
class _Words:
    """All of some sensitivities that is no array."""

    hypotheses: tuple[Hypothesis, ...]
    nuisances: tuple[Nuisance, ...]
    names: dict[str, tuple[str, ...]]


_WORDS: Final = TypeAdapter(_Words)


def save_sensitivities(path: Path, found: Sensitivities) -> None:
    """Save sensitivities to an .npz file without pickled objects; BadOutput if it cannot be written."""
    layout = found.layout
    names = {name: getattr(layout, name) for name in _LAYOUT_NAMES}
    words = _WORDS.dump_json(_Words(found.hypotheses, found.nuisances, names)).decode()
    arrays = {name: getattr(layout, name) for name in _LAYOUT_ARRAYS}
    arrays |= {name: getattr(found, name) for name in _OWN_ARRAYS}
    with atomic_write(path, "sensitivities") as file:
        np.savez(file, words=np.array(words), **arrays)


def load_sensitivities(path: Path) -> Sensitivities:
    """Load sensitivities.

    Raises:
        BadRequest: The file is incomplete, damaged, or holds no sensitivities.
    """
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            words = _WORDS.validate_json(str(file["words"]))
            names = (words.names[name] for name in _LAYOUT_NAMES)
            layout = FeatureLayout(*(file[name] for name in _LAYOUT_ARRAYS), *names)
            own = (file[name] for name in _OWN_ARRAYS)
            return Sensitivities(layout, words.hypotheses, words.nuisances, *own)
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
