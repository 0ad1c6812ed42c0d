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
    DiagnosisModel,
    LinearFit,
    fit_linear,
    form_normal_equations,
)
from marsarm.diagnosis.problem import CONDITIONS, Departures, FeatureLayout, Ints
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

MIN_DIRECTION_SHARE: Final = 1e-6
"""Directions below this share of the largest are not tested."""
MIN_GROUP_FEATURES: Final = 4
"""Least number of features in a group."""
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
    total, freedom, found, layout = 0.0, 0, [], model.sensitivities.layout
    groups = group_features(layout)
    limit = np.log(FALSE_ALARM / KINDS_OF_TEST / (2 * len(groups) + 1))
    for regime, rows in groups:
        directions = condition_directions(layout, rows)
        statistic, d = _chi_square(directions, fit, rest, rows)
        whole = not regime
        total, freedom = total + statistic * whole, freedom + d * whole
        A = fit.A[rows]
        energy = float(np.sum(rest[rows] ** 2))
        n = max(rows.size - float(np.sum((A @ fit.covariance) * A)), 1.0)  # the energy that is expected
        of_direction, of_energy = chi_square_log_p(statistic, d), chi_square_log_p(energy, n)
        along = np.abs(directions.T @ rest[rows]) * (of_direction <= of_energy)
        found.append((min(of_direction, of_energy), _describe(layout, regime, rows, rest[rows], along)))
    mean = float(np.mean(np.abs(rest)))
    everywhere = Remainder("all channels together", "all motion", mean, FeatureResiduals.units[0], "", 0.0)
    found = [(log_p, one) for log_p, one in found if log_p <= limit]
    if not found and chi_square_log_p(total, max(freedom, 1)) <= limit:
        yield everywhere
    largest: dict[str, Remainder] = {}
    for _, one in sorted(found, key=lambda pair: pair[0]):
        largest.setdefault(one.joint, one)
    yield from largest.values()


def group_features(layout: FeatureLayout) -> list[tuple[str, Ints]]:
    """Group the features that are tested together: those of a channel, and of each of its regimes.

    Return the regime, "" for all of them, and the rows of each group.
    """
    result = []
    for channel in dict.fromkeys(layout.channel.tolist()):
        mine = layout.channel == channel
        regimes = dict.fromkeys(layout.regime[mine].tolist())
        result.append(("", np.flatnonzero(mine)))
        if len(regimes) > 1:
            result += [(one, np.flatnonzero(mine & (layout.regime == one))) for one in regimes]
    return [(regime, rows) for regime, rows in result if rows.size >= MIN_GROUP_FEATURES]


def condition_directions(layout: FeatureLayout, rows: Ints) -> Array:
    """Compute directions (n, d) of norm 1 or 0 for n features: a constant, and the centred conditions."""
    centred = layout.condition[rows] - layout.condition[rows].mean(axis=0)
    all_of = np.column_stack([np.ones(rows.size), centred])
    norm = np.linalg.norm(all_of, axis=0)
    small = norm <= MIN_DIRECTION_SHARE * np.maximum(np.linalg.norm(layout.condition, axis=0), 1.0).max()
    return np.asarray(all_of * np.where(small, 0.0, 1.0 / np.where(small, 1.0, norm)))


def _chi_square(directions: Array, fit: LinearFit, rest: Array, rows: Ints) -> tuple[float, int]:
    """Return statistic and degrees of freedom of some directions (n, d) for n features."""
    U, norm, _ = np.linalg.svd(directions, full_matrices=False)
    Q = U[:, norm > MIN_DIRECTION_SHARE * norm[0]]
    AQ = fit.A[rows].T @ Q
    s, V = np.linalg.eigh(np.eye(Q.shape[1]) - AQ.T @ fit.covariance @ AQ)
    kept = s > MIN_DIRECTION_SHARE
    along = V[:, kept].T @ (Q.T @ rest[rows])
    return float(np.sum(along**2 / s[kept])), int(kept.sum())


def _describe(layout: FeatureLayout, regime: str, rows: Ints, left: Array, along: Array) -> Remainder:
    """Describe what is left in a group, by its parts along the directions, (d,).

    It depends on nothing if its offset or its energy is the largest; for its energy the parts are 0.
    """
    strongest, regime = int(np.argmax(along)), regime or "all motion"
    return Remainder(
        joint=str(layout.channel[rows[0]]),
        regime=REGIMES.get(regime, regime),
        mean_abs=float(np.mean(np.abs(left * layout.sigma[rows]))),
        unit=str(layout.unit[rows[0]]),
        depends_on=CONDITIONS[strongest - 1] if strongest > 0 else "",
        depends_share=float(along[strongest] ** 2 / (left @ left)) if strongest > 0 else 0.0,
    )
