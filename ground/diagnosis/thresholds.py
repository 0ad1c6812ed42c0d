"""How surprising a finding must be: found from simulated cases of this very campaign, before data.

Cases without effect set when an effect may be claimed at all. Cases of one effect and of two, raced with all
hypotheses, set when what remains after the best model means that the cause is not among them. Those, and
cases of one effect that was taken out of the catalogue, teach when a name may be trusted.

Of those taken out only strangers teach. Where viscous friction is left out, Coulomb friction of the joint
passes for it, and nothing in the data can tell; what is in no catalogue has no such next of kin there.
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
"""Of each kind."""
MAX_FALSE_ALARM: Final = 0.04
"""Share of no-effect cases in which anything may be claimed: below 5 % by one sigma of what CASES tell."""
MAX_WITHHELD: Final = 0.02
"""Share of cases of the right model that may be given up for what remains."""
MAX_WRONG_NAMES: Final = 0.13
"""Share of strangers that may be given a wrong name."""
NEAR_ALIAS_COSINE: Final = 0.8
"""|cos| from which on an effect is no stranger to another: that explains two thirds of what it shows."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """In -log10 of a probability, with the rates that they had on simulated cases."""

    effect: float
    """A hypothesis must be as surprising as this."""
    structure: float
    """Without any effect chosen: what remains is structure from here on."""
    unexplained: float
    """With effects chosen: what remains is not explained by them from here on."""
    trust: ConfidenceClassifier
    """Whether a name may be given otherwise."""
    false_alarm: float
    """Share of no-effect cases called an effect or unknown."""
    disowned: float
    """Share of cases in which the right effects were chosen that were called unknown."""
    wrong: float
    """Share of cases of one stranger given a name; NaN if there are none, or nothing to be named."""
    cases: int
    """Simulated, of each kind but strangers."""
    strangers: int
    """Simulated; all that were taken out where none is a stranger."""


@dataclass(frozen=True, slots=True)
class _Outcome:
    """One simulated case in which something was chosen."""

    features: ConfidenceFeatures
    right: bool
    left_out: bool

    @property
    def remaining(self) -> float:
        """The most surprising of what remains."""
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
    """From `cases` simulated cases of each kind; `step(done, of)` is told how far it is."""
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
    strangers: list[tuple[CandidateSet, Array]] = []
    with_alias: list[tuple[CandidateSet, Array]] = []
    known = _detectable_effects(candidates, limits)
    for index in range(cases if known else 0):
        one = sample_amplitude(sample_effect(known, rng), rng)
        others = [other for other in known if other.label != one.source.label] or known
        two = sample_amplitude(sample_effect(others, rng), rng)
        y = _simulate_features(equations, rng, _amplitudes_of(equations, one))
        both = _simulate_features(
            equations, rng, _amplitudes_of(equations, one) + _amplitudes_of(equations, two)
        )
        outcomes += _selection_outcome(candidates, cosine, groups, y, {one.source.label})
        outcomes += _selection_outcome(candidates, cosine, groups, both, {one.source.label, two.source.label})
        left = _without_effect(candidates, one.source)
        if left.allowed.any():
            same = strangers if _has_no_alias(left, cosine, one.source) else with_alias
            same.append((left, y))
        step(cases + index + 1, 2 * cases)
    left_out = strangers or with_alias
    outcomes += [one for left, y in left_out for one in _selection_outcome(left, cosine, groups, y, set())]
    return _derive_thresholds(found, effect, structure, outcomes, len(left_out))


def _derive_thresholds(
    found: Array, effect: float, structure: float, outcomes: list[_Outcome], strangers: int
) -> Thresholds:
    """Of no-effect cases (n, 2), and of those in which something was chosen, so many raced as strangers."""
    cases, right = len(found), [one.remaining for one in outcomes if one.right]
    unexplained = float(np.quantile(right, 1.0 - MAX_WITHHELD)) if right else np.inf
    plain = [one for one in outcomes if one.remaining < unexplained]
    trust = train_classifier(
        [one.features for one in plain],
        np.array([one.right for one in plain]),
        np.array([one.left_out for one in plain]),
        int(MAX_WRONG_NAMES * strangers),
    )
    named = [one for one in plain if trust.accepts(one.features)]
    return Thresholds(
        effect, structure, unexplained, trust,
        float(np.mean((found[:, 0] >= effect) | (found[:, 1] >= structure))),
        1.0 - sum(one.right for one in named) / max(len(right), 1),
        sum(one.left_out for one in named) / strangers if strangers else float("nan"),
        cases,
        strangers,
    )  # fmt: skip


def _detectable_effects(
    candidates: CandidateSet, limits: tuple[Detectability, ...]
) -> list[DetectableEffect]:
    """All that may be chosen and that its bounds leave room for."""
    all_seen = [
        DetectableEffect(candidates.equations.hypotheses[h], limits[h].limit, int(candidates.label[h]))
        for h in np.flatnonzero(candidates.allowed)
    ]
    return [one for one in all_seen if can_sample(one)]


def _simulate_features(equations: NormalEquations, rng: np.random.Generator, t: Array) -> Array:
    """Whitened features of a case of sizes t (K,) in standard errors, (m,)."""
    v = np.where(equations.prior == 1.0, rng.standard_normal(equations.q), 0.0)
    return np.asarray(equations.A @ np.concatenate([v, t]) + rng.standard_normal(equations.layout.size))


def _amplitudes_of(equations: NormalEquations, one: SampledEffect) -> Array:
    """What was drawn as sizes (K,)."""
    own = equations.owner == equations.hypotheses.index(one.source.hypothesis)
    t = np.zeros(equations.owner.size)
    t[own] = one.source.hypothesis.departures(one.values) * equations.scale[own]
    return t


def _null_statistics(
    candidates: CandidateSet, groups: tuple[FeatureGroup, ...], y: Array
) -> tuple[float, float]:
    """Surprise of the best hypothesis, and of what remains without any."""
    rhs = reduce_features(candidates.equations, y)
    fit = fit_linear(candidates.equations, rhs, candidates.equations.columns(()))
    return best_addition(candidates, rhs, ()), find_lack_of_fit(candidates.equations, groups, fit, y)[
        0
    ].neg_log10_p


def _selection_outcome(
    candidates: CandidateSet, cosine: Array, groups: tuple[FeatureGroup, ...], y: Array, true: set[int | None]
) -> list[_Outcome]:
    """What was chosen and whether it is right, by class; nothing if none was. No truth: it was left out."""
    rhs = reduce_features(candidates.equations, y)
    selection = select_effects(candidates, rhs)
    if not selection.chosen:
        return []
    fit = fit_linear(candidates.equations, rhs, candidates.equations.columns(selection.chosen))
    left = find_lack_of_fit(candidates.equations, groups, fit, y)[0].neg_log10_p
    features = compute_confidence_features(candidates, cosine, rhs, selection.chosen, selection.shares, left)
    right = {int(candidates.label[h]) for h in selection.chosen} <= true
    return [_Outcome(features, right, not true)]


def _without_effect(candidates: CandidateSet, one: DetectableEffect) -> CandidateSet:
    """The same without an effect, at all places, and without what is of its class."""
    same: Flags = np.array(
        [other.effect == one.hypothesis.effect for other in candidates.equations.hypotheses]
    )
    return replace(candidates, allowed=candidates.allowed & ~same & (candidates.label != one.label))


def _has_no_alias(left: CandidateSet, cosine: Array, one: DetectableEffect) -> bool:
    """Whether nothing that is left is like it; those of another number of parameters are like none."""
    return bool(
        cosine[left.equations.hypotheses.index(one.hypothesis), left.allowed].max() < NEAR_ALIAS_COSINE
    )


def _joint_thresholds(found: Array) -> tuple[float, float]:
    """Thresholds at one quantile of both, so that FALSE_ALARM of the cases reach either."""
    low, high = 1.0 - MAX_FALSE_ALARM, 1.0
    for _ in range(30):
        middle = (low + high) / 2.0
        limit = np.quantile(found, middle, axis=0)
        low, high = (
            (low, middle) if np.mean(np.any(found > limit, axis=1)) <= MAX_FALSE_ALARM else (middle, high)
        )
    effect, structure = np.nextafter(np.quantile(found, high, axis=0), np.inf)
    return float(effect), float(structure)
