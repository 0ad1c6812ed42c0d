"""Features of a campaign as residuals that the selection of effects can use.

The features are whitened by their noise floor and by all nuisances with their priors:

    y = N v + S a + e,   W y has unit covariance if a = 0

so that no nuisance is fitted. All features count as one joint: most nuisances, and many effects, move them
all. The change by an effect is the parabola of the sensitivities.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.effects.effect import Effect, Family, Size
from diagnosis.residuals.residuals import ResidualModel
from fsw.kinematics.transforms import Array
from ground.diagnosis.detectability import Detectability
from ground.diagnosis.normal_equations import Whitener, build_whitener
from ground.diagnosis.problem import Hypothesis, Ints, Residuals
from ground.diagnosis.sensitivity import Sensitivities

LIMITS: Final = 2.0
"""Size from which a fit starts, in detection limits: effects that can be told apart are of this size."""
BOUND_SHARE: Final = 0.9
"""Largest share of the way to a bound at which a fit starts."""
RANK_TOLERANCE: Final = 1e-9
"""Nuisances whose whitened size is below this have no influence."""


@dataclass(frozen=True, slots=True)
class FeatureEffect(Effect):
    """Hypothesis of a campaign as an effect; its sizes are departures from neutral in typical sizes."""

    place: str
    hypothesis: Hypothesis
    kind: Family
    own: tuple[Size, ...]

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the effect."""
        return self.hypothesis.effect

    @property
    def family(self) -> Family:  # type: ignore[override]
        """Family of the effect."""
        return self.kind

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Amplitudes."""
        return self.own


def list_feature_effects(
    sensitivities: Sensitivities, limits: Sequence[Detectability], family: Callable[[Hypothesis], Family]
) -> tuple[FeatureEffect, ...]:
    """List the effects that a campaign can show.

    Args:
        sensitivities: Sensitivities of the campaign.
        limits: Detection limit of each hypothesis.
        family: Function that returns the family of a hypothesis.

    Returns:
        One effect a hypothesis with a finite limit.
    """
    found = []
    for hypothesis, limit in zip(sensitivities.hypotheses, limits, strict=True):
        if np.isfinite(limit.limit):
            sizes = []
            for parameter in hypothesis.amplitudes:
                ends = [
                    (end - parameter.absent) / parameter.typical for end in (parameter.least, parameter.most)
                ]
                typical = min(LIMITS * limit.limit, BOUND_SHARE * max(map(abs, ends)))
                sizes.append(Size(parameter.name, min(ends), max(ends), typical))
            found.append(FeatureEffect(hypothesis.place, hypothesis, family(hypothesis), tuple(sizes)))
    return tuple(found)


class FeatureResiduals:
    """Whitened features of a case less the change by effects; see `ResidualModel`."""

    kind = "features"
    unit = "noise floors"
    method = "Features are compared with those of the simulator, in units of their noise."
    joints: tuple[str, ...] = ("arm",)
    step_s = 0.0
    noise_std = 1.0
    by_motion = False

    def __init__(self, sensitivities: Sensitivities, residuals: Residuals) -> None:
        """Whiten features and sensitivities.

        Args:
            sensitivities: Sensitivities of the features.
            residuals: Measured minus nominal features.
        """
        layout = residuals.layout
        whiten = _whiten_all(sensitivities)
        self._y = whiten(residuals.value[:, None])[:, 0]
        self._effect, self._curve = whiten(sensitivities.effect), whiten(sensitivities.curve)
        self._reach = sensitivities.reach
        self._columns = {
            (one.effect, one.place): np.flatnonzero(sensitivities.owner == h)
            for h, one in enumerate(sensitivities.hypotheses)
        }
        present, self.motion_of = np.unique(layout.block, return_inverse=True)
        self.motions = tuple(layout.blocks[block] for block in present)
        self.repeat_of = ("",) * len(self.motions)
        self.joint_of: Ints = np.zeros(layout.size, np.intp)
        self.time_s = np.arange(layout.size, dtype=float)  # whitened features have no memory
        self._condition = dict(zip(layout.conditions, layout.condition.T, strict=True))

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, in noise floors.

        Args:
            effects: Feature effects of all candidates.
            sizes: Departures from neutral over typical sizes, unitless, one effect after the other,
                (n_candidates, n_sizes).

        Returns:
            (n_candidates, m).
        """
        a, first = np.zeros((len(sizes), self._reach.size)), 0
        for effect in effects:
            last = first + len(effect.sizes)
            a[:, self._columns[effect.name, effect.place]] = sizes[:, first:last]
            first = last
        inside = np.clip(a, -self._reach, self._reach)
        return np.asarray(self._y - a @ self._effect.T - (inside * (2.0 * a - inside)) @ self._curve.T)

    def select(self, motions: Sequence[str]) -> ResidualModel:
        """Return all residuals: they cost nothing."""
        return self

    def explain(self, name: str) -> Array:
        """Return a condition of the features; NaN for one that they do not have.

        Args:
            name: Name of the condition.

        Returns:
            (m,), in the unit of the condition.
        """
        return np.asarray(self._condition.get(name, np.full(self._y.size, np.nan)))


def _whiten_all(sensitivities: Sensitivities) -> Callable[[Array], Array]:
    """Return the function that whitens features, (m, n), by noise and all nuisances."""
    first: Whitener = build_whitener(sensitivities)
    shared = sensitivities.shared_nuisances
    sigma = np.array([sensitivities.nuisances[index].sigma for index in shared])
    U, S, _ = np.linalg.svd(first(sensitivities.nuisance[:, shared] * sigma), full_matrices=False)
    U, S = U[:, S > RANK_TOLERANCE], S[S > RANK_TOLERANCE]
    shrinkage = 1.0 - 1.0 / np.sqrt(1.0 + S**2)

    def whiten(features: Array) -> Array:
        white = first(features)
        return np.asarray(white - (U * shrinkage) @ (U.T @ white))

    return whiten
