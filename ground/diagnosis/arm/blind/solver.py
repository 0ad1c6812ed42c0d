"""The diagnosis of one blind case of our arm."""

from pathlib import Path
from typing import Any

from ground.diagnosis.arm.audit import believed
from ground.diagnosis.arm.blind.evidence import features, kept_campaign, known, reference_campaign, split
from ground.diagnosis.arm.case import asked, said_of
from ground.diagnosis.arm.logs import NotForDiagnosis
from ground.diagnosis.arm.reference import Reference
from ground.diagnosis.blind.evidence import Features
from ground.diagnosis.blind.solve import SEED, NoDiagnosis, Solver
from ground.diagnosis.told import told
from sim.params import nominal_params
from sim.plant import PlantDiverged


def diagnosed_case(case: Path, campaign: Path) -> tuple[dict[str, Any], Features]:
    """What is said of the logs in a folder, beside the campaign in another, and what it is made of.

    Raises:
        NoDiagnosis: a log cannot be compared, most motions are missing, or the plant diverges.
    """
    return case_diagnosed(case, reference_campaign(campaign))


def case_diagnosed(case: Path, against: Reference) -> tuple[dict[str, Any], Features]:
    """The same, of a campaign of which this is known; NoDiagnosis likewise."""
    try:
        fitted, held = (believed(logs, nominal_params()) for logs in split(case))
        here = asked(fitted, held, against)
        return told(said_of(here, against, SEED)), features(here)
    except (NotForDiagnosis, PlantDiverged) as error:
        raise NoDiagnosis(str(error)) from error


ARM = Solver(known, kept_campaign, diagnosed_case)
