"""The blind cases in small: made, solved and scored in a minute, where `make blind` takes hours.

Two sessions in place of 31, at rest alone; one kind of effects in place of all; a case without effect and
one with an effect. They are drawn, sealed, recorded, checked, diagnosed and scored as in the campaign. It
alone has motions, and effects that are in no catalogue.
"""

import json
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from ground.common.pool import Runner, local_runner
from ground.common.progress import Progress
from ground.diagnosis.arm.blind.evidence import split
from ground.diagnosis.arm.blind.make import all_sessions, drawn_truth, record_case
from ground.diagnosis.arm.blind.sealed import check_sealed
from ground.diagnosis.arm.blind.solver import case_diagnosed
from ground.diagnosis.arm.record import record_campaign
from ground.diagnosis.arm.reference import Reference, reference
from ground.diagnosis.blind.classes import FILE, published
from ground.diagnosis.blind.evidence import Features, Kept
from ground.diagnosis.blind.folder import CAMPAIGN, CASES, write_json
from ground.diagnosis.blind.scored import scored
from ground.diagnosis.blind.solve import Solver, solve
from ground.diagnosis.blind.table import score_json
from ground.diagnosis.blind.truth import seal
from ground.diagnosis.drawn import Seen
from sim.arms import arm_named
from sim.initialisation import true_reference
from validation.options import campaign_parser

EXAMPLE: Final = "example: python -m validation.blind --seed 3"
SESSIONS: Final = ("poses-rolled-1", "poses-level-5")
"""The last one is held out."""
KINDS: Final = ("resolver-bias",)
CASES_MADE: Final = 2


def known(campaign: Path, run: Runner, progress: Progress) -> Reference:
    """What is known of the campaign before cases, of these kinds."""
    return reference(*split(campaign), campaign, run, progress, KINDS)


@cache
def reference_of(campaign: Path) -> Reference:
    """The same, read once."""
    return known(campaign, local_runner(1), _quiet)


def kept(campaign: Path) -> Kept:
    """Its sensitivities."""
    found = reference_of(campaign)
    assert found.held_out is not None
    return Kept(found.ready.found, found.held_out)


def diagnosed(case: Path, campaign: Path) -> tuple[dict[str, Any], Features]:
    """What is said of a case, and what it is made of."""
    return case_diagnosed(case, reference_of(campaign))


def document(folder: Path, seed: int) -> dict[str, Any]:
    """Make, solve, score."""
    campaign, arm = folder / CAMPAIGN, arm_named("nominal")
    wanted = [one for one in all_sessions() if one.name in SESSIONS]
    record_campaign(campaign, wanted, arm, true_reference(arm), seed, _quiet)
    ready = reference_of(campaign).ready
    limits = [one.limit for one in ready.limits]
    hypotheses, labels = ready.found.hypotheses, ready.label
    write_json(campaign / FILE, published(hypotheses, labels, limits))
    seen = [Seen(*one) for one in zip(hypotheses, limits, map(int, labels), strict=True)]
    truth = drawn_truth(CASES_MADE, seed, seen, ())
    digest = seal(folder, truth)
    for case in truth.cases:
        record_case(folder / CASES / case.name, case, wanted)
        for log in sorted((folder / CASES / case.name).glob("*.mcap")):
            check_sealed(log, case)
    solve(folder, Solver(known, kept, diagnosed), local_runner(1), _quiet)
    found = scored(folder, kept, partial=False)
    clear = found.found.in_set
    return {
        "digest": digest,
        "kinds": [case.kind for case in truth.cases],
        "times_limit": [effect.times_limit for case in truth.cases for effect in case.effects],
        "in_bounds": found.false_alarm.hits == 0 and clear.hits == clear.of and found.superfluous.hits == 0,
        **score_json(found),
    }


def _quiet(*_: Any) -> None:
    """Progress that nobody sees."""


def main() -> int:
    """Print the score as JSON; exit status 1 if a name is wrong, or a clear effect is not named."""
    asked = campaign_parser("blind", __doc__, EXAMPLE).parse_args()
    with TemporaryDirectory() as folder:
        found = document(Path(folder), asked.seed)
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
