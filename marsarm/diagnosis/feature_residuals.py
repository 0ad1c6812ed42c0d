"""Features of a campaign as residuals that the shared selection of effects can use.

The features are whitened by their noise floor and by all nuisances with their priors:

    y = N v + S a + e,   W y has unit covariance if a = 0

so that no nuisance is fitted. All features count as one joint: most nuisances, and many effects, move them
all. The change by an effect is the parabola of the sensitivities.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.normal_equations import Whitener
from marsarm.diagnosis.problem import Ints
from marsarm.diagnosis.sensitivity import Sensitivities, continue_parabola
from simgap import Effect, ResidualModel, Size

LIMITS: Final = 2.0
"""Size from which a fit starts, in detection limits: effects that can be told apart are of this size."""
BOUND_SHARE: Final = 0.9
"""Largest share of the way to a bound at which a fit starts."""
MORE_ROOM: Final = 1.1
"""Ratio from which on one range of sizes is wider than another; members of a class differ by their cosine."""


@dataclass(frozen=True, slots=True)
class FeatureEffect(Effect):
    """Hypothesis of a campaign as an effect; its sizes are departures from neutral in typical sizes."""

    place: str
    index: int
    """Index of the hypothesis."""
    effect: str
    kind: StrEnum
    departures: tuple[Size, ...]

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the effect."""
        return self.effect

    @property
    def family(self) -> StrEnum:  # type: ignore[override]
        """Family of the effect."""
        return self.kind

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Amplitudes."""
        return self.departures


def list_feature_effects(model: DiagnosisModel, excluded: Collection[int] = ()) -> tuple[FeatureEffect, ...]:
    """List the effects that a campaign can show, one of each equivalence class.

    A class is represented by its first member whose bounds are not within those of another: a link that heat
    makes longer cannot stand for one that was built too long.

    Args:
        model: Diagnosis model of the campaign.
        excluded: Indices of hypotheses that do not compete.

    Returns:
        One effect a class with a finite limit.
    """
    absent = {*excluded, *model.left_out}
    members: dict[int, list[int]] = {}
    for k, limit in enumerate(model.limits):
        if np.isfinite(limit.limit) and k not in absent:
            members.setdefault(int(model.label[k]), []).append(k)
    return tuple(
        _feature_effect(model, next(k for k in of if not any(_has_more_room(model, one, k) for one in of)))
        for of in members.values()
    )


def _has_more_room(model: DiagnosisModel, one: int, other: int) -> bool:
    """Check that the bounds of a hypothesis hold those of another and more, in detection limits.

    Where both act in opposite directions, the bounds of the other change sides.
    """
    (least, most), (other_least, other_most) = (_room(model, k) for k in (one, other))
    a, b = (np.flatnonzero(model.equations.owner == k)[0] for k in (one, other))
    if model.equations.R[a, b] < 0.0:
        other_least, other_most = -other_most, -other_least
    is_wider = most - least > MORE_ROOM * (other_most - other_least)
    return is_wider and least <= other_least and most >= other_most


def _room(model: DiagnosisModel, k: int) -> tuple[float, float]:
    """Return least and greatest common departure of all amplitudes, in detection limits."""
    ends = np.array([one.departure_range for one in model.sensitivities.hypotheses[k].amplitudes])
    limit = model.limits[k].limit
    return float(ends[:, 0].max() / limit), float(ends[:, 1].min() / limit)


def _feature_effect(model: DiagnosisModel, k: int) -> FeatureEffect:
    hypothesis, limit = model.sensitivities.hypotheses[k], model.limits[k].limit
    sizes = []
    for parameter in hypothesis.amplitudes:
        least, most = parameter.departure_range
        typical = min(LIMITS * limit, BOUND_SHARE * (most or -least))
        sizes.append(Size(parameter.name, least, most, typical))
    return FeatureEffect(hypothesis.place, k, hypothesis.effect, model.families[k], tuple(sizes))


class FeatureResiduals:
    """Whitened features of a case less the change by effects; see `ResidualModel`."""

    kind = "features"
    unit = "noise floors"
    method = "Features are compared with those of the simulator, in units of their noise."
    joints: tuple[str, ...] = ("arm",)
    step_s = 0.0
    noise_std = 1.0
    by_motion = False

    def __init__(self, sensitivities: Sensitivities, whiten: Whitener, value: Array) -> None:
        """Whiten features and sensitivities.

        Args:
            sensitivities: Sensitivities of the features.
            whiten: Their `build_full_whitener`.
            value: Measured minus nominal features in the units of the channels, (m,).
        """
        layout = sensitivities.layout
        self._y = whiten(value)
        self._effect = whiten(sensitivities.effect)
        self._curve = whiten(sensitivities.curve)
        self._reach = sensitivities.reach
        self._columns = [
            np.flatnonzero(sensitivities.owner == h) for h in range(len(sensitivities.hypotheses))
        ]
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
            sizes: Departures from neutral in typical sizes, without a unit, one effect after the other,
                (n_candidates, n_sizes).

        Returns:
            (n_candidates, m).
        """
        own = [self._columns[one.index] for one in effects if isinstance(one, FeatureEffect)]
        columns = np.concatenate([np.zeros(0, np.intp), *own])
        parts = self._effect[:, columns], self._curve[:, columns], self._reach[columns]
        return self._y - continue_parabola(*parts, sizes)

    def select(self, motions: Sequence[str]) -> ResidualModel:
        """Return all residuals: they cost nothing."""
        return self

    def explain(self, name: str) -> Array:
        """Return a condition of the features.

        Args:
            name: Name of the condition.

        Returns:
            (m,), in its unit; NaN for a condition that features do not have.
        """
        return np.asarray(self._condition.get(name, np.full(self._y.size, np.nan)))
