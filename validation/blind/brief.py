"""Brief run of the blind cases: make, solve and score in a minute, where `make blind` takes hours.

It has two sessions instead of 31, at rest only, one kind of effect, a case without effect, and a case with
one. All steps are those of the campaign. Only the campaign has motions and out-of-catalogue effects.
"""

import json
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from marsarm.common.pool import Runner, local_runner
from marsarm.diagnosis.arm.blind_case import check_leakage
from marsarm.diagnosis.arm.case import CampaignModel, load_campaign_model
from marsarm.diagnosis.arm.record import record_campaign, split_logs
from marsarm.diagnosis.blind_case import seal
from marsarm.diagnosis.sampling import list_detectable
from sim.arms import arm_named
from sim.initialisation import true_reference
from simgap.common.progress import Progress
from validation.blind.arm_solver import diagnose_against
from validation.blind.case_features import CampaignSensitivities, CaseFeatures
from validation.blind.classes import CLASSES_FILE, classes_json
from validation.blind.folder import CAMPAIGN_FOLDER, CASES_FOLDER, write_json
from validation.blind.make import all_sessions, draw_truth, record_case
from validation.blind.score_folder import score_folder
from validation.blind.solve import Solver, solve_cases
from validation.blind.table import score_json
from validation.options import campaign_parser

EXAMPLE: Final = "example: python -m validation.blind.brief --seed 3"
SESSIONS: Final = ("poses-rolled-1", "poses-level-5")
"""Sessions; the last one is held out."""
KINDS: Final = ("resolver-bias",)
CASES_MADE: Final = 2


def load_brief_model(campaign: Path, run: Runner, progress: Progress) -> CampaignModel:
    """Load the campaign model of these kinds."""
    return load_campaign_model(*split_logs(campaign), campaign, run, progress, KINDS)


@cache
def load_cached_model(campaign: Path) -> CampaignModel:
    """Load it once."""
    return load_brief_model(campaign, local_runner(1), _quiet)


def load_brief_sensitivities(campaign: Path) -> CampaignSensitivities:
    """Load its sensitivities."""
    found = load_cached_model(campaign)
    assert found.held_out is not None
    return CampaignSensitivities(found.model.sensitivities, found.held_out)


def diagnose_brief_case(case: Path, campaign: Path, without: str = "") -> tuple[dict[str, Any], CaseFeatures]:
    """Diagnose a case; return result document and residuals."""
    return diagnose_against(case, load_cached_model(campaign), without)


def run_brief(folder: Path, seed: int) -> dict[str, Any]:
    """Make, solve and score; return the document."""
    campaign, arm = folder / CAMPAIGN_FOLDER, arm_named("nominal")
    wanted = [one for one in all_sessions() if one.name in SESSIONS]
    record_campaign(campaign, wanted, arm, true_reference(arm), seed, _quiet)
    model = load_cached_model(campaign).model
    write_json(campaign / CLASSES_FILE, classes_json(model))
    limits = [one.limit for one in model.limits]
    seen = list_detectable(model.sensitivities.hypotheses, limits, model.label)
    truth = draw_truth(CASES_MADE, seed, seen, ())
    digest = seal(folder, truth)
    for case in truth.cases:
        record_case(folder / CASES_FOLDER / case.name, case, wanted)
        for log in sorted((folder / CASES_FOLDER / case.name).glob("*.mcap")):
            check_leakage(log, case)
    solve_cases(
        folder,
        Solver(load_brief_model, load_brief_sensitivities, diagnose_brief_case),
        local_runner(1),
        _quiet,
    )
    found = score_folder(folder, load_brief_sensitivities, partial=False)
    clear = found.found
    return {
        "digest": digest,
        "kinds": [case.kind for case in truth.cases],
        "times_limit": [effect.times_limit for case in truth.cases for effect in case.effects],
        "in_bounds": found.false_alarm.hits == 0
        and clear.covered.hits == clear.reported.of
        and found.spurious.hits == 0,
        **score_json(found),
    }


def _quiet(*_: Any) -> None:
    """Ignore progress."""


def main() -> int:
    """Print the score as JSON; exit status 1 if a name is wrong, or a clear effect is not named."""
    options = campaign_parser("blind", __doc__, EXAMPLE).parse_args()
    with TemporaryDirectory() as folder:
        found = run_brief(Path(folder), options.seed)
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
