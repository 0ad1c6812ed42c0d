"""A diagnosis tried on motions that took no part in it."""

from fsw.kinematics.transforms import Array
from ground.gap.closure import Closure, check_apart, closure, unsure
from ground.gap.diagnose import Diagnosis
from ground.gap.hypothesis import Hypothesis
from ground.gap.layout import Evidence
from ground.gap.sensitivity import Sensitivities
from ground.gap.whiten import whitener


def closed(
    diagnosis: Diagnosis, evidence: Evidence, found: Sensitivities, change: Array, seed: int
) -> Closure:
    """How far the findings close the gap in `evidence`, of the same nuisances.

    `found` are the sensitivities of the held-out motions, `change` what the findings change there (m,), by
    the simulator. Raises ValueError if a block took part in the diagnosis, or nuisances are others.
    """
    check_apart(diagnosis.prepared.layout, evidence.layout)
    before, after = residuals(diagnosis, evidence, found, change)
    whiten = whitener(found)
    doubt = unsure(diagnosis.prepared, found)
    return closure(evidence.layout, (whiten(before), whiten(after)), (before, after), seed, doubt)


def residuals(
    diagnosis: Diagnosis, evidence: Evidence, found: Sensitivities, change: Array
) -> tuple[Array, Array]:
    """What is left without the findings and with them, nuisances as fitted elsewhere, (m,) each.

    Raises ValueError if nuisances are others.
    """
    q = diagnosis.prepared.q
    if len(found.lasting) != q:
        raise ValueError("held-out motion must have the nuisances of the campaign")
    before, after = (
        evidence.value - found.nuisance[:, found.lasting] @ (fit.theta[:q] * diagnosis.prepared.nuisance_unit)
        for fit in (diagnosis.without, diagnosis.best)
    )
    return before, after - change


def settings_of(diagnosis: Diagnosis) -> dict[Hypothesis, Array]:
    """The findings as a simulator takes them."""
    hypotheses = diagnosis.prepared.hypotheses
    return {hypotheses[finding.hypothesis]: finding.values for finding in diagnosis.findings}
