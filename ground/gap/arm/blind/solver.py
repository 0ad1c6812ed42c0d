"""The diagnosis of one blind case of our arm."""

from pathlib import Path
from typing import Any

from ground.gap.arm.blind.evidence import features, kept_campaign, reference_campaign, split
from ground.gap.arm.case import solved
from ground.gap.arm.logs import recording_in
from ground.gap.blind.solve import SEED, Solver
from ground.gap.told import told
from sim.params import nominal_params


def diagnosed_case(case: Path, campaign: Path) -> dict[str, Any]:
    """What is said of the logs in a folder, beside the campaign in another.

    Raises:
        NotForDiagnosis: a log cannot be compared.
        TooLittleMotion: most motions of the campaign are missing.
    """
    fitted, held = ([recording_in(log) for log in logs] for logs in split(case))
    return told(solved(fitted, held, reference_campaign(campaign), nominal_params(), SEED))


ARM = Solver(kept_campaign, diagnosed_case, features)
