"""Equivalence classes: hypotheses that no data of a case can separate from its effect.

Two hypotheses are equivalent if their changes of the fitted motions, whitened and without what nuisances
imitate, have a cosine above 0.99. Then a fit of the wrong one leaves at most 2 % of the energy of the effect:
at four detection limits of 8, that is (4 * 8)^2 * 0.02 = 20, less than the noncentrality of 64 that a
hypothesis needs. Hypotheses at the place of the effect and at the base and the tool are compared. Those at
other joints move other joints.
"""

from typing import Final

import numpy as np

from simgap.arrays import Array
from validation.cases import robot_inside as inside
from validation.cases import robot_structure as structure
from validation.cases.robot_draw import Campaign, DrawnEffect, change_of, make_effect
from validation.cases.robot_limits import information, make_nuisance
from validation.cases.robot_table import BASE, ENTRIES, SUPPLY, Hypothesis, list_hypotheses
from validation.cases.robot_truth import TrueEffect

LEAST_COSINE: Final = 0.99
SHAPED: Final = (
    inside.Integral,
    inside.Stribeck,
    structure.Spring,
    structure.PositionTorque,
    structure.PeriodicError,
    structure.GravityDirection,
)
"""Effects with a shape; two shapes of each are tried beside that of the truth."""
FAR: Final = 0.9
"""Cosine of a change at about the right size below which no size makes it equal."""


def find_equivalents(campaign: Campaign, drawn: DrawnEffect) -> tuple[tuple[str, str], ...]:
    """Return the effects of the catalogue with their places that cannot be told from a true one.

    Args:
        campaign: Motions of the case.
        drawn: The effect; one of the catalogue is its own equivalent.
    """
    true = change_of(campaign, make_effect(drawn, campaign.plan.scene))
    near = {drawn.place, BASE, SUPPLY, campaign.robot.tool_site}
    found = [
        (one.entry.kind.name, one.place)
        for one in list_hypotheses(campaign.robot, ENTRIES)
        if one.place in near
        and (
            (one.entry.kind.name, one.place) == (drawn.name, drawn.place)
            or _imitates(campaign, one, drawn, true)
        )
    ]
    return tuple(found)


def _imitates(campaign: Campaign, one: Hypothesis, drawn: DrawnEffect, true: Array) -> bool:
    shapes = (drawn.shape, 0.25, 0.75) if issubclass(one.entry.kind, SHAPED) else (drawn.shape,)
    return any(abs(_cosine(campaign, one, shape, true)) > LEAST_COSINE for shape in shapes)


def _cosine(campaign: Campaign, one: Hypothesis, shape: float, true: Array) -> float:
    """Return the cosine of two changes, the second at the size that gives about the strength of the first."""
    strength = np.sqrt(max(information(true, true, campaign.nuisance), 0.0))
    size = one.entry.typical
    cosine = 0.0
    for _ in range(2):
        try:
            change = _close_change(
                campaign, one.entry.kind(campaign.plan.scene, one.place, size * one.scale, shape), true
            )
        except FloatingPointError:
            return 0.0
        if change is None:
            return 0.0
        own = np.sqrt(max(information(change, change, campaign.nuisance), 0.0))
        cosine = information(change, true, campaign.nuisance) / max(own * strength, 1e-12)
        size = min(size * float(np.clip(strength / max(own, 1e-9), 0.1, 10.0)), one.entry.high)
    return float(cosine)


def _close_change(campaign: Campaign, effect: TrueEffect, true: Array) -> Array | None:
    """Return the change by an effect; None if its cosine with the true one is below FAR.

    What some motions leave of the true change is a lower bound of what all leave: most effects need only few.
    """
    n_motions = len(campaign.fitted)
    parts = true.reshape(n_motions, -1)
    allowed = (1.0 - FAR**2) * information(true, true, campaign.nuisance)
    columns = campaign.nuisance.columns.reshape(n_motions, parts.shape[1], -1)
    order, changes = np.argsort(-np.sum(parts**2, axis=1)), np.zeros_like(parts)
    for count, motion in enumerate(order, 1):
        changes[motion] = change_of(campaign, effect, [motion])
        seen = order[:count]
        nuisance = make_nuisance(np.concatenate(columns[seen]))
        one, other = changes[seen].ravel(), parts[seen].ravel()
        imitated = information(one, other, nuisance) ** 2 / max(information(one, one, nuisance), 1e-12)
        if information(other, other, nuisance) - imitated > allowed:
            return None
    return np.asarray(changes.ravel())
