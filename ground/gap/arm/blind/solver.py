"""The diagnosis of one blind case of our arm."""

from pathlib import Path
from typing import Any

from ground.gap.arm.audit import believed
from ground.gap.arm.blind.evidence import features, kept_campaign, known, reference_campaign, split
from ground.gap.arm.case import asked, said_of
from ground.gap.arm.logs import NotForDiagnosis
from ground.gap.arm.reference import Reference
from ground.gap.blind.evidence import Features
from ground.gap.blind.solve import SEED, NoDiagnosis, Solver
from ground.gap.told import told
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
