"""Diagnosis of one case, from residuals to findings and remainders in the records of `simgap`.

`diagnose` takes the effects that `selection` found by the engine that diagnoses any robot. It tests what
remains, and says at which level each effect is known.

For the model y = N v + S a + e with A = [N S], the fit leaves M y, which has the covariance M:

    M = I - A (A'A + P)^-1 A'

For directions Q, the projection Q'M y is tested by a chi-square with covariance Q'M Q. The directions are a
constant and the conditions, in every channel and each of its regimes. The energy of the channel in that
regime is a second test. A last test takes all directions of all channels together.

In all functions, `value` are measured minus nominal features, and `rows` are residuals as in
`Explanation.residuals`, in the units of the channels, (m,) each; `sigma` is their noise, (m,). The whitened
features are `y`, (m,).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.model import (
    KINDS_OF_TEST,
    MIN_DIRECTION_SHARE,
    DiagnosisModel,
    FeatureGroup,
    LinearFit,
    condition_directions,
    fit_linear,
    form_normal_equations,
)
from marsarm.diagnosis.problem import CONDITIONS, Departures, FeatureLayout
from marsarm.diagnosis.selection import FeatureResiduals, FeatureSelection
from simgap import (
    ConfidenceSet,
    Diagnosis,
    Finding,
    JointError,
    Remainder,
    chi_square_log_p,
    find_confidence_sets,
)
from simgap.next_motion.rivals import list_rivals
from simgap.report.sentences import join_words
from simgap.selection.chance import FALSE_ALARM

NORMAL_MEAN: Final = float(np.sqrt(2.0 / np.pi))
"""Mean absolute value of normal noise, over its standard deviation."""
NEXT_MOTION: Final = "the motion that `marsarm gap next` proposes"
"""What to record where several effects are left."""
REGIMES: Final = {"rest": "at rest", "pose": "at rest", "reversal": "after a reversal"}
"""Regimes of features in words, where they are not those of any robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Diagnosis of the fitted motions, and what a simulator needs to test it on others."""

    diagnosis: Diagnosis
    """Its errors are those of the fitted motions."""
    departures: Departures
    nuisance: Array
    """Fitted shared nuisances in their units, shape (q,)."""
    covariance: Array
    """Covariance of these in the same units, shape (q, q)."""
    residuals: tuple[Array, Array, Array]
    """Measured minus predicted in the units of the channels, shape (m,) each: without nuisances, with them,
    and with the findings too."""


def diagnose(model: DiagnosisModel, value: Array, selection: FeatureSelection) -> Explanation:
    """Diagnose one case whose effects are selected."""
    sensitivities = selection.sensitivities
    for h, a in zip(selection.chosen, selection.departures.values(), strict=True):
        sensitivities = sensitivities.linearised(h, a)
    equations = form_normal_equations(sensitivities) if selection.chosen else model.equations
    y, q = equations.whiten(value), equations.q
    fit = fit_linear(equations, y, selection.chosen)
    remaining = tuple(find_lack_of_fit(model, fit, y))
    shared = sensitivities.shared_nuisances
    unit = sensitivities.sigma[shared]
    nuisance = fit.theta[:q] * unit
    base = value - sensitivities.nuisance[:, shared] @ nuisance
    rows = value, base, base - selection.sensitivities.change(selection.departures)
    engine, sets = selection.engine, find_confidence_sets(selection.engine)
    findings = tuple(_describe_findings(model, selection, sets, bool(remaining)))
    diagnosis = Diagnosis(
        robot="",
        kind=FeatureResiduals.kind,
        seed=engine.context.seed,
        findings=findings,
        base=(),
        errors=tuple(list_errors(model.sensitivities.layout, rows, model.sensitivities.layout.sigma)),
        remaining=remaining,
        refused=(),
        fitted_motions=engine.context.model.motions,
        judged_motions=(),
        effects=tuple(selection.departures),
        sizes=tuple(tuple(a.tolist()) for a in selection.departures.values()),
        rivals=list_rivals(engine.context, engine.chosen, sets, findings),
        method=FeatureResiduals.method,
    )
    covariance = fit.covariance[:q, :q] * np.outer(unit, unit)
    return Explanation(diagnosis, selection.departures, nuisance, covariance, rows)


def list_errors(layout: FeatureLayout, rows: Sequence[Array], sigma: Array) -> Iterator[JointError]:
    """Yield the mean errors of each channel that has features."""
    for channel in dict.fromkeys(layout.channel.tolist()):
        own = layout.channel == channel
        nominal, base, explained = (float(np.mean(np.abs(one[own]))) for one in rows)
        floor = NORMAL_MEAN * float(np.mean(sigma[own]))
        unit = str(layout.unit[own][0])
        yield JointError(channel, unit, nominal, base, explained, floor, FeatureResiduals.kind)


def _describe_findings(
    model: DiagnosisModel, selection: FeatureSelection, sets: Sequence[ConfidenceSet], has_remainder: bool
) -> Iterator[Finding]:
    """Describe findings: the sets of a level that is too fine are empty, and without one all places stay."""
    every, union = model.sensitivities.hypotheses, selection.engine.context.union
    found_at = [hypothesis.location for hypothesis in selection.departures]
    is_anywhere = has_remainder and len(set(found_at)) > 1  # what remains may be at another place
    for found, (hypothesis, size) in zip(sets, selection.departures.items(), strict=True):
        # several effects at one place, or one beside which something remains, may be a single unknown one
        is_named = not has_remainder and found_at.count(hypothesis.location) == 1
        own, index = found.alternatives[0], model.sensitivities.index(hypothesis.key)
        columns = [int(np.flatnonzero(own.columns == c)[0]) for c in union.columns([hypothesis])]
        ends = np.sort([hypothesis.values(end) for end in own.intervals[columns].T], axis=0)
        bounds = np.transpose([(one.least, one.most) for one in hypothesis.parameters])
        members = [
            every[k]
            for one in found.alternatives
            for k in model.equivalence_class(model.sensitivities.index(one.effect.key))
        ]
        alike = [f"{every[k].name} at {every[k].place}" for k in model.equivalence_class(index) if k != index]
        sizes = hypothesis.name_sizes(size)
        same = f"; or {join_words(alike, 'or')}, which looks the same here" if alike else ""
        yield Finding(
            place=hypothesis.place,
            family=hypothesis.family,
            effect=hypothesis.name,
            size=tuple(sizes.values()),
            size_names=tuple(sizes),
            interval=tuple((float(low), float(high)) for low, high in np.clip(ends, *bounds).T),
            text=hypothesis.describe(size) + same,
            share=found.share,
            places=tuple(dict.fromkeys(one.location for one in (every if is_anywhere else members))),
            families=tuple(dict.fromkeys(one.family for one in members)) if is_named else (),
            effects=tuple(one.effect.key for one in found.alternatives) if is_named else (),
            next_motion=NEXT_MOTION if len(found.alternatives) > 1 or not is_named else "",
        )


def find_lack_of_fit(model: DiagnosisModel, fit: LinearFit, y: Array) -> Iterator[Remainder]:
    """Test every group, and all groups together, for structure.

    All tests together have their part of the probability of a false alarm (Bonferroni). The lesser p of both
    tests of a group counts. Of each channel the most significant group is yielded, the most significant
    first; all channels together only if none is by itself.
    """
    rest = np.asarray(y - fit.A @ fit.theta)
    total, freedom, found = 0.0, 0, []
    limit = np.log(FALSE_ALARM / KINDS_OF_TEST / (2 * len(model.groups) + 1))
    for group in model.groups:
        statistic, d = _chi_square(group, fit, rest)
        whole = group.regime is None
        total, freedom = total + statistic * whole, freedom + d * whole
        A = fit.A[group.rows]
        energy = float(np.sum(rest[group.rows] ** 2))
        n = max(group.rows.size - float(np.sum((A @ fit.covariance) * A)), 1.0)  # the energy that is expected
        of_direction, of_energy = chi_square_log_p(statistic, d), chi_square_log_p(energy, n)
        remainder = _describe(model.sensitivities.layout, group, rest, of_direction <= of_energy)
        found.append((min(of_direction, of_energy), remainder))
    mean = float(np.mean(np.abs(rest)))
    everywhere = Remainder("all channels together", "all motion", mean, FeatureResiduals.units[0], "", 0.0)
    found = [(log_p, one) for log_p, one in found if log_p <= limit]
    if not found and chi_square_log_p(total, max(freedom, 1)) <= limit:
        yield everywhere
    largest: dict[str, Remainder] = {}
    for _, one in sorted(found, key=lambda pair: pair[0]):
        largest.setdefault(one.joint, one)
    yield from largest.values()


def _chi_square(group: FeatureGroup, fit: LinearFit, rest: Array) -> tuple[float, int]:
    """Return statistic and degrees of freedom of the directions of a group."""
    AQ = fit.A[group.rows].T @ group.Q
    s, V = np.linalg.eigh(np.eye(group.Q.shape[1]) - AQ.T @ fit.covariance @ AQ)
    kept = s > MIN_DIRECTION_SHARE
    along = V[:, kept].T @ (group.Q.T @ rest[group.rows])
    return float(np.sum(along**2 / s[kept])), int(kept.sum())


def _describe(layout: FeatureLayout, group: FeatureGroup, rest: Array, by_direction: bool) -> Remainder:
    """Describe what is left in a group; it depends on nothing if its offset or its energy is the largest."""
    left = rest[group.rows]
    along = np.abs(condition_directions(layout, group.rows).T @ left)
    strongest = int(np.argmax(along))
    is_named = by_direction and strongest > 0
    regime = group.regime or "all motion"
    return Remainder(
        joint=group.channel,
        regime=REGIMES.get(regime, regime),
        mean_abs=float(np.mean(np.abs(left * layout.sigma[group.rows]))),
        unit=str(layout.unit[group.rows[0]]),
        depends_on=CONDITIONS[strongest - 1] if is_named else "",
        depends_share=float(along[strongest] ** 2 / (left @ left)) if is_named else 0.0,
    )
