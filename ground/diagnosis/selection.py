"""Selection of the effects of a case: the shared engine on whitened features."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from diagnosis.selection.context import Selection as EngineSelection
from diagnosis.selection.selection import select_effects
from fsw.kinematics.transforms import Array
from ground.diagnosis.detectability import KINDS_OF_TEST
from ground.diagnosis.feature_residuals import (
    FeatureEffect,
    FeatureResiduals,
    list_feature_effects,
)
from ground.diagnosis.model import DiagnosisModel
from ground.diagnosis.normal_equations import Whitener
from ground.diagnosis.sensitivity import Sensitivities


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
    engine: EngineSelection


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
        whiten: Whitener of the model by noise and nuisances.
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
        found,
    )
