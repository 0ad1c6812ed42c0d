"""Diagnosis of one case, from residuals to verdict.

`diagnose` takes the effects that `selection` found by the engine that diagnoses any robot. It tests what
remains (`residual_analysis`), and says at which level each effect is known.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final, Literal

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.feature_residuals import FeatureEffect
from marsarm.diagnosis.linear_fit import LinearFit, fit_linear
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.normal_equations import (
    NormalEquations,
    form_normal_equations,
)
from marsarm.diagnosis.problem import EffectValues, Residuals
from marsarm.diagnosis.residual_analysis import (
    FeatureGroup,
    LackOfFit,
    ResidualCell,
    find_lack_of_fit,
    map_residual,
)
from marsarm.diagnosis.selection import Selection
from simgap import ConfidenceSet, find_confidence_sets

MAX_MEMBERS: Final = 3
"""Most members of a set: more effects are told as their families, more families as their places."""

Verdict = Literal["found", "none", "unknown"]
"""Effects are found; nothing is; or something remains, and no effect explains it."""
Level = Literal["size", "effect", "family", "place", "unlocated"]
"""What is known of a cause: one effect with its size, a few effects, only their families, only their places,
or not even that."""


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

    Args:
        model: Diagnosis model of the campaign.
        residuals: Residuals of the case.
        selection: Selected effects.
        seed: Seed of all random draws.

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

    Args:
        diagnosis: Diagnosis with findings.

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
