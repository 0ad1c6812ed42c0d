"""Thresholds of significance and confidence, calibrated before data with simulated cases of the campaign.

Three kinds of simulated cases are used. Cases without effect set the thresholds for claiming an effect. Cases
with one or two effects of the catalogue set the threshold for unexplained structure. These, and cases whose
effect was left out of the catalogue, train the confidence classifier.

The classifier is trained only on left-out effects that no remaining hypothesis can imitate. An example of the
opposite: if viscous friction is left out, Coulomb friction of the joint imitates it, and no data can tell.
It is assumed that nothing imitates effects outside the catalogue so closely.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.confidence import (
    ConfidenceClassifier,
    ConfidenceFeatures,
    compute_confidence_features,
    train_classifier,
)
from ground.diagnosis.detectability import Detectability
from ground.diagnosis.linear_fit import fit_linear
from ground.diagnosis.normal_equations import NormalEquations, reduce_features
from ground.diagnosis.problem import Ints
from ground.diagnosis.residual_analysis import FeatureGroup, find_lack_of_fit
from ground.diagnosis.sampling import (
    DetectableEffect,
    SampledEffect,
    can_sample,
    sample_amplitude,
    sample_effect,
)
from ground.diagnosis.selection import CandidateSet, best_addition, select_effects

SIMULATED_CASES: Final = 400
"""Number of simulated cases of each kind."""
MAX_FALSE_ALARM: Final = 0.04
"""Share of no-effect cases with any claim: below 5 % by one sigma of the sampling error of these cases."""
MAX_WITHHELD: Final = 0.02
"""Share of correctly selected cases that may be rejected for their unexplained structure."""
MAX_WRONG_NAMES: Final = 0.13
"""Share of left-out cases, of effects that nothing imitates, that may get a wrong name."""
IMITATION_COSINE: Final = 0.8
"""Absolute cosine from which on a hypothesis imitates a left-out effect: it explains two thirds of it. For an
alias it must be above `ALIAS_COSINE`."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds in -log10 p, with their error rates on the simulated cases."""

    effect: float
    """Least -log10 p of a hypothesis that may be selected."""
    structure: float
    """-log10 p from which on remaining structure counts, if no effect is selected."""
    unexplained: float
    """-log10 p from which on remaining structure counts, beside selected effects."""
    confidence: ConfidenceClassifier
    """Confidence classifier that accepts or withholds a name."""
    false_alarm: float
    """Share of no-effect cases in which an effect or structure is claimed."""
    withheld: float
    """Share of correctly selected cases that get no name."""
    wrong_names: float
    """Share of left-out cases that get a name; NaN if there are none."""
    cases: int
    """Number of simulated cases of each kind, left-out cases excepted."""
    left_out_cases: int
    """Number of left-out cases: those of effects that nothing imitates, or all if there are none."""


@dataclass(frozen=True, slots=True)
class _Outcome:
    """Simulated case in which something was selected."""

    features: ConfidenceFeatures
    right: bool
    left_out: bool

    @property
    def remaining(self) -> float:
        """Greatest -log10 p of the remaining structure."""
        return max(self.features.lack_of_fit, self.features.addition)


def calibrate_thresholds(
    equations: NormalEquations,
    label: Ints,
    cosine: Array,
    limits: tuple[Detectability, ...],
    groups: tuple[FeatureGroup, ...],
    seed: int,
    cases: int = SIMULATED_CASES,
    step: Callable[[int, int], None] = lambda *_: None,
) -> Thresholds:
    """Calibrate thresholds and classifier with simulated cases.

    Args:
        equations: Normal equations of the campaign, with h hypotheses.
        label: Indices of the equivalence class of each hypothesis, shape (h,).
        cosine: Absolute cosines between hypotheses, unitless, shape (h, h).
        limits: Detection limit of each hypothesis.
        groups: Feature groups of the lack-of-fit test.
        seed: Seed of the simulated cases.
        cases: Number of simulated cases of each kind.
        step: Called with the number of cases done and the total.

    Returns:
        Thresholds with their error rates.
    """
    rng = np.random.default_rng(seed)
    visible = np.array([limit.limit for limit in limits]) < np.inf
    none = CandidateSet(equations, label, 0.0, visible & equations.identifiable)
    found = np.empty((cases, 2))
    for index in range(cases):
        y = _simulate_features(equations, rng, np.zeros(equations.owner.size))
        found[index] = _null_statistics(none, groups, y)
        step(index + 1, 2 * cases)
    effect, structure = _joint_thresholds(found)
    candidates = CandidateSet(equations, label, effect, none.allowed)
    outcomes: list[_Outcome] = []
    not_imitated: list[tuple[CandidateSet, Array]] = []
    imitated: list[tuple[CandidateSet, Array]] = []
    detectable = _detectable_effects(candidates, limits)
    for index in range(cases if detectable else 0):
        one = sample_amplitude(sample_effect(detectable, rng), rng)
        others = [other for other in detectable if other.label != one.source.label] or detectable
        two = sample_amplitude(sample_effect(others, rng), rng)
        y = _simulate_features(equations, rng, _amplitudes_of(equations, one))
        both = _simulate_features(
            equations, rng, _amplitudes_of(equations, one) + _amplitudes_of(equations, two)
        )
        outcomes += _selection_outcome(candidates, cosine, groups, y, {one.source.label})
        outcomes += _selection_outcome(candidates, cosine, groups, both, {one.source.label, two.source.label})
        left = _without_effect(candidates, one.source)
        if left.allowed.any():
            same = not_imitated if _is_not_imitated(left, cosine, one.source) else imitated
            same.append((left, y))
        step(cases + index + 1, 2 * cases)
    left_out = not_imitated or imitated
    outcomes += [one for left, y in left_out for one in _selection_outcome(left, cosine, groups, y, set())]
    return _derive_thresholds(found, effect, structure, outcomes, len(left_out))


def _derive_thresholds(
    found: Array, effect: float, structure: float, outcomes: list[_Outcome], left_out_cases: int
) -> Thresholds:
    """Derive the thresholds from the statistics of no-effect cases (n, 2) and from the other outcomes."""
    cases, right = len(found), [one.remaining for one in outcomes if one.right]
    unexplained = float(np.quantile(right, 1.0 - MAX_WITHHELD)) if right else np.inf
    plain = [one for one in outcomes if one.remaining < unexplained]
    classifier = train_classifier(
        [one.features for one in plain],
        np.array([one.right for one in plain]),
        np.array([one.left_out for one in plain]),
        int(MAX_WRONG_NAMES * left_out_cases),
    )
    named = [one for one in plain if classifier.accepts(one.features)]
    return Thresholds(
        effect, structure, unexplained, classifier,
        float(np.mean((found[:, 0] >= effect) | (found[:, 1] >= structure))),
        1.0 - sum(one.right for one in named) / max(len(right), 1),
        sum(one.left_out for one in named) / left_out_cases if left_out_cases else float("nan"),
        cases,
        left_out_cases,
    )  # fmt: skip


def _detectable_effects(
    candidates: CandidateSet, limits: tuple[Detectability, ...]
) -> list[DetectableEffect]:
    """Return the candidates that are detectable within their bounds."""
    all_seen = [
        DetectableEffect(candidates.equations.hypotheses[h], limits[h].limit, int(candidates.label[h]))
        for h in np.flatnonzero(candidates.allowed)
    ]
    return [one for one in all_seen if can_sample(one)]


def _simulate_features(equations: NormalEquations, rng: np.random.Generator, a: Array) -> Array:
    """Simulate whitened features (m,) for amplitudes a (k,) in standard errors."""
    v = np.where(equations.prior == 1.0, rng.standard_normal(equations.q), 0.0)
    return np.asarray(equations.A @ np.concatenate([v, a]) + rng.standard_normal(equations.layout.size))


def _amplitudes_of(equations: NormalEquations, one: SampledEffect) -> Array:
    """Return the amplitudes (k,) of a sampled effect in standard errors."""
    own = equations.owner == equations.hypotheses.index(one.source.hypothesis)
    a = np.zeros(equations.owner.size)
    a[own] = one.source.hypothesis.departures(one.values) * equations.scale[own]
    return a


def _null_statistics(
    candidates: CandidateSet, groups: tuple[FeatureGroup, ...], y: Array
) -> tuple[float, float]:
    """Return -log10 p of the best hypothesis, and of the lack-of-fit test without effects."""
    rhs = reduce_features(candidates.equations, y)
    fit = fit_linear(candidates.equations, rhs, candidates.equations.columns(()))
    return best_addition(candidates, rhs, ()), find_lack_of_fit(candidates.equations, groups, fit, y)[
        0
    ].neg_log10_p


def _selection_outcome(
    candidates: CandidateSet, cosine: Array, groups: tuple[FeatureGroup, ...], y: Array, true: set[int | None]
) -> list[_Outcome]:
    """Select effects, and compare their classes with the true ones; empty `true` means left out.

    Returns:
        One outcome, or none if nothing was selected.
    """
    rhs = reduce_features(candidates.equations, y)
    selection = select_effects(candidates, rhs)
    if not selection.chosen:
        return []
    fit = fit_linear(candidates.equations, rhs, candidates.equations.columns(selection.chosen))
    remaining = find_lack_of_fit(candidates.equations, groups, fit, y)[0].neg_log10_p
    features = compute_confidence_features(
        candidates, cosine, rhs, selection.chosen, selection.shares, remaining
    )
    right = {int(candidates.label[h]) for h in selection.chosen} <= true
    return [_Outcome(features, right, not true)]


def _without_effect(candidates: CandidateSet, one: DetectableEffect) -> CandidateSet:
    """Exclude an effect at all places, and the hypotheses of its class."""
    same: Flags = np.array(
        [other.effect == one.hypothesis.effect for other in candidates.equations.hypotheses]
    )
    return replace(candidates, allowed=candidates.allowed & ~same & (candidates.label != one.label))


def _is_not_imitated(left: CandidateSet, cosine: Array, one: DetectableEffect) -> bool:
    """Check that no allowed hypothesis with as many parameters imitates the effect."""
    return bool(
        cosine[left.equations.hypotheses.index(one.hypothesis), left.allowed].max() < IMITATION_COSINE
    )


def _joint_thresholds(found: Array) -> tuple[float, float]:
    """Return both thresholds at one common quantile, so that MAX_FALSE_ALARM of the cases reach either."""
    low, high = 1.0 - MAX_FALSE_ALARM, 1.0
    for _ in range(30):
        middle = (low + high) / 2.0
        limit = np.quantile(found, middle, axis=0)
        low, high = (
            (low, middle) if np.mean(np.any(found > limit, axis=1)) <= MAX_FALSE_ALARM else (middle, high)
        )
    effect, structure = np.nextafter(np.quantile(found, high, axis=0), np.inf)
    return float(effect), float(structure)
