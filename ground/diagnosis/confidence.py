"""Confidence classifier: decides whether the selected effects may be named as the cause.

A cause outside the catalogue is imitated by an effect inside it. The imitation leaves little residual, but it
seldom wins by a large margin. A logistic regression on `ConfidenceFeatures` gives the log-odds that a
selection is right. It is trained on simulated cases of the campaign (`thresholds`).
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
"""Number of hypotheses of other classes that are tried in place of a chosen one."""
WEIGHT_PRIOR_PRECISION: Final = 1.0
"""Prior precision of the regression weights, for standardised features."""


@dataclass(frozen=True, slots=True)
class ConfidenceFeatures:
    """Features of the confidence classifier."""

    extra_effects: float
    """Number of effects minus one."""
    log_deviance: float
    """Logarithm of the deviance that all effects explain."""
    log_margin: float
    """Logarithm of 1 plus the least loss of -log10 p if another class replaces one effect."""
    share: float
    """Least share of the deviance that is lost without one effect."""
    max_cosine: float
    """Greatest absolute cosine between two of the effects; 0 for one effect."""
    lack_of_fit: float
    """-log10 p of the lack-of-fit test."""
    addition: float
    """-log10 p of the best hypothesis that could be added."""


@dataclass(frozen=True, slots=True)
class ConfidenceClassifier:
    """Logistic regression, with the least log-odds for a name."""

    weights: tuple[float, ...]
    """Weight of the constant 1, then weights of the features."""
    least: float
    """Least log-odds at which a name is given."""

    def log_odds(self, features: ConfidenceFeatures) -> float:
        """Compute the log-odds that the selection is right."""
        return float(np.dot(self.weights, (1.0, *astuple(features))))

    def accepts(self, features: ConfidenceFeatures) -> bool:
        """Check that the log-odds suffice for a name."""
        return self.log_odds(features) >= self.least


def compute_confidence_features(
    candidates: CandidateSet,
    cosine: Array,
    rhs: RightHandSide,
    chosen: Subset,
    shares: tuple[float, ...],
    lack_of_fit: float,
) -> ConfidenceFeatures:
    """Compute the features of a selection of at least one effect.

    Args:
        candidates: Hypotheses that may be selected.
        cosine: Absolute cosines between h hypotheses, unitless, shape (h, h).
        rhs: Right-hand side of the case.
        chosen: Selected hypotheses.
        shares: Share of the explained deviance that is lost without each.
        lack_of_fit: -log10 p of the lack-of-fit test after the selection.

    Returns:
        Features of the confidence classifier.
    """
    equations = candidates.equations
    explained = float(likelihood_ratio(equations, rhs, equations.columns(chosen)))
    own = subset_neg_log10_p(candidates, rhs, chosen)
    margin = own - max(_runner_up_neg_log10_p(candidates, rhs, chosen, index) for index in range(len(chosen)))
    max_cosine = max([float(cosine[a, b]) for a in chosen for b in chosen if a < b], default=0.0)
    return ConfidenceFeatures(
        len(chosen) - 1.0, float(np.log(max(explained, 1e-3))), float(np.log1p(max(margin, 0.0))),
        min(shares), max_cosine, lack_of_fit, best_addition(candidates, rhs, chosen),
    )  # fmt: skip


def train_classifier(
    features: list[ConfidenceFeatures], right: Flags, left_out: Flags, wrong: int
) -> ConfidenceClassifier:
    """Train the classifier with simulated cases in which something was selected.

    Args:
        features: Features of the n cases.
        right: Flag of each case: true if all selected effects are right, shape (n,).
        left_out: Flag of each case: true if its cause was left out of the catalogue, shape (n,).
        wrong: Greatest number of left-out cases that may get a name.

    Returns:
        Classifier; it accepts at most `wrong` of the left-out cases.
    """
    if right.all() or not right.any():
        return ConfidenceClassifier(
            (1.0, *(0.0 for _ in ConfidenceFeatures.__dataclass_fields__)), -np.inf if right.all() else np.inf
        )
    X = np.array([astuple(one) for one in features])
    middle, spread = X.mean(axis=0), X.std(axis=0) + 1e-9
    Z = np.column_stack([np.ones(len(X)), (X - middle) / spread])
    sign = np.where(right, 1.0, -1.0)

    def cost(w: Array) -> tuple[float, Array]:
        odds = sign * (Z @ w)
        slope = -sign / (1.0 + np.exp(np.clip(odds, -500.0, 500.0)))
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
    """Return the greatest -log10 p of a set with another class in place of one of the chosen."""
    others = (*chosen[:index], *chosen[index + 1 :])
    allowed = candidates.allowed & (candidates.label != candidates.label[chosen[index]])
    order, _ = rank_additions(
        CandidateSet(candidates.equations, candidates.label, candidates.threshold, allowed), rhs, others
    )
    return max((subset_neg_log10_p(candidates, rhs, (*others, h)) for h in order[:RUNNERS_UP]), default=0.0)
