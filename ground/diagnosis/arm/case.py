"""One case: an arm's recordings beside a campaign whose sensitivities are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.kinematics.transforms import Array, skew
from ground.diagnosis.arm.audit import audit_recordings
from ground.diagnosis.arm.campaign_model import CampaignModel
from ground.diagnosis.arm.case_simulator import CaseSimulator, build_case_simulator
from ground.diagnosis.arm.feature_set import build_feature_set
from ground.diagnosis.arm.logs import NotForDiagnosis, Recording
from ground.diagnosis.arm.noise_floor import estimate_floor
from ground.diagnosis.arm.nuisance_fit import fit_nuisances
from ground.diagnosis.arm.simulator import LONG_SETTLING, ArmSimulator, build_simulator
from ground.diagnosis.closure import Closure, build_held_out_model, compute_held_out_residuals, effect_values
from ground.diagnosis.diagnose import Diagnosis, ModelComparison, diagnose
from ground.diagnosis.experiment_design import rank_repeats
from ground.diagnosis.model import DiagnosisModel, build_model
from ground.diagnosis.problem import Ints, Residuals
from ground.diagnosis.result import DiagnosisResult, ToolError
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from sim.params import nominal_params
from sim.plant import SCREW_AXES


def compute_tool_error(keys: Sequence[str], before: Array, after: Array, sigma: Array) -> ToolError | None:
    """Root mean squares over rests and tools of features (m,) with these keys; None without whole screws.

    A turret that is off by a turn w and a shift v has its tool, p away, off by v + w x p. `sigma` (m,) is
    the floor.
    """
    rows = _screw_rows(keys)
    if not rows.size:
        return None
    tools = configure(nominal_params()).arm.X_FT
    J = np.stack([np.hstack([-skew(X.p[:, None])[:, :, 0], np.eye(3)]) for X in tools])  # (tools, 3, 6)
    squares = [np.mean(np.sum(np.einsum("tij,rj->rti", J, of[rows]) ** 2, axis=2)) for of in (before, after)]
    floor = np.mean(np.einsum("tij,rj->rt", J**2, sigma[rows] ** 2))
    return ToolError(*(float(1e3 * np.sqrt(one)) for one in (*squares, floor)))


def _screw_rows(keys: Sequence[str]) -> Ints:
    """Rows of all six numbers of each rest that has them, (r, 6)."""
    known: dict[str, dict[str, int]] = {}
    for row, key in enumerate(keys):
        rest, _, axis = key.rpartition("/")
        known.setdefault(rest, {})[axis] = row
    whole = [[one[axis] for axis in SCREW_AXES] for one in known.values() if one.keys() >= set(SCREW_AXES)]
    return np.array(whole, np.intp).reshape(-1, len(SCREW_AXES))


MIN_FEATURE_SHARE: Final = 0.5
"""Of the campaign's features that a case must have, else there is too little motion."""
OWN_FLOOR_RATIO: Final = 1.2
"""Repeats that differ by so many times the floor of the campaign make a floor of their own."""


class TooLittleMotion(NotForDiagnosis):
    """A case that lacks most of the campaign; the message says which motions."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedCase:
    """A case in the campaign's features, the simulator asked about the nuisances that it has."""

    model: DiagnosisModel
    """Of the campaign, in the features that the case has."""
    simulator: CaseSimulator
    residual: Array
    """Measured less simulated with nuisances at 0, in straight lines from where they are, (m,)."""
    comparison: ModelComparison | None
    """Between what explains it best and what does so nearly as well, if anything does."""
    held_out: CaseSimulator | None
    held_out_residual: Array
    """The same of motion that takes no part."""
    notes: tuple[str, ...]
    """Of the audit."""
    floor: tuple[str, ...]
    """Where the floor is from."""


def diagnose_case(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    campaign: CampaignModel,
    seed: int,
    patch: tuple[Effect, ...] = (),
) -> DiagnosisResult:
    """Of a case's recordings, beside a simulator with the effects of a patch.

    Raises:
        TooLittleMotion: most motions of the campaign are missing.
    """
    return diagnose_fitted_case(fit_case(recordings, held_out, campaign, patch), campaign, seed)


def fit_case(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    campaign: CampaignModel,
    patch: tuple[Effect, ...] = (),
) -> FittedCase:
    """What a diagnosis is made of; TooLittleMotion as `solved`."""
    if not recordings:
        raise TooLittleMotion("there is no log that a diagnosis could be made of")
    recordings, held_out = (sorted(some, key=attrgetter("name")) for some in (recordings, held_out))
    layout = campaign.model.sensitivities.layout
    arm, floor = _case_simulator(recordings, campaign, patch)
    # without a patch the simulator has what it had of the campaign
    first = build_case_simulator(
        arm, layout, campaign.keys, None if patch else campaign.model.sensitivities.nominal
    )
    _check_motion(first, campaign)
    known = _restrict_model(campaign.model, first)
    notes = (
        *audit_recordings(recordings),
        *_missing_session_notes(first, campaign),
        *_threshold_notes(known, campaign),
    )
    best = fit_nuisances(known, first, patch)
    apart = _held_out_simulator(held_out, campaign, best.simulator.arm.patch)
    there = np.zeros(0)
    if apart is not None and campaign.held_out is not None:
        there = apart.residual() + campaign.held_out.nuisance[apart.rows] @ best.nuisance
    return FittedCase(known, best.simulator, best.residual, best.comparison, apart, there, notes, floor)


def diagnose_fitted_case(fitted: FittedCase, campaign: CampaignModel, seed: int) -> DiagnosisResult:
    """The diagnosis."""
    residuals = Residuals(fitted.model.sensitivities.layout, fitted.residual)
    diagnosis = diagnose(fitted.model, residuals, seed, fitted.simulator, fitted.comparison)
    shut, at_tool = _try_held_out(diagnosis, fitted, campaign, seed)
    return DiagnosisResult(
        fitted.model,
        diagnosis,
        shut,
        at_tool,
        rank_repeats(fitted.model, diagnosis),
        fitted.notes,
        fitted.floor,
    )


def _held_out_simulator(
    recordings: Sequence[Recording], campaign: CampaignModel, patch: tuple[Effect, ...]
) -> CaseSimulator | None:
    """What it is tried on; None if nothing is held out.

    Raises:
        TooLittleMotion: nothing of it is comparable.
    """
    if campaign.held_out is None or not recordings:
        return None
    arm, _ = _case_simulator(recordings, campaign, patch)
    found = build_case_simulator(arm, campaign.held_out.layout, campaign.held_out_keys)
    if not found.rows.size:
        names = ", ".join(one.name for one in recordings)
        raise TooLittleMotion(f"held out: nothing in {names} can be compared with the campaign")
    return found


def _case_simulator(
    recordings: Sequence[Recording], campaign: CampaignModel, patch: tuple[Effect, ...]
) -> tuple[ArmSimulator, tuple[str, ...]]:
    feature_set = build_feature_set(recordings)
    floor = estimate_floor(feature_set)
    raced = dict.fromkeys(hypothesis.effect for hypothesis in campaign.model.sensitivities.hypotheses)
    kinds = {name: catalogue()[name] for name in raced}
    return build_simulator(feature_set, floor.sigma, kinds, LONG_SETTLING, patch), floor.notes


def _restrict_model(campaign: DiagnosisModel, case: CaseSimulator) -> DiagnosisModel:
    """Of the features that the case has, with its own floor where that is higher."""
    found = campaign.sensitivities.select(case.rows)
    higher = np.maximum(found.layout.sigma, case.layout.sigma)
    if len(case.rows) == campaign.sensitivities.layout.size and np.all(
        higher < OWN_FLOOR_RATIO * found.layout.sigma
    ):
        return campaign
    layout = replace(found.layout, sigma=higher)
    return build_model(replace(found, layout=layout), 0, thresholds=campaign.thresholds)


def _try_held_out(
    diagnosis: Diagnosis, fitted: FittedCase, campaign: CampaignModel, seed: int
) -> tuple[Closure | None, ToolError | None]:
    """On held-out motion, as a share and at the tools; None if there is none, or no tracker looked."""
    case = fitted.held_out
    if campaign.held_out is None or case is None:
        return None, None
    settings, zero = effect_values(diagnosis), np.zeros(len(case.nuisances))
    change = case.predict(settings, zero) - case.predict({}, zero)
    apart = build_held_out_model(fitted.model.equations, campaign.held_out.select(case.rows))
    left = compute_held_out_residuals(diagnosis, apart, fitted.held_out_residual, change)
    keys = [campaign.held_out_keys[row] for row in case.rows]
    return left.closure(seed), compute_tool_error(keys, left.before, left.after, apart.sigma)


def _check_motion(case: CaseSimulator, campaign: CampaignModel) -> None:
    layout = campaign.model.sensitivities.layout
    if case.rows.size >= MIN_FEATURE_SHARE * layout.size:
        return
    raise TooLittleMotion(
        f"{case.rows.size} of the campaign's {layout.size} features are in these logs; "
        f"nothing comparable is there of: {', '.join(_missing_sessions(case, campaign))}"
    )


def _missing_session_notes(case: CaseSimulator, campaign: CampaignModel) -> list[str]:
    """What is to be said of sessions that the campaign has and the case has not."""
    missing = _missing_sessions(case, campaign)
    return (
        [f"of the campaign's motions nothing comparable is there of {', '.join(missing)}"] if missing else []
    )


def _threshold_notes(known: DiagnosisModel, campaign: CampaignModel) -> list[str]:
    """What is to be said of thresholds that were found for other features, or for a lower floor."""
    if known is campaign.model:
        return []
    return ["thresholds are those of the whole campaign with its own floor, which this is not"]


def _missing_sessions(case: CaseSimulator, campaign: CampaignModel) -> list[str]:
    return sorted(
        set(_session_names(campaign.keys)) - set(_session_names([campaign.keys[k] for k in case.rows]))
    )


def _session_names(keys: Sequence[str]) -> list[str]:
    return [key.split("/", 1)[0] for key in keys]
