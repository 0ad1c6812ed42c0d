"""Diagnosis of one case of this arm, with a campaign whose sensitivities are known.

`diagnose_case` restricts the campaign to the features of the case, and fits the nuisances with the simulator
(`case_simulator`). It diagnoses the residual, and tests the findings on held-out motion.

In all functions, `rows` are residuals as in `marsarm.diagnosis.diagnose`, and `sigma` is their noise, (m,).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array, skew
from marsarm.common.pool import Runner
from marsarm.common.requests import NOMINAL_ARM
from marsarm.diagnosis.arm.audit import audit_recordings
from marsarm.diagnosis.arm.campaign_sensitivities import compute_sensitivities
from marsarm.diagnosis.arm.case_simulator import (
    CaseSimulator,
    build_case_simulator,
    fit_nuisances,
)
from marsarm.diagnosis.arm.feature_set import build_feature_set
from marsarm.diagnosis.arm.logs import NotForDiagnosis, Recording
from marsarm.diagnosis.diagnose import Explanation, diagnose, list_errors
from marsarm.diagnosis.model import DiagnosisModel, build_model
from marsarm.diagnosis.problem import Sensitivities
from marsarm.diagnosis.selection import FeatureResiduals
from sim.effects.effect import Effect
from sim.plant import SCREW_AXES
from simgap import Diagnosis, JointError, Trace
from simgap.common.progress import Progress, part_of

MIN_FEATURE_SHARE: Final = 0.5
"""Least share of the campaign's features that a case must have."""
OWN_FLOOR_RATIO: Final = 1.2
"""Ratio to the campaign's noise floor from which on the noise floor of the case replaces it."""


@dataclass(frozen=True, slots=True, eq=False)
class CampaignModel:
    """Campaign whose motions a case repeats."""

    model: DiagnosisModel
    """Diagnosis model of the fitted motions."""
    held_out: Sensitivities | None
    """Sensitivities of the held-out motions, if there are any."""


def load_campaign_model(
    logs: Sequence[Path],
    held_out: Sequence[Path],
    kept_in: Path,
    run: Runner,
    progress: Progress,
    kinds: Sequence[str] | None = None,
    arm: str = NOMINAL_ARM,
) -> CampaignModel:
    """Load the campaign model of these logs; compute in minutes what is not cached.

    BadRequest if a cached file cannot be read, BadOutput if one cannot be written.
    """
    share, held = len(logs) / (len(logs) + len(held_out)), None
    fitted = compute_sensitivities(logs, kept_in, run, part_of(progress, 0.0, share), kinds, (), arm)
    if held_out:
        rest = part_of(progress, share, 1.0)
        held = compute_sensitivities(held_out, kept_in, run, rest, kinds, logs, arm)
    return CampaignModel(build_model(fitted), held)


def compute_tool_error(
    keys: Sequence[str], rows: Sequence[Array], sigma: Array, drawing: Params
) -> JointError | None:
    """Compute the root mean square tool error over rests and the tools; None without whole poses.

    A turret that is rotated by w and shifted by v moves its tool at p by v + w x p. Features, by their keys,
    are in the turret frame.
    """
    known: dict[str, dict[str, int]] = {}
    for row, key in enumerate(keys):
        rest, _, axis = key.rpartition("/")
        known.setdefault(rest, {})[axis] = row
    at = np.array([[of[axis] for axis in SCREW_AXES] for of in known.values() if of.keys() >= {*SCREW_AXES}])
    if not at.size:
        return None
    tools = configure(drawing).arm.X_FT
    J = np.array([np.hstack([-skew(X.p[:, None])[:, :, 0], np.eye(3)]) for X in tools.values()])
    nominal, base, explained = (
        float(np.sqrt(np.mean(np.sum(np.einsum("tij,rj->rti", J, of[at]) ** 2, axis=2)))) for of in rows
    )
    floor = float(np.sqrt(np.mean(np.einsum("tij,rj->rt", J**2, sigma[at] ** 2))))
    return JointError("tool", "m", nominal, base, explained, floor, FeatureResiduals.kind)


@dataclass(frozen=True, slots=True)
class CaseDiagnosis:
    """Diagnosis of a case, with what its files need."""

    diagnosis: Diagnosis
    traces: tuple[Trace, ...]
    """Features of the fitted motions, measured and predicted without and with the findings."""
    model: DiagnosisModel | None = None
    """Model of the features that were fitted."""
    params: Params | None = None
    """Flight parameters of the arm; None where no request named its logs."""
    digests: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of logs and parameters."""


def diagnose_case(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    campaign: CampaignModel,
    seed: int,
    patch: tuple[Effect, ...] = (),
) -> CaseDiagnosis:
    """Diagnose a case: fit its nuisances, find its effects, and judge them on held-out motion.

    NotForDiagnosis if most motions of the campaign are missing, or too few to show any effect.
    """
    if not recordings:
        raise NotForDiagnosis("there is no log that a diagnosis could be made of")
    recordings, held_out = (sorted(some, key=attrgetter("name")) for some in (recordings, held_out))
    feature_set, sensitivities = build_feature_set(recordings), campaign.model.sensitivities
    first = build_case_simulator(feature_set, sensitivities.layout, len(sensitivities.nuisances), patch)
    missing = _find_missing(first, campaign)
    model = _restrict_model(campaign.model, first)
    fit, selection = fit_nuisances(model, first, seed)
    found = diagnose(model, fit.residual(model.sensitivities.nuisance), selection)
    shown = count_shown(model, found.diagnosis)
    remarks = (*audit_recordings(recordings), *missing, *first.floor_notes, shown)
    diagnosis = replace(
        found.diagnosis,
        robot=feature_set.arm.name,
        fitted_motions=tuple(dict.fromkeys(one.recording.name for one in feature_set.list_features())),
        remarks=tuple(f"{one}." for one in remarks),
    )
    if campaign.held_out is not None and held_out:
        errors = _judge_held_out(found, fit, held_out, campaign.held_out)
        judged = tuple(one.name for one in held_out)
        diagnosis = replace(diagnosis, errors=errors, judged_motions=judged) if errors else diagnosis
    return CaseDiagnosis(diagnosis, tuple(_make_traces(fit, found)), model)


def count_shown(model: DiagnosisModel, diagnosis: Diagnosis) -> str:
    """Say how many effects the motions can show; NotForDiagnosis if none, so that agreement means nothing."""
    seen = int(np.sum(model.family_wise_limits <= 1.0))
    shown = f"these motions would show {seen} of {len(model.limits)} effects at their typical size"
    if not (seen or diagnosis.findings or diagnosis.remaining):
        raise NotForDiagnosis(f"too little motion for a diagnosis: {shown}")
    return shown


def _make_traces(case: CaseSimulator, found: Explanation) -> Iterator[Trace]:
    """Yield the features of each channel in each session in motion, without any fit and with the findings."""
    layout, (nominal, _, explained), measured = case.layout, found.residuals, case.measured[case.at]
    series: dict[tuple[str, str], list[int]] = {}
    for row, (channel, key) in enumerate(zip(layout.channel.tolist(), layout.key.tolist(), strict=True)):
        session, name = key.split("/", 1)
        if name.startswith("motion "):
            series.setdefault((channel, session), []).append(row)
    for (channel, session), own in series.items():
        rows = np.array(own)[np.argsort(layout.time_s[own])]
        numbers = (values[rows] for values in (measured, nominal, explained))
        yield Trace(
            channel, FeatureResiduals.kind, session, str(layout.unit[rows[0]]), layout.time_s[rows], *numbers
        )


def _restrict_model(campaign: DiagnosisModel, case: CaseSimulator) -> DiagnosisModel:
    """Restrict the campaign to the features of the case, with the higher of both noise floors."""
    found = campaign.sensitivities.select(case.rows)
    higher = np.maximum(found.layout.sigma, case.layout.sigma)
    if len(case.rows) == campaign.sensitivities.layout.size and np.all(
        higher < OWN_FLOOR_RATIO * found.layout.sigma
    ):
        return campaign
    layout = replace(found.layout, sigma=higher)
    return build_model(replace(found, layout=layout), campaign.left_out_effect)


def _judge_held_out(
    found: Explanation,
    fit: CaseSimulator,
    recordings: Sequence[Recording],
    sensitivities: Sensitivities,
) -> tuple[JointError, ...]:
    """List the errors of channels and tool on held-out motion; none if no such arm can be simulated.

    Nuisances are those that fit beside the findings: alone, they would imitate a finding, and hide the gap.
    NotForDiagnosis if nothing of the motion can be compared with the campaign.
    """
    feature_set = build_feature_set(recordings)
    case = build_case_simulator(feature_set, sensitivities.layout, fit.nuisance.size, fit.patch)
    if not case.rows.size:
        names = ", ".join(one.name for one in recordings)
        raise NotForDiagnosis(f"held out: nothing in {names} can be compared with the campaign")
    change = case.simulate(found.departures)
    if not np.all(np.isfinite(change)):
        return ()
    held = sensitivities.select(case.rows)
    N = held.nuisance[:, held.shared_nuisances]
    residual = replace(case, nuisance=fit.nuisance).residual(held.nuisance)
    base = residual - N @ found.nuisance
    rows = residual, base, base - change
    sigma = np.sqrt(held.layout.sigma**2 + np.sum(N @ found.covariance * N, axis=1))
    tool = compute_tool_error(held.layout.key.tolist(), rows, sigma, feature_set.arm.params)
    return (*list_errors(held.layout, rows, sigma), *([] if tool is None else [tool]))


def _find_missing(case: CaseSimulator, campaign: CampaignModel) -> tuple[str, ...]:
    """Return a remark on the sessions of the campaign that a case lacks; NotForDiagnosis if it lacks most."""
    layout = campaign.model.sensitivities.layout
    every, shared = (
        {key.split("/", 1)[0] for key in keys.tolist()} for keys in (layout.key, layout.key[case.rows])
    )
    names = ", ".join(sorted(every - shared))
    if case.rows.size < MIN_FEATURE_SHARE * layout.size:
        raise NotForDiagnosis(
            f"{case.rows.size} of the campaign's {layout.size} features are in these logs; "
            f"they lack the motions: {names}"
        )
    return (f"these logs have nothing comparable to the campaign's motions {names}",) if names else ()
