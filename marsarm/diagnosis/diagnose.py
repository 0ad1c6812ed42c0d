"""Diagnosis of one case, from residuals to verdict.

`diagnose` takes the effects that `selection` found by the engine that diagnoses any robot. It tests what
remains, and says at which level each effect is known.

For the model y = N v + S a + e with A = [N S], the fit leaves M y, which has the covariance M:

    M = I - A (A'A + P)^-1 A'

For directions Q, the projection Q'M y is tested by a chi-square with covariance Q'M Q. The directions are a
constant and the conditions, in every channel and each of its regimes. The energy of the channel in that
regime is a second test. A last test takes all directions of all channels together.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final, Literal

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.model import MIN_DIRECTION_SHARE, DiagnosisModel, FeatureGroup, condition_directions
from marsarm.diagnosis.normal_equations import (
    LinearFit,
    NormalEquations,
    fit_linear,
    form_normal_equations,
)
from marsarm.diagnosis.problem import INTERVAL_QUANTILES, EffectValues, FeatureLayout, Residuals
from marsarm.diagnosis.selection import FeatureEffect, Selection
from simgap import ConfidenceSet, chi_square_log_p, find_confidence_sets

MAX_MEMBERS: Final = 3
"""Most members of a set: more effects are told as their families, more families as their places."""

INTERVAL_DRAWS: Final = 400
"""Number of bootstrap draws for an interval."""

Verdict = Literal["found", "none", "unknown"]
"""Effects are found; nothing is; or something remains, and no effect explains it."""

Level = Literal["size", "effect", "family", "place", "unlocated"]
"""What is known of a cause: one effect with its size, a few effects, only their families, only their places,
or not even that."""


@dataclass(frozen=True, slots=True)
class ResidualCell:
    """Residual of one channel at one place in one regime."""

    channel: str
    place: str
    regime: str
    features: int
    ratio: float
    """Root mean square of the residual over its noise floor: 1 if there is only noise."""
    least: float
    most: float
    """Upper end of the 90 % interval by a bootstrap over blocks; NaN if there is one block."""


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Result of the lack-of-fit test of one group."""

    neg_log10_p: float
    """-log10 of its probability if the model is right."""
    channel: str
    place: str
    regime: str
    """Regime, or "all"."""
    depends_on: str
    """Condition with the strongest dependence. "nothing" means an offset, "noise" energy without a direction,
    "several" all groups together."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """Effect that may be the cause in place of a finding, or the finding itself."""

    hypothesis: int
    """Hypothesis that stands for its equivalence class."""
    p: float
    """Probability that the finding fits so much better, or more, if this is the cause."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """Selected effect, with fitted values, and what may be the cause in its place."""

    hypothesis: int
    values: Array
    """Fitted values of all parameters, in their order and units, shape (p,)."""
    least: Array
    """Lower end of the 90 % intervals within the bounds, shape (p,); NaN for a shape parameter."""
    most: Array
    """Upper end, shape (p,)."""
    share: float
    """Share of what can be explained that comes back without this effect."""
    level: Level
    alternatives: tuple[Alternative, ...]
    """Effects that cannot be excluded at 5 %, one of each equivalence class, the finding first. They are the
    causes that are possible if the cause is in the catalogue at all."""
    equivalence_class: tuple[int, ...]
    """Hypotheses that this campaign cannot distinguish from the finding, itself included."""
    places: tuple[str, ...]
    """Set of places, the best first; empty if there are more than MAX_MEMBERS."""
    families: tuple[StrEnum, ...]
    """Set of families; empty if the level is "place" or "unlocated"."""
    effects: tuple[int, ...]
    """Set of effects, one hypothesis of each class; empty if the level is "family" or less."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Result of one diagnosis."""

    verdict: Verdict
    findings: tuple[Finding, ...]
    unexplained: tuple[LackOfFit, ...]
    """Lack-of-fit tests after the findings, most significant first."""
    residual_map: tuple[ResidualCell, ...]
    """Map of the residual without effects, at the nuisances that fit beside the findings."""
    effect_fit: LinearFit
    """Linear fit of nuisances and findings."""
    equations: NormalEquations
    """Normal equations that `effect_fit` refers to."""
    has_remainder: bool
    """True if what is left after the findings has structure."""
    nuisance: Array
    """Change of the features by the fitted nuisances, in the units of the channels, shape (m,)."""
    change: Array
    """Change of the features by the findings, in the units of the channels, shape (m,)."""


def diagnose(model: DiagnosisModel, residuals: Residuals, selection: Selection, seed: int) -> Diagnosis:
    """Diagnose one case whose effects are selected.

    Returns:
        Verdict, findings, and what remains unexplained.
    """
    sensitivities = selection.sensitivities
    for h, a in zip(selection.chosen, selection.departures, strict=True):
        sensitivities = sensitivities.linearised(h, a)
    equations = form_normal_equations(sensitivities) if selection.chosen else model.equations
    y = equations.whiten(residuals.value)
    effect_fit = fit_linear(equations, y, equations.columns(selection.chosen))
    without = y - equations.A[:, : equations.q] @ effect_fit.theta[: equations.q]
    cells = map_residual(residuals.layout, without, seed)
    unexplained = find_lack_of_fit(equations, _project_groups(model, equations), effect_fit, y)
    has_remainder = unexplained[0].neg_log10_p >= model.lack_of_fit_limit
    findings = _describe_findings(model, selection, has_remainder)
    verdict: Verdict = "found" if findings else "unknown" if has_remainder else "none"
    values = effect_fit.theta[: equations.q] * equations.nuisance_unit
    nuisance = sensitivities.nuisance[:, sensitivities.shared_nuisances] @ values
    return Diagnosis(
        verdict,
        findings,
        unexplained,
        cells,
        effect_fit,
        equations,
        has_remainder,
        nuisance,
        selection.change(),
    )


def effect_values(diagnosis: Diagnosis) -> EffectValues:
    """Return the values of the findings in the form that a simulator takes.

    Returns:
        Values of all p parameters of each effect in their units, shape (p,).
    """
    hypotheses = diagnosis.equations.hypotheses
    return {hypotheses[finding.hypothesis]: finding.values for finding in diagnosis.findings}


def _describe_findings(
    model: DiagnosisModel, selection: Selection, has_remainder: bool
) -> tuple[Finding, ...]:
    sets = find_confidence_sets(selection.engine)
    places = [_location(model, one) for one in sets]
    described = []
    for one, place in zip(sets, places, strict=True):
        # several effects at one place, or one beside which something remains, may be a single unknown one;
        # if something remains beside effects at several places, it may be at another place
        finest: Level = "place" if has_remainder or places.count(place) > 1 else "size"
        finest = "unlocated" if has_remainder and len(set(places)) > 1 else finest
        described.append(_describe_finding(model, one, selection, finest))
    return tuple(described)


def _location(model: DiagnosisModel, found: ConfidenceSet) -> str:
    effect = found.effect
    assert isinstance(effect, FeatureEffect)
    return model.locations[effect.index]


def _describe_finding(
    model: DiagnosisModel, found: ConfidenceSet, selection: Selection, finest: Level
) -> Finding:
    (own, *_), effect = found.alternatives, found.effect
    assert isinstance(effect, FeatureEffect)
    hypothesis = model.sensitivities.hypotheses[effect.index]
    union, sizes = selection.engine.context.union, selection.engine.chosen.sizes
    columns = union.columns([effect])
    intervals = own.intervals[[int(np.flatnonzero(own.columns == c)[0]) for c in columns]]
    ends = np.transpose([(one.least, one.most) for one in hypothesis.parameters])
    is_amplitude = np.array([one.is_amplitude for one in hypothesis.parameters])
    low, high = (
        np.where(is_amplitude, np.clip(hypothesis.values(end), *ends), np.nan) for end in intervals.T
    )
    alternatives = tuple(
        Alternative(one.effect.index, one.p)
        for one in found.alternatives
        if isinstance(one.effect, FeatureEffect)
    )
    members = [k for one in alternatives for k in model.equivalence_class(one.hypothesis)]
    places = tuple(dict.fromkeys(model.locations[k] for k in members))
    families = tuple(dict.fromkeys(model.families[k] for k in members))
    level = _level(len(alternatives), len(families), len(places), finest)
    return Finding(
        effect.index,
        hypothesis.values(sizes[columns]),
        np.fmin(low, high),
        np.fmax(low, high),
        found.share,
        level,
        alternatives,
        model.equivalence_class(effect.index),
        places if level != "unlocated" else (),
        families if level in ("size", "effect", "family") else (),
        tuple(one.hypothesis for one in alternatives) if level in ("size", "effect") else (),
    )


def _level(n_effects: int, n_families: int, n_places: int, finest: Level) -> Level:
    """Return the level, not finer than allowed, at which a set has at most MAX_MEMBERS members."""
    if n_places > MAX_MEMBERS or finest == "unlocated":
        return "unlocated"
    if n_families > MAX_MEMBERS or finest == "place":
        return "place"
    if n_effects > MAX_MEMBERS:
        return "family"
    return "size" if n_effects == 1 else "effect"


def _project_groups(model: DiagnosisModel, equations: NormalEquations) -> tuple[FeatureGroup, ...]:
    """Return the feature groups, projected to the present columns."""
    return tuple(replace(group, AQ=equations.A[group.rows].T @ group.Q) for group in model.groups)


def map_residual(layout: FeatureLayout, residual: Array, seed: int) -> tuple[ResidualCell, ...]:
    """Compute the root mean square of the residual by channel, place and regime.

    Args:
        layout: Description of the m features.
        residual: Residual in units of the noise floor, shape (m,).

    Returns:
        Cells, largest ratio first.
    """
    rng = np.random.default_rng(seed)
    count = len(layout.blocks)
    weight = rng.multinomial(count, np.full(count, 1.0 / count), size=INTERVAL_DRAWS).astype(float)
    result = []
    of = np.stack([layout.channel, layout.place, layout.regime])
    for channel, place, regime in np.unique(of, axis=1).T:
        rows = np.flatnonzero(np.all(of == [[channel], [place], [regime]], axis=0))
        n = np.bincount(layout.block[rows], minlength=count)
        square = np.bincount(layout.block[rows], residual[rows] ** 2, minlength=count)
        least, most = _interval(weight @ square, weight @ n) if np.count_nonzero(n) > 1 else (np.nan, np.nan)
        result.append(ResidualCell(
            layout.channels[channel], layout.places[place], layout.regimes[regime], rows.size,
            float(np.sqrt(square.sum() / n.sum())), least, most,
        ))  # fmt: skip
    return tuple(sorted(result, key=lambda cell: -cell.ratio))


def _interval(square: Array, n: Array) -> tuple[float, float]:
    """Return the interval of drawn root mean squares."""
    ratios = np.sqrt(square[n > 0.0] / n[n > 0.0])
    least, most = np.quantile(ratios, INTERVAL_QUANTILES)
    return float(least), float(most)


def find_lack_of_fit(
    equations: NormalEquations, groups: tuple[FeatureGroup, ...], fit: LinearFit, y: Array
) -> tuple[LackOfFit, ...]:
    """Test every group, and all groups together, for structure.

    Args:
        y: Whitened features, shape (m,).

    Returns:
        Results, most significant first; the greater -log10 p of both tests counts.
    """
    rest = np.asarray(y - equations.A[:, fit.active] @ fit.theta)
    total, freedom, found = 0.0, 0, []
    for group in groups:
        statistic, d = _chi_square(group, fit, rest)
        whole = group.regime is None
        total, freedom = total + statistic * whole, freedom + d * whole
        energy, n = _energy(equations, group, fit, rest)
        of_direction, of_energy = _neg_log10_p(statistic, d), _neg_log10_p(energy, n)
        found.append((max(of_direction, of_energy), of_direction >= of_energy, group))
    together = _neg_log10_p(total, max(freedom, 1))
    result = [
        _describe(equations.layout, group, rest, larger, by_direction)
        for larger, by_direction, group in found
    ]
    everywhere = LackOfFit(together, "all", "all", "all", "several")
    return tuple(sorted([*result, everywhere], key=lambda one: -one.neg_log10_p))


def _neg_log10_p(statistic: float, freedom: float) -> float:
    return -chi_square_log_p(statistic, freedom) / float(np.log(10.0))


def _chi_square(group: FeatureGroup, fit: LinearFit, rest: Array) -> tuple[float, int]:
    """Return statistic and degrees of freedom of the directions of a group."""
    AQ = group.AQ[fit.active]
    s, V = np.linalg.eigh(np.eye(group.Q.shape[1]) - AQ.T @ fit.covariance @ AQ)
    kept = s > MIN_DIRECTION_SHARE
    along = V[:, kept].T @ (group.Q.T @ rest[group.rows])
    return float(np.sum(along**2 / s[kept])), int(kept.sum())


def _energy(
    equations: NormalEquations, group: FeatureGroup, fit: LinearFit, rest: Array
) -> tuple[float, float]:
    """Return the sum of squares in a group, and its expectation."""
    A = equations.A[np.ix_(group.rows, fit.active)]
    expected = group.rows.size - float(np.sum((A @ fit.covariance) * A))
    return float(np.sum(rest[group.rows] ** 2)), max(expected, 1.0)


def _describe(
    layout: FeatureLayout, group: FeatureGroup, rest: Array, neg_log10_p: float, by_direction: bool
) -> LackOfFit:
    """Return the test result with its names."""
    along = np.abs(condition_directions(layout, group.rows).T @ rest[group.rows])
    names = ("nothing", *layout.conditions)
    places = np.bincount(layout.place[group.rows])
    return LackOfFit(
        neg_log10_p, layout.channels[group.channel], layout.places[int(np.argmax(places))],
        "all" if group.regime is None else layout.regimes[group.regime],
        names[int(np.argmax(along))] if by_direction else "noise",
    )  # fmt: skip
