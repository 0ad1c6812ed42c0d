"""Selection of the effects of a case: the shared engine on whitened features.

`select_simulated` is the entry. It selects with the sensitivities, simulates the effects that are larger than
what these were made for, and selects again.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.detectability import KINDS_OF_TEST
from marsarm.diagnosis.feature_residuals import (
    FeatureEffect,
    FeatureResiduals,
    list_feature_effects,
)
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.normal_equations import Whitener, build_full_whitener
from marsarm.diagnosis.problem import Simulator
from marsarm.diagnosis.sensitivity import Sensitivities
from simgap import select_effects
from simgap.selection.context import Selection as EngineSelection

MAX_SIMULATIONS: Final = 3
"""Greatest number of times that the selected effects are simulated at their estimates."""
MOVED: Final = 0.1
"""Share of a simulated departure by which another may differ without a simulation of its own: up to there, a
parabola that is continued as a line misses a hundredth of its curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Selected hypotheses, with their amplitudes."""

    chosen: tuple[int, ...]
    departures: tuple[Array, ...]
    """Amplitudes of each in typical sizes, (n,)."""
    deviance: float
    """Deviance with these effects, nuisances free."""
    null_deviance: float
    """Deviance without effect, nuisances free."""
    n_distinct: float
    """Number of tests that share the probability of a false alarm."""
    sensitivities: Sensitivities
    """Sensitivities that it was made with."""
    engine: EngineSelection

    def change(self) -> Array:
        """Compute the change of the features by the selected effects.

        Returns:
            Change in the units of the channels, shape (m,).
        """
        hypotheses = [self.sensitivities.hypotheses[h] for h in self.chosen]
        pairs = zip(hypotheses, self.departures, strict=True)
        return self.sensitivities.change({one: one.values(a) for one, a in pairs})


def select_simulated(
    model: DiagnosisModel, whiten: Whitener, value: Array, seed: int, simulator: Simulator | None
) -> Selection:
    """Select effects, simulate those beyond the reach of their sensitivities, and select again.

    Args:
        model: Diagnosis model of the campaign.
        whiten: Its full whitener.
        value: Measured minus nominal features in the units of the channels, (m,).
        seed: Seed of the engine.
        simulator: Simulator of the case; None to extrapolate.

    Returns:
        The last selection.
    """
    selection, excluded = select(model, model.sensitivities, whiten, value, seed), frozenset[int]()
    simulated: dict[int, tuple[Array, Array]] = {}
    for _ in range(MAX_SIMULATIONS):
        far = [
            (h, a)
            for h, a in zip(selection.chosen, selection.departures, strict=True)
            if _is_far(model.sensitivities, h, a, simulated)
        ]
        if simulator is None or not far:
            break
        for h, a in far:
            change = _simulate(model, simulator, h, a)
            if change is None:
                excluded |= {h}
            else:
                simulated[h] = a, change
        sensitivities = model.sensitivities
        for h, (a, change) in simulated.items():
            sensitivities = sensitivities.with_simulated(h, a, change)
        again = select(model, sensitivities, build_full_whitener(sensitivities), value, seed, excluded)
        if not again.chosen:  # several large effects that simulations bend one by one may leave none
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


def _simulate(model: DiagnosisModel, simulator: Simulator, h: int, a: Array) -> Array | None:
    """Return the change by one hypothesis, (m,); None if no arm with it can be simulated."""
    hypothesis, zero = model.sensitivities.hypotheses[h], np.zeros(len(simulator.nuisances))
    changed = simulator.predict({hypothesis: hypothesis.values(a)}, zero)
    change = changed - simulator.predict({}, zero)
    return change if np.all(np.isfinite(change)) and np.any(change) else None


def select(
    model: DiagnosisModel,
    sensitivities: Sensitivities,
    whiten: Whitener,
    value: Array,
    seed: int,
    excluded: Collection[int] = (),
) -> Selection:
    """Select the effects that a case needs.

    Args:
        model: Diagnosis model of the campaign.
        sensitivities: Its sensitivities, also with parabolas through simulated changes.
        whiten: Whitener of the sensitivities by noise and nuisances.
        value: Measured minus nominal features in the units of the channels, (m,).
        seed: Seed of the engine.
        excluded: Hypotheses that do not compete.

    Returns:
        Selection, the effects in the order found.
    """
    residuals = FeatureResiduals(sensitivities, whiten, value)
    effects = list_feature_effects(model, excluded)
    found = select_effects(residuals, (), effects, seed=seed, n_kinds=KINDS_OF_TEST)
    chosen = [one for one in found.chosen.effects if isinstance(one, FeatureEffect)]
    union, sizes = found.context.union, found.chosen.sizes
    before, after = (np.concatenate([fit.residuals for fit in of.fits]) for of in (found.base, found.chosen))
    return Selection(
        tuple(one.index for one in chosen),
        tuple(sizes[union.columns([one])] for one in chosen),
        float(after @ after),
        float(before @ before),
        found.context.n_distinct,
        sensitivities,
        found,
    )
