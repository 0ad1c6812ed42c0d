"""A diagnosis tried on motions that took no part in it."""

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.closure import Closure, check_apart, closure
from ground.gap.diagnose import Diagnosis
from ground.gap.layout import Evidence
from ground.gap.sensitivity import Sensitivities
from ground.gap.simulator import Simulator
from ground.gap.whiten import whitener


def closed(
    diagnosis: Diagnosis,
    evidence: Evidence,
    found: Sensitivities,
    seed: int,
    simulator: Simulator | None = None,
) -> Closure:
    """How far the findings close the gap in `evidence`, of the same hypotheses and nuisances.

    `found` are the sensitivities of the held-out motions; with their simulator, effects are predicted by it.
    Raises ValueError if a block took part in the diagnosis, or hypotheses or nuisances are others.
    """
    check_apart(diagnosis.prepared.layout, evidence.layout)
    kept = [index for index, nuisance in enumerate(found.nuisances) if not nuisance.each_block]
    same = found.hypotheses == diagnosis.prepared.hypotheses and len(kept) == diagnosis.prepared.q
    if not same:
        raise ValueError("held-out motion must have the hypotheses and nuisances of the campaign")
    before, after = (
        evidence.value - found.nuisance[:, kept] @ (fit.theta[: len(kept)] * diagnosis.prepared.nuisance_unit)
        for fit in (diagnosis.without, diagnosis.best)
    )
    after = after - change(diagnosis, found, simulator)
    whiten = whitener(found)
    return closure(evidence.layout, (whiten(before), whiten(after)), (before, after), seed)


def change(diagnosis: Diagnosis, found: Sensitivities, simulator: Simulator | None = None) -> Array:
    """What the findings change in the features, (m,)."""
    settings = {found.hypotheses[finding.hypothesis]: finding.values for finding in diagnosis.findings}
    if simulator is not None:
        return np.asarray(simulator.predict(settings, np.zeros(len(found.nuisances))) - found.nominal)
    t = np.zeros(found.owner.size)
    for finding in diagnosis.findings:
        parameters = found.hypotheses[finding.hypothesis].parameters
        t[found.owner == finding.hypothesis] = [
            (value - parameter.absent) / parameter.typical
            for value, parameter in zip(finding.values, parameters, strict=True)
            if parameter.sizes
        ]
    return np.asarray(found.effect @ t)
