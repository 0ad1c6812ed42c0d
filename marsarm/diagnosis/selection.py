"""Selection of the effects of a case: the shared engine on whitened features.

`select_simulated` is the entry. It selects with the sensitivities, simulates the effects that are larger than
what these were made for, and selects again. The features are whitened by their noise floor and by all
nuisances with their priors:

    y = N v + S a + e,   W y has unit covariance if a = 0

so that no nuisance is fitted. All features count as one joint: most nuisances, and many effects, move them
all. The change by an effect is the parabola of the sensitivities.

In all functions, `value` are measured minus nominal features in the units of the channels, (m,), `whiten` is
the `build_full_whitener` of the sensitivities, and `excluded` are indices of hypotheses that do not compete.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.model import KINDS_OF_TEST, DiagnosisModel, Whitener, build_full_whitener
from marsarm.diagnosis.problem import Hypothesis, Ints, Sensitivities, Simulate, continue_parabola
from simgap import Effect, ResidualModel, select_effects
from simgap.selection.context import Selection

MAX_SIMULATIONS: Final = 3
"""Greatest number of times that the selected effects are simulated at their estimates."""
MOVED: Final = 0.1
"""Share of a simulated departure by which another may differ without a simulation of its own: up to there, a
parabola that is continued as a line misses a hundredth of its curvature."""
LIMITS: Final = 2.0
"""Size from which a fit starts, in detection limits: effects that can be told apart are of this size."""
MORE_ROOM: Final = 1.1
"""Ratio from which on one range of sizes is wider than another; members of a class differ by their cosine."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSelection:
    """Selected hypotheses, with their departures."""

    sensitivities: Sensitivities
    """Sensitivities that it was made with."""
    engine: Selection
    departures: dict[Hypothesis, Array]

    @property
    def chosen(self) -> tuple[int, ...]:
        """Indices of the hypotheses."""
        return tuple(self.sensitivities.index(one.key) for one in self.departures)


def select_simulated(
    model: DiagnosisModel, whiten: Whitener, value: Array, seed: int, simulate: Simulate
) -> FeatureSelection:
    """Select effects, simulate those beyond the reach of their sensitivities, and select again."""
    selection, excluded = select(model, model.sensitivities, whiten, value, seed), frozenset[int]()
    simulated: dict[int, tuple[Array, Array]] = {}
    for _ in range(MAX_SIMULATIONS):
        found = zip(selection.chosen, selection.departures.items(), strict=True)
        far = [(h, one, a) for h, (one, a) in found if _is_far(model.sensitivities, h, a, simulated)]
        if not far:
            break
        for h, hypothesis, a in far:
            change = simulate({hypothesis: a})
            if not np.all(np.isfinite(change)) or not np.any(change):
                excluded |= {h}
            else:
                simulated[h] = a, change
        sensitivities = model.sensitivities
        for h, (a, change) in simulated.items():
            sensitivities = sensitivities.with_simulated(h, a, change)
        again = select(model, sensitivities, build_full_whitener(sensitivities), value, seed, excluded)
        is_refuted = not excluded.isdisjoint(selection.chosen)
        if not again.chosen and not is_refuted:  # simulations bend several large effects one by one
            break
        selection = again
    return selection


def _is_far(
    sensitivities: Sensitivities, h: int, a: Array, simulated: Mapping[int, tuple[Array, Array]]
) -> bool:
    """Check that a departure is far from that which was simulated, or beyond the reach of the campaign."""
    if h in simulated:
        return bool(np.any(np.abs(a - simulated[h][0]) > MOVED * np.abs(simulated[h][0])))
    return bool(np.any(np.abs(a) > (1.0 + MOVED) * sensitivities.reach[sensitivities.owner == h]))


def select(
    model: DiagnosisModel,
    sensitivities: Sensitivities,
    whiten: Whitener,
    value: Array,
    seed: int,
    excluded: Collection[int] = (),
) -> FeatureSelection:
    """Select the effects that a case needs."""
    residuals = FeatureResiduals(sensitivities, whiten, value)
    effects = list_competitors(model, excluded)
    found = select_effects(residuals, (), effects, seed=seed, n_kinds=KINDS_OF_TEST)
    union, sizes = found.context.union, found.chosen.sizes
    chosen = [one for one in found.chosen.effects if isinstance(one, Hypothesis)]
    return FeatureSelection(sensitivities, found, {one: sizes[union.columns([one])] for one in chosen})


def list_competitors(model: DiagnosisModel, excluded: Collection[int] = ()) -> tuple[Hypothesis, ...]:
    """List the hypotheses that a campaign can show, one of each equivalence class.

    A class is represented by its first member whose bounds are not within those of another: a link that heat
    makes longer cannot stand for one that was built too long.
    """
    absent = {*excluded, *model.left_out}
    members: dict[int, list[int]] = {}
    for k, limit in enumerate(model.limits):
        if np.isfinite(limit) and k not in absent:
            members.setdefault(int(model.label[k]), []).append(k)
    chosen = (
        next(k for k in of if not any(_has_more_room(model, one, k) for one in of)) for of in members.values()
    )
    return tuple(
        replace(model.sensitivities.hypotheses[k], start=LIMITS * float(model.limits[k])) for k in chosen
    )


def _has_more_room(model: DiagnosisModel, one: int, other: int) -> bool:
    """Check that the bounds of a hypothesis hold those of another and more, in detection limits.

    Where both act in opposite directions, the bounds of the other change sides.
    """
    hypotheses, limits = model.sensitivities.hypotheses, model.limits
    least, most = np.array(hypotheses[one].common_range) / limits[one]
    other_least, other_most = np.array(hypotheses[other].common_range) / limits[other]
    a, b = (np.flatnonzero(model.equations.owner == k)[0] for k in (one, other))
    if model.equations.R[a, b] < 0.0:
        other_least, other_most = -other_most, -other_least
    is_wider = most - least > MORE_ROOM * (other_most - other_least)
    return bool(is_wider and least <= other_least and most >= other_most)


class FeatureResiduals:
    """Whitened features of a case less the change by effects; see `ResidualModel`."""

    kind = "features"
    units: tuple[str, ...] = ("noise floors",)
    method = "Features are compared with those of the simulator, in units of their noise."
    joints: tuple[str, ...] = ("arm",)
    step_s = 0.0
    noise_std = 1.0
    by_motion = False

    def __init__(self, sensitivities: Sensitivities, whiten: Whitener, value: Array) -> None:
        layout = sensitivities.layout
        self._y = whiten(value)
        self._effect = whiten(sensitivities.effect)
        self._curve = whiten(sensitivities.curve)
        self._reach = sensitivities.reach
        self._columns = {
            one.key: np.flatnonzero(sensitivities.owner == h)
            for h, one in enumerate(sensitivities.hypotheses)
        }
        number = {block: k for k, block in enumerate(dict.fromkeys(layout.block.tolist()))}
        self.motions, self.motion_of = tuple(number), np.array([number[one] for one in layout.block.tolist()])
        self.repeat_of = ("",) * len(self.motions)
        self.joint_of: Ints = np.zeros(layout.size, np.intp)
        self.time_s = np.arange(layout.size, dtype=float)  # whitened features have no memory

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates in noise floors, (n_candidates, m)."""
        own = [self._columns[one.key] for one in effects]
        columns = np.concatenate([np.zeros(0, np.intp), *own])
        parts = self._effect[:, columns], self._curve[:, columns], self._reach[columns]
        return self._y - continue_parabola(*parts, sizes)

    def select(self, motions: Sequence[str]) -> ResidualModel:
        """Return all residuals: they cost nothing."""
        return self

    def explain(self, name: str) -> Array:
        """Return NaN, (m,): features have none of these variables, only conditions of their own."""
        return np.full(self._y.size, np.nan)
