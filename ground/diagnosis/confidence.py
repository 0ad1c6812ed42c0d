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
from ground.diagnosis.linear_fit import likelihood_ratio
from ground.diagnosis.normal_equations import RightHandSide
from ground.diagnosis.selection import CandidateSet, Subset, best_addition, rank_additions, subset_neg_log10_p

RUNNERS_UP: Final = 6
"""Hypotheses of other classes that are tried in place of a chosen one."""
WEIGHT_PRIOR_PRECISION: Final = 1.0
"""Prior precision of the regression's weights, signs in units of their spread."""


@dataclass(frozen=True, slots=True)
class ConfidenceFeatures:
    """What is looked at."""

    extra_effects: float
    """Effects beyond one."""
    log_deviance: float
    """Logarithm of the deviance that all of them explain."""
    log_margin: float
    """Logarithm of 1 plus the surprise that is lost with another class in place of one, at the least."""
    share: float
    """The least share of it that an effect has of its own."""
    max_cosine: float
    """|cos| between the two that are most alike; 0 of one."""
    lack_of_fit: float
    """Surprise of what remains in the features."""
    addition: float
    """Surprise of the best hypothesis that might be added."""


@dataclass(frozen=True, slots=True)
class ConfidenceClassifier:
    """Odds that a name is right, and how high they must be."""

    weights: tuple[float, ...]
    """Of 1 and of the signs."""
    least: float

    def log_odds(self, features: ConfidenceFeatures) -> float:
        """Logarithm of the odds."""
        return float(np.dot(self.weights, (1.0, *astuple(features))))

    def accepts(self, features: ConfidenceFeatures) -> bool:
        """Whether a name may be given."""
        return self.log_odds(features) >= self.least


def compute_confidence_features(
    candidates: CandidateSet,
    cosine: Array,
    rhs: RightHandSide,
    chosen: Subset,
    shares: tuple[float, ...],
    remains: float,
) -> ConfidenceFeatures:
    """Of a model of at least one effect; `remains` is the surprise of what it leaves."""
    equations = candidates.equations
    explained = float(likelihood_ratio(equations, rhs, equations.columns(chosen)))
    own = subset_neg_log10_p(candidates, rhs, chosen)
    margin = own - max(_runner_up_neg_log10_p(candidates, rhs, chosen, index) for index in range(len(chosen)))
    alike = max([float(cosine[a, b]) for a in chosen for b in chosen if a < b], default=0.0)
    return ConfidenceFeatures(
        len(chosen) - 1.0, float(np.log(max(explained, 1e-3))), float(np.log1p(max(margin, 0.0))),
        min(shares), alike, remains, best_addition(candidates, rhs, chosen),
    )  # fmt: skip


def train_classifier(
    features: list[ConfidenceFeatures], right: Flags, left_out: Flags, wrong: int
) -> ConfidenceClassifier:
    """From simulated cases in which something was chosen: whether it was right, or its cause was left out.

    At most `wrong` of those left out would be given a name.
    """
    if right.all() or not right.any():
        return ConfidenceClassifier(
            (1.0, *(0.0 for _ in ConfidenceFeatures.__dataclass_fields__)), -np.inf if right.all() else np.inf
        )
    X = np.array([astuple(one) for one in features])
    middle, spread = X.mean(axis=0), X.std(axis=0) + 1e-9
    Z = np.column_stack([np.ones(len(X)), (X - middle) / spread])
    way = np.where(right, 1.0, -1.0)

    def cost(w: Array) -> tuple[float, Array]:
        odds = way * (Z @ w)
        slope = -way / (1.0 + np.exp(np.clip(odds, -500.0, 500.0)))
        held = np.concatenate([[0.0], w[1:]])
        return float(
            np.logaddexp(0.0, -odds).sum() + 0.5 * WEIGHT_PRIOR_PRECISION * held @ held
        ), Z.T @ slope + WEIGHT_PRIOR_PRECISION * held

    w = minimize(cost, np.zeros(Z.shape[1]), jac=True).x
    weights = np.concatenate([[w[0] - w[1:] @ (middle / spread)], w[1:] / spread])
    made = ConfidenceClassifier(tuple(float(one) for one in weights), -np.inf)
    odds = np.sort([made.log_odds(one) for one, out in zip(features, left_out, strict=True) if out])[::-1]
    least = np.nextafter(odds[wrong], np.inf) if wrong < odds.size else -np.inf
    return ConfidenceClassifier(made.weights, float(least))


def _runner_up_neg_log10_p(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset, index: int) -> float:
    """Surprise of the best set with another class in place of one of the chosen."""
    others = (*chosen[:index], *chosen[index + 1 :])
    inside = candidates.allowed & (candidates.label != candidates.label[chosen[index]])
    order, _ = rank_additions(
        CandidateSet(candidates.equations, candidates.label, candidates.threshold, inside), rhs, others
    )
    return max((subset_neg_log10_p(candidates, rhs, (*others, h)) for h in order[:RUNNERS_UP]), default=0.0)
