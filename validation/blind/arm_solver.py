"""The diagnosis of one blind case of our arm."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ground.common.pool import Runner, local_runner
from ground.common.progress import Progress
from ground.common.requests import BadRequest
from ground.diagnosis.arm.audit import load_checked_recordings
from ground.diagnosis.arm.campaign_model import CampaignModel, load_campaign_model
from ground.diagnosis.arm.case import FittedCase, diagnose_fitted_case, fit_case
from ground.diagnosis.arm.logs import NotForDiagnosis
from ground.diagnosis.result import to_json
from sim.diagnosis_campaign import HELD_OUT_SESSIONS
from sim.params import nominal_params
from sim.plant import PlantDiverged
from validation.blind.case_features import CampaignSensitivities, CaseFeatures, CaseResiduals
from validation.blind.solve import DIAGNOSIS_SEED, NoDiagnosis, Solver


def split_logs(folder: Path) -> tuple[list[Path], list[Path]]:
    """A folder's logs: those that a diagnosis is made of, and those that are held out."""
    logs = sorted(folder.glob("*.mcap"))
    return [log for log in logs if log.stem not in HELD_OUT_SESSIONS], [
        log for log in logs if log.stem in HELD_OUT_SESSIONS
    ]


def load_model(campaign: Path, run: Runner, progress: Progress) -> CampaignModel:
    """All that is known of a campaign before cases; kept beside its logs, computed where it is not.

    Raises:
        BadRequest: its logs are not there, or what is kept cannot be read.
    """
    fitted, held = split_logs(campaign)
    if not fitted or not held:
        raise BadRequest(
            f"{campaign}: lacks the campaign's logs; `python -m validation.blind make` records them"
        )
    return load_campaign_model(fitted, held, campaign, run, progress)


def load_campaign_sensitivities(campaign: Path) -> CampaignSensitivities:
    """Its sensitivities."""
    found = load_cached_model(campaign)
    assert found.held_out is not None  # `known` refuses a campaign without
    return CampaignSensitivities(found.model.sensitivities, found.held_out)


@cache
def load_cached_model(campaign: Path) -> CampaignModel:
    """All that is known of it, read once in each process."""
    return load_model(campaign, local_runner(1), lambda *_: None)


def case_features(here: FittedCase) -> CaseFeatures:
    """What a case's logs say, as its diagnosis has it."""
    apart = here.held_out
    rows = np.zeros(0, np.intp) if apart is None else apart.rows
    return CaseFeatures(
        CaseResiduals(here.simulator.rows, here.residual), CaseResiduals(rows, here.held_out_residual)
    )


def diagnose_folder(case: Path, campaign: Path) -> tuple[dict[str, Any], CaseFeatures]:
    """What is said of the logs in a folder, beside the campaign in another, and what it is made of.

    Raises:
        NoDiagnosis: a log cannot be compared, most motions are missing, or the plant diverges.
    """
    return diagnose_against(case, load_cached_model(campaign))


def diagnose_against(case: Path, campaign: CampaignModel) -> tuple[dict[str, Any], CaseFeatures]:
    """The same, of a campaign of which this is known; NoDiagnosis likewise."""
    try:
        fitted, held = (load_checked_recordings(logs, nominal_params()) for logs in split_logs(case))
        here = fit_case(fitted, held, campaign)
        return to_json(diagnose_fitted_case(here, campaign, DIAGNOSIS_SEED)), case_features(here)
    except (NotForDiagnosis, PlantDiverged) as error:
        raise NoDiagnosis(str(error)) from error


ARM_SOLVER = Solver(load_model, load_campaign_sensitivities, diagnose_folder)
