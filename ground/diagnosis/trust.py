"""Whether what won is the cause, or only what imitates it best: learnt from simulated cases of the campaign.

A cause that is in no catalogue is imitated by something that is. The imitation leaves little behind, but it
seldom wins by much: its margin over the best of another class, how much it explains, what remains and how
much its effects are alike make the odds of a logistic regression.
"""

from dataclasses import astuple, dataclass
from typing import Final

import numpy as np
from scipy.optimize import minimize

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.case import Case
from ground.diagnosis.fits import drop
from ground.diagnosis.race import Chosen, Field, best_left, ranked, surprise_of

RUNNERS_UP: Final = 6
"""Hypotheses of other classes that are tried in place of a chosen one."""
RIDGE: Final = 1.0
"""Prior precision of the regression's weights, signs in units of their spread."""


@dataclass(frozen=True, slots=True)
class Signs:
    """What is looked at."""

    more: float
    """Effects beyond one."""
    explained: float
    """Logarithm of the deviance that all of them explain."""
    margin: float
    """Logarithm of 1 plus the surprise that is lost with another class in place of one, at the least."""
    share: float
    """The least share of it that an effect has of its own."""
    alike: float
    """|cos| between the two that are most alike; 0 of one."""
    remains: float
    """Surprise of what remains in the features."""
    addable: float
    """Surprise of the best hypothesis that might be added."""


@dataclass(frozen=True, slots=True)
class Trust:
    """Odds that a name is right, and how high they must be."""

    weights: tuple[float, ...]
    """Of 1 and of the signs."""
    least: float

    def odds(self, signs: Signs) -> float:
        """Logarithm of the odds."""
        return float(np.dot(self.weights, (1.0, *astuple(signs))))

    def allows(self, signs: Signs) -> bool:
        """Whether a name may be given."""
        return self.odds(signs) >= self.least


def signs_of(
    field: Field, cosine: Array, case: Case, chosen: Chosen, shares: tuple[float, ...], remains: float
) -> Signs:
    """Of a model of at least one effect; `remains` is the surprise of what it leaves."""
    prepared = field.prepared
    explained = float(drop(prepared, case, prepared.columns(chosen)))
    own = surprise_of(field, case, chosen)
    margin = own - max(_other(field, case, chosen, index) for index in range(len(chosen)))
    alike = max([float(cosine[a, b]) for a in chosen for b in chosen if a < b], default=0.0)
    return Signs(
        len(chosen) - 1.0, float(np.log(max(explained, 1e-3))), float(np.log1p(max(margin, 0.0))),
        min(shares), alike, remains, best_left(field, case, chosen),
    )  # fmt: skip


def learnt(signs: list[Signs], right: Flags, left_out: Flags, wrong: int) -> Trust:
    """From simulated cases in which something was chosen: whether it was right, or its cause was left out.

    At most `wrong` of those left out would be given a name.
    """
    if right.all() or not right.any():
        return Trust((1.0, *(0.0 for _ in Signs.__dataclass_fields__)), -np.inf if right.all() else np.inf)
    X = np.array([astuple(one) for one in signs])
    middle, spread = X.mean(axis=0), X.std(axis=0) + 1e-9
    Z = np.column_stack([np.ones(len(X)), (X - middle) / spread])
    way = np.where(right, 1.0, -1.0)

    def cost(w: Array) -> tuple[float, Array]:
        odds = way * (Z @ w)
        slope = -way / (1.0 + np.exp(np.clip(odds, -500.0, 500.0)))
        held = np.concatenate([[0.0], w[1:]])
        return float(np.logaddexp(0.0, -odds).sum() + 0.5 * RIDGE * held @ held), Z.T @ slope + RIDGE * held

    w = minimize(cost, np.zeros(Z.shape[1]), jac=True).x
    weights = np.concatenate([[w[0] - w[1:] @ (middle / spread)], w[1:] / spread])
    made = Trust(tuple(float(one) for one in weights), -np.inf)
    odds = np.sort([made.odds(one) for one, out in zip(signs, left_out, strict=True) if out])[::-1]
    least = np.nextafter(odds[wrong], np.inf) if wrong < odds.size else -np.inf
    return Trust(made.weights, float(least))


def _other(field: Field, case: Case, chosen: Chosen, index: int) -> float:
    """Surprise of the best set with another class in place of one of the chosen."""
    others = (*chosen[:index], *chosen[index + 1 :])
    inside = field.inside & (field.label != field.label[chosen[index]])
    order, _ = ranked(Field(field.prepared, field.label, field.threshold, inside), case, others)
    return max((surprise_of(field, case, (*others, h)) for h in order[:RUNNERS_UP]), default=0.0)
