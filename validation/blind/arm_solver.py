"""Solver of blind cases of this arm: campaign model and diagnosis of one case."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from marsarm.common.pool import Runner, local_runner
from marsarm.diagnosis.arm.audit import load_checked_recordings
from marsarm.diagnosis.arm.case import (
    CampaignModel,
    FittedCase,
    diagnose_fitted_case,
    fit_case,
    load_campaign_model,
)
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from marsarm.diagnosis.arm.record import split_logs
from marsarm.diagnosis.result import to_json
from sim.params import nominal_params
from sim.plant import PlantDiverged
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from validation.blind.case_features import CampaignSensitivities, CaseFeatures, CaseResiduals
from validation.blind.solve import DIAGNOSIS_SEED, NoDiagnosis, Solver


def load_model(campaign: Path, run: Runner, progress: Progress) -> CampaignModel:
    """Load the campaign model; compute and cache what is missing.

    Raises:
        BadRequest: Logs of the campaign are missing, or a cached file cannot be read.
    """
    fitted, held = split_logs(campaign)
    if not fitted or not held:
        raise BadRequest(
            f"{campaign}: lacks the campaign's logs; `python -m validation.blind make` records them"
        )
    return load_campaign_model(fitted, held, campaign, run, progress)


def load_campaign_sensitivities(campaign: Path) -> CampaignSensitivities:
    """Load the sensitivities of a campaign."""
    found = load_cached_model(campaign)
    assert found.held_out is not None  # `load_model` refuses a campaign without held-out logs
    return CampaignSensitivities(found.model.sensitivities, found.held_out)


@cache
def load_cached_model(campaign: Path) -> CampaignModel:
    """Load the campaign model once in each process."""
    return load_model(campaign, local_runner(1), lambda *_: None)


def case_features(fitted_case: FittedCase) -> CaseFeatures:
    """Return the measured residuals of a case, as its diagnosis uses them."""
    held_out = fitted_case.held_out
    rows = np.zeros(0, np.intp) if held_out is None else held_out.rows
    return CaseFeatures(
        CaseResiduals(fitted_case.simulator.rows, fitted_case.residual),
        CaseResiduals(rows, fitted_case.held_out_residual),
    )


def diagnose_folder(case: Path, campaign: Path, without: str = "") -> tuple[dict[str, Any], CaseFeatures]:
    """Diagnose the logs of a folder with the campaign of another; return result document and residuals.

    Args:
        case: Folder of the case.
        campaign: Folder of the campaign.
        without: Name of an effect that the catalogue does not have; "" for none.

    Raises:
        NoDiagnosis: A log cannot be compared, most motions are missing, or the plant diverges.
    """
    return diagnose_against(case, load_cached_model(campaign), without)


def diagnose_against(
    case: Path, campaign: CampaignModel, without: str = ""
) -> tuple[dict[str, Any], CaseFeatures]:
    """Diagnose the logs of a folder with a campaign model; NoDiagnosis as for `diagnose_folder`."""
    if without:
        campaign = replace(campaign, model=replace(campaign.model, left_out_effect=without))
    try:
        fitted, held = (load_checked_recordings(logs, nominal_params()) for logs in split_logs(case))
        fitted_case = fit_case(fitted, held, campaign, DIAGNOSIS_SEED)
        return to_json(diagnose_fitted_case(fitted_case, campaign, DIAGNOSIS_SEED)), case_features(
            fitted_case
        )
    except (NotForDiagnosis, PlantDiverged) as error:
        raise NoDiagnosis(str(error)) from error


ARM_SOLVER = Solver(load_model, load_campaign_sensitivities, diagnose_folder)
